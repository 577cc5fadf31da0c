"""One class between a script and its version of ROS, as scripts of the C++ simulator's client 3.0 use it. ROS 1 and ROS 2 are served."""

from __future__ import annotations

import functools
import importlib
import threading
from typing import Any, Callable, Dict, List, Optional, Sequence, TypeVar, cast

from .ros import Connection, Ros
from .versions import check_packages, ros_version

_Init = TypeVar("_Init", bound=Callable[..., None])


def _module() -> Any:
    """The module for the version of ROS that is meant."""
    return importlib.import_module(f"{__package__}.ros{ros_version()}")


class _Node:
    """A node that is made when it is needed: one for a layer and its children."""

    def __init__(self, name: str, anonymous: Optional[bool], node: Any) -> None:
        self._name = name
        self._anonymous = anonymous
        self._node = node
        self._ros: Optional[Ros] = None
        self._lock = threading.Lock()

    def join(self, end: Optional[float] = None) -> Ros:
        """The node. Raises UnsupportedRos if packages are missing, MasterNotFound if no master of ROS 1 answers until `end`."""
        with self._lock:
            if self._ros is None:
                check_packages()
                self._ros = cast(Ros, _module().node(self._name, self._anonymous, self._node, end))
            return self._ros

    def known(self) -> Optional[Ros]:
        """The node if there is one."""
        return self._ros


class ral:
    """A ROS node, and a namespace that its names are put below; names that begin with `/` stay as they are."""

    @staticmethod
    def ros_version() -> int:
        """1 or 2: what the environment variable ROS_VERSION says; without it 1, unless there is rclpy and no rospy.

        Raises UnsupportedRos for other values of the variable.
        """
        return ros_version()

    @staticmethod
    def parse_argv(argv: Sequence[str]) -> List[str]:
        """`argv` without the arguments that are for ROS, such as `name:=other` or `--ros-args …`."""
        return _module().parse_argv(argv)  # type: ignore[no-any-return]

    def __init__(self, node_name: str, namespace: str = "", node: Any = None) -> None:
        """ROS 1: makes this process a node called `node_name` (and a number), unless it is one or `node` is given.

        ROS 2: makes a node of that name, unless this process has one or `node`, a node of rclpy, is given. Callbacks of a node that was
        made are called by a thread of its own from now on; those of a given one when somebody spins it, `spin` for example.

        Raises UnsupportedRos if Python packages are missing, MasterNotFound if no master of ROS 1 answers within 5 s.
        """
        self._take(node_name, namespace, _Node(node_name, None, node))
        self._join()

    def _take(self, node_name: str, namespace: str, node: _Node) -> None:
        self._node_name = node_name
        self._namespace = namespace.rstrip("/")
        self._node = node
        self._children: Dict[str, ral] = {}

    @classmethod
    def later(
        cls, node_name: str, anonymous: Optional[bool] = None, namespace: str = "", of: Optional[ral] = None
    ) -> ral:
        """A layer whose node is made when something needs it, or has that of another layer. `anonymous`: a number is added to its name."""
        made = cls.__new__(cls)
        made._take(node_name, namespace, _Node(node_name, anonymous, None) if of is None else of._node)
        return made

    def _join(self, end: Optional[float] = None) -> Ros:
        return self._node.join(end)

    def node_name(self) -> str:
        """The name that it was given."""
        return self._node_name

    def namespace(self) -> str:
        """What relative names are put below; may be empty."""
        return self._namespace

    def create_child(self, ns: str) -> ral:
        """The same node with a namespace below this one. There is one child of a name."""
        if ns not in self._children:
            self._children[ns] = self.later(self._node_name, namespace=self._full(ns), of=self)
        return self._children[ns]

    # --- time -------------------------------------------------------------------------------------------------------------------

    def now(self) -> Any:
        """ROS time: `rospy.Time` or `rclpy.time.Time`."""
        return self._join().now()

    def now_msg(self) -> Any:
        """ROS time as messages have it: `rospy.Time` or `builtin_interfaces.msg.Time`."""
        return self._join().now_msg()

    def to_sec(self, t: Any) -> float:
        """A time or duration, the stamp of a header, or that of a message with a header, in s."""
        return seconds(t)

    def create_duration(self, d: float) -> Any:
        """A duration of `d` s."""
        return self._join().duration(d)

    def create_rate(self, rate_hz: float) -> Any:
        """A rate whose `sleep` keeps a loop at `rate_hz` Hz, whether somebody spins or not."""
        return self._join().rate(rate_hz)

    def create_time(self) -> Any:
        """The time 0."""
        return self._join().zero()

    def create_timer(self, period: float, callback: Callable[[], Any]) -> Any:
        """Calls `callback` each `period` s, until `close`."""
        return self._join().timer(period, callback)

    def sleep(self, duration: float) -> None:
        """Waits so many s of ROS time, no longer than the node lives."""
        self._join().sleep(duration)

    # --- life -------------------------------------------------------------------------------------------------------------------

    def spin(self) -> None:
        """Lets callbacks be called, by threads of the layer, and returns at once. Only a node of rclpy that was given needs it."""
        self._join().spin()

    def spin_and_execute(self, function: Callable[..., Any], *arguments: Any) -> None:
        """`spin`, `function(*arguments)`, `shutdown`; Ctrl+C ends the function, too."""
        self.spin()
        try:
            function(*arguments)
        except KeyboardInterrupt:
            pass
        finally:
            self.shutdown()

    def on_shutdown(self, callback: Callable[[], Any]) -> None:
        """Calls `callback` when the node ends."""
        self._join().on_shutdown(callback)

    def is_shutdown(self) -> bool:
        """Whether the node has ended."""
        ros = self._node.known()
        return ros is not None and ros.is_shutdown()

    def shutdown(self) -> None:
        """Ends all nodes of this process, which with ROS 1 can't become another one."""
        self._join().shutdown()

    # --- topics, services, parameters -------------------------------------------------------------------------------------------

    def _full(self, name: str) -> str:
        return name if name.startswith("/") or not self._namespace else f"{self._namespace}/{name}"

    def publisher(self, topic: str, msg_type: Any, queue_size: int = 10, latch: bool = False, **more: Any) -> Any:
        """A publisher: that of rospy, or that of rclpy, which is reliable and, with `latch`, transient local. `more` goes to it."""
        return self._join().publisher(self._full(topic), msg_type, queue_size, latch, more)

    def subscriber(
        self,
        topic: str,
        msg_type: Any,
        callback: Callable[[Any], Any],
        queue_size: int = 10,
        latch: bool = False,
        **more: Any,
    ) -> Any:
        """A subscriber: that of rospy, or that of rclpy, which is reliable. `more` goes to it.

        `latch` has no effect with ROS 1; with ROS 2 it hears publishers that latch, and only these.
        """
        return self._join().subscriber(self._full(topic), msg_type, callback, queue_size, latch, more)

    def get_published_topics(self) -> List[List[str]]:
        """[name, type] of all topics that have a publisher, not only of those below the namespace.

        Types are called `ambf_msgs/WorldState` with ROS 1, `ambf_msgs/msg/WorldState` with ROS 2.
        """
        return self._join().published_topics()

    def get_num_connections(self, publisher: Any) -> int:
        """Number of subscribers that `publisher` has."""
        return self._join().connections(publisher)

    def service(self, name: str, srv_type: Any, callback: Callable[[Any, Any], Any]) -> Any:
        """A service: `callback` takes a request and an empty response, which it fills and returns."""
        return self._join().service(self._full(name), srv_type, callback)

    def service_client(self, name: str, srv_type: Any) -> Any:
        """A function that calls the service, with a request or with its fields; it does not wait for the service here."""
        return self._join().service_client(self._full(name), srv_type)

    def connection(self, name: str, srv_type: Any) -> Connection:
        """A connection to a service, whose `call(request, timeout)` waits no longer than `timeout` s."""
        return self._join().connection(self._full(name), srv_type)

    def close(self, end: Any) -> None:
        """Ends a publisher, a subscriber, a service, a client of a service or a timer."""
        self._join().close(end)

    def get_parameter(self, name: str) -> Any:
        """The value of a parameter of the simulator, by its full name: `/ambf/env/lights/light1/cutoff_angle`.

        Raises KeyError if there is none.
        """
        return self._join().get_parameter(self._full(name))

    def set_parameter(self, name: str, value: Any) -> None:
        """Sets a parameter of the simulator.

        With ROS 2 it raises KeyError if there is none of that name, ValueError, with the reason, if the simulator refuses the value.
        """
        self._join().set_parameter(self._full(name), value)


def ral_may_come_first(init: _Init) -> _Init:
    """Lets a class be made as in client 2.0, `Class(name)`, and as in 3.0, `Class(ral, name)`. Without, it has the system's time."""

    @functools.wraps(init)
    def made(self: Any, *args: Any, ral: Optional[object] = None, **named: Any) -> None:
        if args and isinstance(args[0], _Ral):
            ral, args = args[0], args[1:]
        if ral is not None:
            self._ral = ral
        init(self, *args, **named)

    return cast(_Init, made)


# The class under a name that the argument `ral` does not hide.
_Ral = ral


def now_msg(layer: Optional[ral]) -> Any:
    """ROS time as messages have it; without a layer that of the process."""
    return _module().now_msg() if layer is None else layer.now_msg()


def seconds(t: Any) -> float:
    """A time or duration, the stamp of a header, or that of a message with a header, in s."""
    t = getattr(t, "header", t)
    return _module().to_sec(getattr(t, "stamp", t))  # type: ignore[no-any-return]


def request(srv_type: Any, **fields: Any) -> Any:
    """A request for services of a type."""
    return _module().request(srv_type, **fields)
