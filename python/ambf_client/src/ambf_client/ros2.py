"""ROS 2: nodes of rclpy in its default context. Nodes that are made here are spun from the start, by threads of their own."""

from __future__ import annotations

import atexit
import contextlib
import os
import random
import re
import threading
import time
import traceback
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

import rclpy
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.node import NodeNameNonExistentError
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time
from rclpy.utilities import remove_ros_args

from .errors import SimulatorNotFound, SimulatorTimeout
from .ros import Ros

# Options of rospy's topics that are about TCP.
_OF_TCP = ("tcp_nodelay", "buff_size", "headers")

# Until a service is there, and until it has answered, for those that have not said how long they wait, s.
_PATIENCE_S = 5.0

# Between two looks at a clock that a simulation drives, s.
_LOOK_S = 0.002

# Nodes of this process: by the names that were asked for, since two of one name would take each other's place in the graph; given ones by
# themselves.
_nodes: Dict[Any, Ros2] = {}
_lock = threading.RLock()


def parse_argv(argv: Sequence[str]) -> List[str]:
    """`argv` without the arguments that are for ROS, which the nodes of this process get."""
    _init(list(argv))
    return remove_ros_args(list(argv))  # type: ignore[no-any-return]


def now_msg() -> Any:
    """System time."""
    return Clock(clock_type=ClockType.ROS_TIME).now().to_msg()


def to_sec(t: Any) -> float:
    """A time or duration, as rclpy or messages have it, in s."""
    return t.nanoseconds * 1e-9 if hasattr(t, "nanoseconds") else t.sec + t.nanosec * 1e-9  # type: ignore[no-any-return]


def request(kind: Any, **fields: Any) -> Any:
    """A request for services of a type."""
    return kind.Request(**fields)


def node(name: str, anonymous: Optional[bool], node: Any, end: Optional[float]) -> Ros2:
    """The node of that name in this process, which is made if there is none; `node` if it is given."""
    # There is no master to wait for.
    del end
    with _lock:
        found = _nodes.get(name if node is None else node)
        if found is not None and not found.is_shutdown() and not anonymous:
            found.made = False
            return found
        made = Ros2(name, anonymous, node)
        _nodes[made.node if node is not None or anonymous else name] = made
        return made


def _init(arguments: Optional[List[str]] = None) -> None:
    """Makes this process one of ROS 2, unless it is one."""
    with _lock:
        if not rclpy.ok():
            rclpy.init(args=arguments)


@atexit.register
def _end() -> None:
    """Ends all nodes: threads that wait in rclpy while the interpreter ends would crash it."""
    with _lock:
        nodes = list(_nodes.values())
        _nodes.clear()
    for node in nodes:
        node.end()
    if nodes:
        rclpy.try_shutdown()


class _Spinner:
    """A thread that serves a node."""

    def __init__(self, node: Any, at_end: Callable[[], None]) -> None:
        """`at_end` is called when ROS ends, not at `end`."""
        self._at_end = at_end
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._context = node.context
        self._ended = False
        self._thread = threading.Thread(target=self._spin, name=f"ROS {node.get_name()}", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        while self._context.ok() and not self._ended:
            try:
                self._executor.spin_once()
            except (ExternalShutdownException, ShutdownException):
                break
            except InvalidHandle:
                # Something was closed just now.
                continue
            except Exception:
                # A callback's error is its own: the others go on, as with rospy.
                if self._context.ok() and not self._ended:
                    traceback.print_exc()
        if not self._ended:
            self._at_end()

    def end(self) -> None:
        """Ends it."""
        self._ended = True
        self._executor.shutdown(1.0)
        if self._thread is not threading.current_thread():
            self._thread.join(5.0)


class Rate:
    """Keeps a loop at a frequency, by the clock of a node."""

    def __init__(self, ros: Ros2, hertz: float) -> None:
        """`hertz` is above 0, else ValueError."""
        if not hertz > 0:
            raise ValueError(f"a rate is a number of Hz above 0, not {hertz}")
        self._ros = ros
        self._period = round(1e9 / hertz)
        self._due = ros.nanoseconds() + self._period

    def sleep(self) -> None:
        """Waits until a period has passed since the last time; returns at once where that was missed, and when the node ends."""
        self._ros.sleep_until(self._due)
        now = self._ros.nanoseconds()
        # Far off: periods were missed, or time has jumped back.
        is_near = abs(now - self._due) < self._period
        self._due = (self._due if is_near else now) + self._period

    def destroy(self) -> None:
        """Nothing; rates of rclpy have it."""


class _Connection:
    """A client of a service that waits as long as it is told to."""

    def __init__(self, node: Any, name: str, kind: Any) -> None:
        self._node = node
        self._name = name
        self._kind = kind
        self._client: Any = node.create_client(kind, name)

    def client(self) -> Any:
        """The client of rclpy."""
        if self._client is None:
            self._client = self._node.create_client(self._kind, self._name)
        return self._client

    def close(self) -> None:
        """Ends it; the next call makes another client."""
        client, self._client = self._client, None
        if client is not None:
            self._node.destroy_client(client)

    def call(self, request: Any, timeout: Optional[float]) -> Any:
        """The answer; without time-out the service has to be there in 5 s."""
        client, begin = self.client(), time.monotonic()
        if not client.service_is_ready() and not client.wait_for_service(_PATIENCE_S if timeout is None else timeout):
            raise SimulatorNotFound(f"there is no service {self._name}")
        answered = threading.Event()
        answer = client.call_async(request)
        answer.add_done_callback(lambda _: answered.set())
        while not answered.wait(0.5 if timeout is None else max(0.0, begin + timeout - time.monotonic())):
            if timeout is not None or not self._node.context.ok():
                client.remove_pending_request(answer)
                raise SimulatorTimeout(f"{self._name}: no answer; has the simulator ended?")
        return answer.result()


class ServiceClient:
    """Calls a service: with a request, or with its fields. Callbacks may do so, too."""

    def __init__(self, connection: _Connection, kind: Any) -> None:
        self._connection = connection
        self._kind = kind

    def __call__(self, *requests: Any, **fields: Any) -> Any:
        """The answer. Raises SimulatorNotFound if the service is not there within 5 s, SimulatorTimeout if the node ends meanwhile."""
        return self._connection.call(requests[0] if requests else self._kind.Request(**fields), None)

    call = __call__

    def call_async(self, request: Any) -> Any:
        """A future of rclpy."""
        return self._connection.client().call_async(request)

    def wait_for_service(self, timeout: Optional[float] = None, timeout_sec: Optional[float] = None) -> bool:
        """Whether the service is there, within `timeout` s, which has two names as rospy and rclpy have."""
        return bool(self._connection.client().wait_for_service(timeout if timeout_sec is None else timeout_sec))

    def service_is_ready(self) -> bool:
        """Whether the service is there."""
        return bool(self._connection.client().service_is_ready())

    def close(self) -> None:
        """Ends it."""
        self._connection.close()


class Ros2(Ros):
    """A node of rclpy."""

    CLOSED = (InvalidHandle,)

    def __init__(self, name: str, anonymous: Optional[bool], node: Any) -> None:
        """Makes a node called `name` (and a number if `anonymous`), unless `node` is given: then it is spun only when `spin` is called."""
        self._is_own = node is None
        self._callbacks: List[Callable[[], Any]] = []
        self._shut = threading.Event()
        self._spinner: Optional[_Spinner] = None
        # Answers of services come to a node and a thread of their own, and requests to another: callbacks of either can wait for answers.
        self._helpers: Dict[str, Tuple[Any, _Spinner]] = {}
        if node is None:
            _init()
            number = f"_{os.getpid()}_{random.SystemRandom().randrange(10**6)}" if anonymous else ""
            # Names of ROS 1 may have other characters.
            node = rclpy.create_node(re.sub(r"[^A-Za-z0-9_]", "_", name.strip("/")) + number)
        self.node = node
        if self._is_own:
            self.spin()

    def name(self) -> str:
        """Full name of the node."""
        return self.node.get_fully_qualified_name()  # type: ignore[no-any-return]

    def where(self) -> str:
        """The domain."""
        return f"ROS 2, domain {self.node.context.get_domain_id()} (ROS_DOMAIN_ID):"

    # --- time -------------------------------------------------------------------------------------------------------------------

    def now(self) -> Time:
        """The node's time, which follows `/clock` with `use_sim_time`."""
        return self.node.get_clock().now()

    def nanoseconds(self) -> int:
        """The same, ns."""
        return int(self.now().nanoseconds)

    def now_msg(self) -> Any:
        """The same, a `builtin_interfaces/Time`."""
        return self.now().to_msg()

    def duration(self, seconds: float) -> Duration:
        """A duration."""
        return Duration(nanoseconds=round(seconds * 1e9))

    def zero(self) -> Time:
        """The time 0 of the node's clock."""
        return Time(clock_type=self.node.get_clock().clock_type)

    def rate(self, hertz: float) -> Rate:
        """A rate that needs nobody who spins."""
        return Rate(self, hertz)

    def timer(self, period: float, callback: Callable[[], Any]) -> Any:
        """A timer of the node."""
        return self.node.create_timer(period, callback)

    def sleep(self, seconds: float) -> None:
        """Waits, no longer than the node lives."""
        self.sleep_until(self.nanoseconds() + round(seconds * 1e9))

    def sleep_until(self, due: int) -> None:
        """Waits until a time, ns, no longer than the node lives."""
        clock = self.node.get_clock()
        longest = _LOOK_S if clock.ros_time_is_active else threading.TIMEOUT_MAX
        left = (due - self.nanoseconds()) * 1e-9
        while left > 0 and not self.is_shutdown():
            self._shut.wait(min(left, longest))
            left = (due - self.nanoseconds()) * 1e-9

    # --- life -------------------------------------------------------------------------------------------------------------------

    def spin(self) -> None:
        """Serves the node, by a thread of its own; one is enough."""
        if self._spinner is None:
            self._spinner = _Spinner(self.node, self._shut_down)

    def on_shutdown(self, callback: Callable[[], Any]) -> None:
        """Calls `callback` when the node ends: with ROS, at Ctrl+C or with the process."""
        self._callbacks.append(callback)

    def is_shutdown(self) -> bool:
        """Whether the node has ended."""
        return self._shut.is_set() or not self.node.context.ok()

    def _shut_down(self) -> None:
        with _lock:
            callbacks, self._callbacks = self._callbacks, []
        self._shut.set()
        for callback in callbacks:
            try:
                callback()
            except Exception:
                traceback.print_exc()

    def end(self) -> None:
        """Ends the node."""
        self._shut_down()
        ends = list(self._helpers.values())
        if self._spinner is not None:
            ends.append((self.node if self._is_own else None, self._spinner))
        for node, spinner in ends:
            spinner.end()
            if node is not None:
                with contextlib.suppress(InvalidHandle):
                    node.destroy_node()

    def shutdown(self) -> None:
        """Ends ROS 2 in this process."""
        self._shut_down()
        _end()
        rclpy.try_shutdown()

    # --- topics, services, parameters -------------------------------------------------------------------------------------------

    @staticmethod
    def _quality(queue_size: int, latch: bool) -> QoSProfile:
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latch else DurabilityPolicy.VOLATILE
        return QoSProfile(depth=queue_size or 10, durability=durability)

    def publisher(self, topic: str, kind: Any, queue_size: int, latch: bool, more: Dict[str, Any]) -> Any:
        """Reliable; transient local with `latch`. `more` goes to `create_publisher`."""
        more = {name: value for name, value in more.items() if name not in _OF_TCP}
        return self.node.create_publisher(kind, topic, self._quality(queue_size, latch), **more)

    def subscriber(
        self, topic: str, kind: Any, callback: Callable[[Any], Any], queue_size: int, latch: bool, more: Dict[str, Any]
    ) -> Any:
        """Reliable; transient local with `latch`, which hears latched publishers only. `more` goes to `create_subscription`."""
        more = {name: value for name, value in more.items() if name not in _OF_TCP}
        return self.node.create_subscription(kind, topic, callback, self._quality(queue_size, latch), **more)

    def published_topics(self) -> List[List[str]]:
        """What the nodes that are there publish: the graph has topics of others for up to a minute after their end."""
        found: Dict[str, str] = {}
        for node, namespace in self.node.get_node_names_and_namespaces():
            with contextlib.suppress(NodeNameNonExistentError):
                for topic, kinds in self.node.get_publisher_names_and_types_by_node(node, namespace):
                    found.setdefault(topic, kinds[0])
        return [[topic, kind] for topic, kind in sorted(found.items())]

    def service(self, name: str, kind: Any, callback: Callable[[Any, Any], Any]) -> Any:
        """A service, of a node beside this one."""
        return self._helper("services").create_service(kind, name, callback)

    def service_client(self, name: str, kind: Any) -> ServiceClient:
        """It does not wait for the service here."""
        return ServiceClient(self.connection(name, kind), kind)

    def connection(self, name: str, kind: Any) -> _Connection:
        """A client, of a node beside this one."""
        return _Connection(self._helper("calls"), name, kind)

    def _helper(self, what: str) -> Any:
        """A node beside this one, with a thread of its own."""
        with _lock:
            if what not in self._helpers:
                options = {"start_parameter_services": False, "enable_rosout": False}
                node = rclpy.create_node(f"{self.node.get_name()}_{what}", context=self.node.context, **options)
                self._helpers[what] = node, _Spinner(node, lambda: None)
            return self._helpers[what][0]

    def connections(self, publisher: Any) -> int:
        """Number of subscribers."""
        return int(publisher.get_subscription_count())

    def close(self, end: Any) -> None:
        """Ends what the node has, or a client of a service."""
        if isinstance(end, (ServiceClient, _Connection)):
            end.close()
            return
        with contextlib.suppress(InvalidHandle):
            for destroy in ("subscription", "publisher", "timer"):
                if getattr(self.node, f"destroy_{destroy}")(end):
                    return
            self._helper("services").destroy_service(end)

    def _owner(self, name: str) -> str:
        """The node of the object whose parameter it is: its name is that of the object, with `_` between."""
        there = set(self.node.get_node_names())
        parts = name.strip("/").split("/")
        for count in range(len(parts), 0, -1):
            node = "_".join(parts[:count])
            if node in there:
                return f"/{node}"
        raise KeyError(f"{name}: no object has that parameter")

    def _ask(self, service: str, kind: Any, **fields: Any) -> Any:
        """Asks for something that may be done twice: the first answer can be lost while the service does not know the new client yet."""
        connection = self.connection(service, kind)
        try:
            with contextlib.suppress(SimulatorTimeout):
                return connection.call(kind.Request(**fields), _PATIENCE_S / 5)
            return connection.call(kind.Request(**fields), _PATIENCE_S)
        finally:
            connection.close()

    def get_parameter(self, name: str) -> Any:
        """From the node of the object that has it."""
        answer = self._ask(f"{self._owner(name)}/get_parameters", GetParameters, names=[name])
        value = parameter_value_to_python(answer.values[0]) if answer.values else None
        if value is None:
            raise KeyError(f"{name}: no object has that parameter")
        return value

    def set_parameter(self, name: str, value: Any) -> None:
        """At the node of the object that has it."""
        parameter = Parameter(name, value=value).to_parameter_msg()
        answer = self._ask(f"{self._owner(name)}/set_parameters", SetParameters, parameters=[parameter])
        if not answer.results[0].successful:
            raise ValueError(f"{name}: {answer.results[0].reason}")
