"""What `ral` needs of a version of ROS; `ros1` and `ros2` are the two that there are."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Callable, Dict, List, Protocol, Tuple, Type


class Connection(Protocol):
    """Asks one service, again and again, and never waits longer than it is told to."""

    def call(self, request: Any, timeout: float) -> Any:
        """The answer to `request`.

        Raises SimulatorNotFound if the service is not there, SimulatorTimeout if no answer comes within `timeout` s, StepRefused if the
        service cannot read the request.
        """

    def close(self) -> None:
        """Ends it; the next call begins anew."""


class Ros(ABC):
    """A node. Names are complete ones; times are those of the node's clock."""

    made = True
    """Whether the node was made for this object, not found in the process."""

    CLOSED: Tuple[Type[Exception], ...] = ()
    """What publishing raises when the publisher was closed meanwhile."""

    # --- place and time ---------------------------------------------------------------------------------------------------------

    @abstractmethod
    def name(self) -> str:
        """Name of the node."""

    @abstractmethod
    def where(self) -> str:
        """Where simulators are looked for, as the beginning of a sentence."""

    @abstractmethod
    def now(self) -> Any:
        """The time."""

    @abstractmethod
    def now_msg(self) -> Any:
        """The time as messages have it."""

    @abstractmethod
    def duration(self, seconds: float) -> Any:
        """A duration."""

    @abstractmethod
    def zero(self) -> Any:
        """The time 0."""

    @abstractmethod
    def rate(self, hertz: float) -> Any:
        """Something whose `sleep` keeps a loop at that frequency."""

    @abstractmethod
    def timer(self, period: float, callback: Callable[[], Any]) -> Any:
        """Calls `callback` each `period` s."""

    @abstractmethod
    def sleep(self, seconds: float) -> None:
        """Waits, no longer than the node lives."""

    # --- life -------------------------------------------------------------------------------------------------------------------

    @abstractmethod
    def spin(self) -> None:
        """Lets callbacks be called, by other threads; returns at once."""

    @abstractmethod
    def on_shutdown(self, callback: Callable[[], Any]) -> None:
        """Calls `callback` when the node ends."""

    @abstractmethod
    def is_shutdown(self) -> bool:
        """Whether the node has ended."""

    @abstractmethod
    def shutdown(self) -> None:
        """Ends all nodes of the process."""

    # --- topics, services, parameters -------------------------------------------------------------------------------------------

    @abstractmethod
    def publisher(self, topic: str, kind: Any, queue_size: int, latch: bool, more: Dict[str, Any]) -> Any:
        """A publisher as rospy or rclpy has them."""

    @abstractmethod
    def subscriber(
        self, topic: str, kind: Any, callback: Callable[[Any], Any], queue_size: int, latch: bool, more: Dict[str, Any]
    ) -> Any:
        """A subscriber as rospy or rclpy has them."""

    @abstractmethod
    def published_topics(self) -> List[List[str]]:
        """[name, type] of all topics that have a publisher. Raises MasterNotFound if who knows them does not answer."""

    @abstractmethod
    def service(self, name: str, kind: Any, callback: Callable[[Any, Any], Any]) -> Any:
        """A service; `callback` takes the request and an empty response, and returns the response."""

    @abstractmethod
    def service_client(self, name: str, kind: Any) -> Any:
        """A function that calls the service with a request, or with its fields."""

    @abstractmethod
    def connection(self, name: str, kind: Any) -> Connection:
        """A connection to a service."""

    @abstractmethod
    def connections(self, publisher: Any) -> int:
        """Number of subscribers that `publisher` has."""

    @abstractmethod
    def close(self, end: Any) -> None:
        """Ends a publisher, a subscriber, a service, a client of a service or a timer."""

    @abstractmethod
    def get_parameter(self, name: str) -> Any:
        """The value of a parameter. Raises KeyError if there is none."""

    @abstractmethod
    def set_parameter(self, name: str, value: Any) -> None:
        """Sets a parameter. Raises KeyError if there is none, ValueError if it is refused; ROS 1 has neither."""
