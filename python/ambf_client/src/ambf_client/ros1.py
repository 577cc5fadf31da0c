"""ROS 1: the process is one node, callbacks are called by threads of rospy."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from typing import Any, Callable, Dict, List, Optional, Sequence

import rosgraph
import rospy

from .errors import MasterNotFound
from .ros import Ros
from .service import ServiceConnection

# Until a master has answered, s.
_PATIENCE_S = 5.0


def parse_argv(argv: Sequence[str]) -> List[str]:
    """`argv` without the arguments that are for ROS."""
    return rospy.myargv(argv)  # type: ignore[no-any-return]


def now_msg() -> rospy.Time:
    """ROS time, which follows `/clock` if the process is told to."""
    return rospy.Time.now()


def to_sec(t: Any) -> float:
    """A time or duration in s."""
    return float(t.to_sec())


def request(kind: Any, **fields: Any) -> Any:
    """A request for services of a type."""
    return kind._request_class(**fields)


def node(name: str, anonymous: Optional[bool], node: Any, end: Optional[float]) -> Ros1:
    """The node of this process; see `Ros1`."""
    return Ros1(name, anonymous, node, end)


class Ros1(Ros):
    """The node that this process is."""

    CLOSED = (rospy.ROSException,)

    def __init__(self, name: str, anonymous: Optional[bool], node: Any, end: Optional[float]) -> None:
        """Makes this process a node called `name`, unless it is one or `node` is given; with a number unless `anonymous` is False.

        Raises MasterNotFound if no master answers until `end` (`time.monotonic()`, default: in 5 s).
        """
        self.made = False
        if node is None:
            end = time.monotonic() + _PATIENCE_S if end is None else end
            self.made = become_node(name, anonymous is not False, end)

    def name(self) -> str:
        """Name of the node."""
        return rospy.get_name()  # type: ignore[no-any-return]

    def where(self) -> str:
        """The master."""
        return f"the ROS master at {rosgraph.get_master_uri()} answers, but"

    def now(self) -> rospy.Time:
        """ROS time."""
        return rospy.Time.now()

    def now_msg(self) -> rospy.Time:
        """The same: messages have such times."""
        return rospy.Time.now()

    def duration(self, seconds: float) -> rospy.Duration:
        """A duration."""
        return rospy.Duration.from_sec(seconds)

    def zero(self) -> rospy.Time:
        """The time 0."""
        return rospy.Time()

    def rate(self, hertz: float) -> rospy.Rate:
        """A rate of rospy."""
        return rospy.Rate(hertz)

    def timer(self, period: float, callback: Callable[[], Any]) -> rospy.Timer:
        """A timer of rospy, which has a thread of its own."""
        return rospy.Timer(rospy.Duration.from_sec(period), lambda _: callback())

    def sleep(self, seconds: float) -> None:
        """Waits, no longer than the node lives."""
        with contextlib.suppress(rospy.ROSInterruptException):
            rospy.sleep(seconds)

    def spin(self) -> None:
        """Nothing: rospy has threads of its own."""

    def on_shutdown(self, callback: Callable[[], Any]) -> None:
        """Calls `callback` when the node ends."""
        rospy.on_shutdown(callback)

    def is_shutdown(self) -> bool:
        """Whether the node has ended."""
        return bool(rospy.is_shutdown())

    def shutdown(self) -> None:
        """Ends the node; this process can't be another one."""
        rospy.signal_shutdown("asked for by the script")

    def publisher(self, topic: str, kind: Any, queue_size: int, latch: bool, more: Dict[str, Any]) -> rospy.Publisher:
        """`more` goes to `rospy.Publisher`."""
        return rospy.Publisher(topic, kind, queue_size=queue_size, latch=latch, **more)

    def subscriber(
        self, topic: str, kind: Any, callback: Callable[[Any], Any], queue_size: int, latch: bool, more: Dict[str, Any]
    ) -> rospy.Subscriber:
        """`more` goes to `rospy.Subscriber`. `latch` has no effect: only publishers latch."""
        del latch
        return rospy.Subscriber(topic, kind, callback, queue_size=queue_size, **more)

    def published_topics(self) -> List[List[str]]:
        """What the master knows."""
        try:
            return rospy.get_published_topics()  # type: ignore[no-any-return]
        except (OSError, rosgraph.MasterException) as error:
            raise MasterNotFound(f"no ROS master answers at {rosgraph.get_master_uri()}: {error}") from error

    def service(self, name: str, kind: Any, callback: Callable[[Any, Any], Any]) -> rospy.Service:
        """A service of rospy."""
        return rospy.Service(name, kind, lambda request: callback(request, kind._response_class()))

    def service_client(self, name: str, kind: Any) -> rospy.ServiceProxy:
        """A proxy of rospy; it does not wait for the service here."""
        return rospy.ServiceProxy(name, kind)

    def connection(self, name: str, kind: Any) -> ServiceConnection:
        """It stays open."""
        return ServiceConnection(name, kind)

    def connections(self, publisher: rospy.Publisher) -> int:
        """Number of subscribers."""
        return int(publisher.get_num_connections())

    def close(self, end: Any) -> None:
        """Topics are unregistered; proxies, timers and services are what rospy calls closed or shut down."""
        for name in ("unregister", "shutdown", "close"):
            if hasattr(end, name):
                getattr(end, name)()
                return

    def get_parameter(self, name: str) -> Any:
        """From the master."""
        return rospy.get_param(name)

    def set_parameter(self, name: str, value: Any) -> None:
        """To the master; whoever it concerns looks there."""
        rospy.set_param(name, value)


def become_node(name: str, anonymous: bool, end: float) -> bool:
    """Makes this process a ROS node, unless it is one already; whether it was made one.

    Raises MasterNotFound if no master answers until `end` (`time.monotonic()`).
    """
    while not _master_answers():
        if time.monotonic() > end:
            raise MasterNotFound(
                f"no ROS master answers at {rosgraph.get_master_uri()}; start the simulator, or set ROS_MASTER_URI; "
                "for ROS 2 set ROS_VERSION=2"
            )
        time.sleep(0.05)
    if rospy.get_name() != "/unnamed":
        return False
    in_main = threading.current_thread() is threading.main_thread()
    rospy.init_node(name, anonymous=anonymous, disable_signals=not in_main)
    return True


def _master_answers() -> bool:
    """Whether the master answers within a second."""
    previous = socket.getdefaulttimeout()
    socket.setdefaulttimeout(1.0)
    try:
        rosgraph.Master("/ambf_client").getPid()
        return True
    except (OSError, rosgraph.MasterException):
        return False
    finally:
        socket.setdefaulttimeout(previous)
