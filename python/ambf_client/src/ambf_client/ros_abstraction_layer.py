"""One class between a script and its version of ROS, as scripts of the C++ simulator's client 3.0 use it. Here that is ROS 1."""

from __future__ import annotations

import functools
import os
import socket
import threading
import time
from typing import Any, Callable, Dict, List, Optional, Sequence, TypeVar, cast

import rosgraph
import rospy

from .errors import MasterNotFound, UnsupportedRos

_Init = TypeVar("_Init", bound=Callable[..., None])


class ral:
    """A ROS node, and a namespace that its names are put below; names that begin with `/` stay as they are."""

    @staticmethod
    def ros_version() -> int:
        """1. Raises UnsupportedRos if the environment variable ROS_VERSION asks for another one."""
        version = os.environ.get("ROS_VERSION", "1")
        if version != "1":
            raise UnsupportedRos(f"ROS_VERSION is {version}: only ROS 1 is served yet; unset it or set it to 1")
        return 1

    @staticmethod
    def parse_argv(argv: Sequence[str]) -> List[str]:
        """`argv` without the arguments that are for ROS, such as `name:=other`."""
        return rospy.myargv(argv)  # type: ignore[no-any-return]

    def __init__(self, node_name: str, namespace: str = "", node: Any = None) -> None:
        """Makes this process a ROS node called `node_name` (and a number), unless it is one or `node` is given.

        Raises UnsupportedRos if the environment asks for ROS 2, MasterNotFound if no ROS master answers within 5 s.
        """
        self.ros_version()
        self._node_name = node_name
        self._namespace = namespace.rstrip("/")
        self._node = node
        self._children: Dict[str, ral] = {}
        if node is None:
            become_node(node_name, anonymous=True, end=time.monotonic() + 5.0)

    def node_name(self) -> str:
        """The name that it was given."""
        return self._node_name

    def namespace(self) -> str:
        """What relative names are put below; may be empty."""
        return self._namespace

    def create_child(self, ns: str) -> ral:
        """The same node with a namespace below this one. There is one child of a name."""
        if ns not in self._children:
            self._children[ns] = ral(self._node_name, self._full(ns), self._node if self._node is not None else self)
        return self._children[ns]

    # --- time -------------------------------------------------------------------------------------------------------------------

    def now(self) -> rospy.Time:
        """ROS time."""
        return rospy.Time.now()

    def now_msg(self) -> rospy.Time:
        """ROS time as messages have it, which is the same in ROS 1."""
        return rospy.Time.now()

    def to_sec(self, t: Any) -> float:
        """A time or duration, the stamp of a header, or that of a message with a header, in s."""
        t = getattr(t, "header", t)
        return float(getattr(t, "stamp", t).to_sec())

    def create_duration(self, d: float) -> rospy.Duration:
        """A duration of `d` s."""
        return rospy.Duration.from_sec(d)

    def create_rate(self, rate_hz: float) -> rospy.Rate:
        """A rate whose `sleep` keeps a loop at `rate_hz` Hz."""
        return rospy.Rate(rate_hz)

    def create_time(self) -> rospy.Time:
        """The time 0."""
        return rospy.Time()

    # --- life -------------------------------------------------------------------------------------------------------------------

    def spin(self) -> None:
        """Nothing, and at once: ROS 1 calls subscribers from threads of its own."""

    def on_shutdown(self, callback: Callable[[], Any]) -> None:
        """Calls `callback` when the node ends."""
        rospy.on_shutdown(callback)

    def is_shutdown(self) -> bool:
        """Whether the node has ended."""
        return bool(rospy.is_shutdown())

    def shutdown(self) -> None:
        """Ends the node; this process can't be another one."""
        rospy.signal_shutdown("asked for by the script")

    # --- topics and services ----------------------------------------------------------------------------------------------------

    def _full(self, name: str) -> str:
        return name if name.startswith("/") or not self._namespace else f"{self._namespace}/{name}"

    def publisher(
        self, topic: str, msg_type: Any, queue_size: int = 10, latch: bool = False, **more: Any
    ) -> rospy.Publisher:
        """A publisher; `more` goes to `rospy.Publisher`."""
        return rospy.Publisher(self._full(topic), msg_type, queue_size=queue_size, latch=latch, **more)

    def subscriber(
        self,
        topic: str,
        msg_type: Any,
        callback: Callable[[Any], Any],
        queue_size: int = 10,
        latch: bool = False,
        **more: Any,
    ) -> rospy.Subscriber:
        """A subscriber; `more` goes to `rospy.Subscriber`. `latch` has no effect: in ROS 1 only publishers latch."""
        del latch
        return rospy.Subscriber(self._full(topic), msg_type, callback, queue_size=queue_size, **more)

    def get_published_topics(self) -> List[List[str]]:
        """[name, type] of all topics that have a publisher, not only of those below the namespace."""
        return rospy.get_published_topics()  # type: ignore[no-any-return]

    def service_client(self, name: str, srv_type: Any) -> rospy.ServiceProxy:
        """A function that calls the service; it does not wait for the service here."""
        return rospy.ServiceProxy(self._full(name), srv_type)


def ral_may_come_first(init: _Init) -> _Init:
    """Lets a class be made as in client 2.0, `Class(name)`, and as in 3.0, `Class(ral, name)`; the `ral` is not needed."""

    @functools.wraps(init)
    def made(self: Any, *args: Any, ral: Optional[object] = None, **named: Any) -> None:
        del ral
        init(self, *(args[1:] if args and isinstance(args[0], _Ral) else args), **named)

    return cast(_Init, made)


# The class under a name that the argument `ral` does not hide.
_Ral = ral


def become_node(name: str, anonymous: bool, end: float) -> bool:
    """Makes this process a ROS node, unless it is one already; whether it was made one.

    Raises MasterNotFound if no master answers until `end` (`time.monotonic()`).
    """
    while not _master_answers():
        if time.monotonic() > end:
            raise MasterNotFound(f"no ROS master answers at {master_uri()}; start the simulator, or set ROS_MASTER_URI")
        time.sleep(0.05)
    if rospy.get_name() != "/unnamed":
        return False
    in_main = threading.current_thread() is threading.main_thread()
    rospy.init_node(name, anonymous=anonymous, disable_signals=not in_main)
    return True


def master_uri() -> str:
    """Address of the ROS master."""
    return rosgraph.get_master_uri()  # type: ignore[no-any-return]


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
