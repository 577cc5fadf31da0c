"""Finds the objects of the simulator and publishes their commands."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from typing import Any, Dict, List, Optional, Sequence, Tuple, Type

from ambf_msgs import msg
from std_msgs.msg import Empty

from .actuator import Actuator
from .base_object import BaseObject, say
from .contact_sensor import ContactSensor
from .errors import MasterNotFound, ObjectNotFound, SimulatorNotFound
from .ghost import GhostObject
from .handle import Health
from .legacy_object import Object
from .posed import Camera, Light
from .rigid_body import RigidBody
from .ros import Ros
from .ros_abstraction_layer import ral
from .sensor import Sensor
from .soft_body import SoftBody
from .vehicle import Vehicle
from .world import World

_STATE = "/State"

# All objects are there when none has come for so long, s.
_QUIET_S = 0.2

# States that wait to be taken. A client of ROS 2 that cannot keep up would read them late.
_QUEUE = {1: 10, 2: 1}

# Message type of the state: handle and message type of the command.
_KINDS: Dict[str, Tuple[Type[Any], Any, Any]] = {
    f"ambf_msgs/{name}State": (handle, getattr(msg, f"{name}State"), getattr(msg, f"{name}Cmd"))
    for name, handle in {
        "Actuator": Actuator,
        "Camera": Camera,
        "ContactSensor": ContactSensor,
        "GhostObject": GhostObject,
        "Light": Light,
        "Object": Object,
        "RigidBody": RigidBody,
        "Sensor": Sensor,
        "SoftBody": SoftBody,
        "Vehicle": Vehicle,
    }.items()
}

# Kinds that client 2.0 has no handles for: its scripts never mean one of them by a part of a name.
_NEW_KINDS = (ContactSensor, GhostObject, SoftBody)


class Client:
    """Handles of all objects of the simulator.

    As a context manager it connects at the start and cleans up at the end.
    """

    def __init__(
        self,
        client_name: str = "ambf_client",
        max_discovery_attempts: int = 5,
        *,
        namespace: str = "",
        only: Optional[Sequence[str]] = None,
        anonymous: bool = False,
    ) -> None:
        """`client_name`: name of the ROS node, unless this process is one already. Two nodes of one name evict each other (ROS 1), unless
        they are `anonymous`, which adds a number to the name.

        `max_discovery_attempts` is taken for scripts of client 3.0 and has no effect: `connect` has a time-out.

        `namespace`: only objects are found whose topics are below it, for a simulator that was started with `--ns`.
        `only`: of these, only the objects whose names contain one of these texts; the others cost nothing then.
        """
        del max_discovery_attempts
        self._client_name = client_name
        self.ral = ral.later(client_name, anonymous)
        """The node; it is made when something needs it."""
        self._ros: Optional[Ros] = None
        self._health = Health()
        self._namespace = namespace.rstrip("/")
        self._only = only
        self._ros_topics: List[Any] = []
        self._objects: Dict[str, BaseObject] = {}
        self._world: Optional[World] = None
        self._common_obj_namespace = ""
        self._publish_rate = 120.0
        self._thread: Optional[threading.Thread] = None
        self._stop = threading.Event()

    def __enter__(self) -> Client:
        if self._world is None:
            self.connect()
        return self

    def __exit__(self, *_: object) -> None:
        self.clean_up()

    # --- connection -------------------------------------------------------------------------------------------------------------

    def connect(self, default_publish_rate: float = 120, timeout: float = 5.0) -> None:
        """Finds all objects, waits for their first states and starts to publish, at `default_publish_rate` Hz.

        Raises MasterNotFound or SimulatorNotFound if one of them does not answer within `timeout` s.
        """
        self.create_objs_from_rostopics(default_publish_rate, timeout)
        self.start()

    def create_objs_from_rostopics(self, publish_rate: float, timeout: float = 5.0) -> None:
        """Makes this process a ROS node, unless it is one, and finds all objects; raises as `connect`."""
        end = time.monotonic() + timeout
        self._join_ros(end)
        self.set_publish_rate(publish_rate)
        quiet_since, known = time.monotonic(), -1
        # A simulator that is just starting announces its objects one after the other.
        while self._world is None or time.monotonic() < quiet_since + _QUIET_S:
            if self._find() and len(self._objects) != known:
                quiet_since, known = time.monotonic(), len(self._objects)
            if self._world is None and time.monotonic() > end:
                raise SimulatorNotFound(
                    f"{self._where()} within {timeout} s no simulator has published a world; does it run?"
                )
            time.sleep(0.02)
        self._hear_all(end, timeout)

    def _join_ros(self, end: float) -> None:
        if self._ros is not None:
            return
        self._ros = self.ral._join(end)
        if self._ros.made:
            self._ros.on_shutdown(self.clean_up)
        else:
            self._client_name = self._ros.name()

    def _where(self) -> str:
        """Where simulators are looked for."""
        return self._ros.where() if self._ros is not None else ""

    def _find(self) -> bool:
        """Makes handles for what is new; False if the master doesn't answer."""
        try:
            self._ros_topics = self.ral.get_published_topics()
        except MasterNotFound:
            return False
        for topic, full_kind in self._ros_topics:
            if not topic.startswith(f"{self._namespace}/"):
                continue
            name = topic.replace(_STATE, "")
            # ROS 2 says `ambf_msgs/msg/WorldState`.
            kind = full_kind.replace("/msg/", "/")
            if kind == "ambf_msgs/WorldState":
                self._add_world(topic)
            elif kind in _KINDS and name not in self._objects and self._is_wanted(name):
                made = self._make(topic, name, *_KINDS[kind])
                made._health = self._health
                self._objects[name] = made
        # Letter by letter, as the original does.
        self._common_obj_namespace = os.path.commonprefix(list(self._objects))  # noqa: RUF071
        return True

    def _is_wanted(self, name: str) -> bool:
        return self._only is None or any(part in name for part in self._only)

    def _add_world(self, topic: str) -> None:
        name = topic.replace(_STATE, "")
        if self._world is not None:
            if self._world._topic == name:
                return
            self._world.close()
        world = World(self.ral, "World", name)  # type: ignore[call-arg, arg-type]
        self._health.lost = ""
        world._health = self._health
        world._pub = self.ral.publisher(f"{name}/Command", msg.WorldCmd, queue_size=10, tcp_nodelay=True)
        world._reset_pub = self.ral.publisher(f"{name}/Command/Reset", Empty, queue_size=1)
        world._reset_bodies_pub = self.ral.publisher(f"{name}/Command/Reset/Bodies", Empty, queue_size=1)
        world._sub = self.ral.subscriber(topic, msg.WorldState, world.ros_cb, queue_size=10, tcp_nodelay=True)
        world.connect_services(self.ral)
        self._world = world

    def _make(self, topic: str, name: str, handle: Type[Any], state: Any, command: Any) -> BaseObject:
        made: BaseObject = handle(self.ral, name)
        made._topic = name
        made._pub = self.ral.publisher(f"{name}/Command", command, queue_size=10, tcp_nodelay=True)
        queue = _QUEUE[self.ral.ros_version()]
        made._sub = self.ral.subscriber(topic, state, made.ros_cb, queue_size=queue, tcp_nodelay=True)
        return made

    def _hear_all(self, end: float, timeout: float) -> None:
        """Waits until everything has spoken, and the world listens."""
        world = self._world
        assert world is not None
        while not (world._count and world._pub and self.ral.get_num_connections(world._pub)):
            if time.monotonic() > end:
                raise SimulatorNotFound(
                    f"{self._where()} {world._topic} is registered, and has said nothing within {timeout} s; has the simulator ended?"
                )
            time.sleep(0.005)
        silent = list(self._objects.values())
        while silent and time.monotonic() < end:
            silent = [handle for handle in silent if not handle._count]
            time.sleep(0.005)
        if silent:
            names = ", ".join(handle.get_name() for handle in silent)
            say(f"{self._client_name}: nothing was heard within {timeout} s from {names}")

    def set_publish_rate(self, rate: float) -> None:
        """Rate at which the commands of active objects are published, Hz."""
        if not 0 < rate < 1e5:
            raise ValueError(f"a rate is a number of Hz above 0, not {rate}")
        self._publish_rate = float(rate)

    def start(self) -> None:
        """Starts to publish the commands of active objects; nothing happens if it has started."""
        if self._thread is None or not self._thread.is_alive():
            self._stop.clear()
            self._thread = threading.Thread(target=self._publish, name="ambf_client", daemon=True)
            self._thread.start()

    def _publish(self) -> None:
        due = time.monotonic()
        while not self._stop.is_set() and not self.ral.is_shutdown():
            active: List[Any] = [handle for handle in list(self._objects.values()) if handle.is_active()]
            if self._world is not None and self._world.is_active():
                active.append(self._world)
            for handle in active:
                # The topic may have been closed meanwhile.
                with contextlib.suppress(*self._ros.CLOSED if self._ros is not None else ()):
                    handle.run_publisher()
            due = max(due + 1.0 / self._publish_rate, time.monotonic())
            self._stop.wait(due - time.monotonic())

    def refresh(self) -> None:
        """Forgets all handles and finds the objects anew."""
        rate = self._publish_rate
        self.clean_up()
        self.connect(rate)

    def clean_up(self) -> None:
        """Ends publishing and forgets all handles; what was commanded ends by the simulator's watchdog, 0.5 s later."""
        self._stop.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(5.0)
        self._thread = None
        handles, self._objects = list(self._objects.values()), {}
        world, self._world = self._world, None
        for handle in handles:
            handle.close()
        if world is not None:
            world.close()

    # --- ROS, as in client 3.0 --------------------------------------------------------------------------------------------------

    def get_ral(self) -> ral:
        """The same as `ral`, whose node is made now if need be.

        Raises MasterNotFound if no master of ROS 1 answers within 5 s, UnsupportedRos if Python packages are missing.
        """
        self._join_ros(time.monotonic() + 5.0)
        return self.ral

    def get_time(self) -> float:
        """ROS time, s; raises as `get_ral`."""
        return self.get_ral().to_sec(self.ral.now())

    def create_rate(self, Hz: float) -> Any:
        """A rate whose `sleep` keeps a loop at `Hz`; raises as `get_ral`."""
        return self.get_ral().create_rate(Hz)

    def is_shutdown(self) -> bool:
        """Whether the ROS node has ended."""
        return self.ral.is_shutdown()

    # --- objects ----------------------------------------------------------------------------------------------------------------

    def get_common_namespace(self) -> str:
        """What the names of all objects begin with; may end inside a name."""
        return self._common_obj_namespace

    def get_world_handle(self) -> Optional[World]:
        """The world; None before `connect`."""
        return self._world

    def get_obj_names(self) -> List[str]:
        """Names of all handles, the world's among them."""
        return [*self._objects, *(["World"] if self._world is not None else [])]

    def get_obj_handle(self, a_name: str) -> Any:
        """The object of that name, or the only one whose name contains it; None, and a line that says so, otherwise.

        If several names contain it, but only one is that of an object which is no ghost object, contact sensor or soft body, it is meant:
        client 2.0 did not know the others.

        From now on its command is published; the world's is not.
        """
        for attempt in range(2):
            try:
                return self._look_up(a_name)
            except ObjectNotFound as error:
                # It may have come since the master was asked last.
                if attempt or not self._find():
                    say(str(error))
                    break
        return None

    def wait_for_object(self, a_name: str, timeout: float = 5.0) -> Any:
        """`get_obj_handle`, but waits for objects that are still to come.

        Raises ObjectNotFound if there is none, or more than one, of that name after `timeout` s, or as soon as `connect` would.
        """
        if self._world is None:
            self.connect(self._publish_rate, timeout)
        end = time.monotonic() + timeout
        while True:
            try:
                handle = self._look_up(a_name)
                if handle._count:
                    return handle
                problem = ObjectNotFound(f"{handle.get_name()} has said nothing within {timeout} s")
            except ObjectNotFound as error:
                problem = error
            if time.monotonic() > end:
                raise problem
            time.sleep(0.02)
            self._find()

    def _look_up(self, a_name: str) -> Any:
        found: Any = self._objects.get(a_name)
        if found is None and self._world is not None and a_name in ("World", self._world._topic):
            return self._world
        if found is None:
            names = [name for name in self._objects if a_name in name]
            old = [name for name in names if not isinstance(self._objects[name], _NEW_KINDS)]
            if len(old) == 1:
                names = old
            if not names and self._world is not None and a_name in self._world._topic:
                return self._world
            if len(names) != 1:
                what = f"several objects: {', '.join(sorted(names))}" if names else "none of the objects"
                raise ObjectNotFound(f'"{a_name}" is the name or part of the name of {what}')
            found = self._objects[names[0]]
        if isinstance(found, (RigidBody, Object)) and not found.is_active():
            found.set_publish_children_names_flag(True)
            found.set_publish_joint_names_flag(True)
            found.set_publish_joint_positions_flag(True)
        found.set_active()
        return found

    def print_active_topics(self) -> None:
        """Prints all topics and their types."""
        print(self._ros_topics)

    def print_summary(self) -> None:
        """Prints the names of all handles."""
        print("\n".join(self.get_obj_names()))

    def get_obj_pose(self, a_name: str) -> Optional[List[float]]:
        """[x, y, z, roll, pitch, yaw] of an object, m and rad; None if there is no such object."""
        handle = self.get_obj_handle(a_name)
        return None if handle is None else handle.get_pose()

    def set_obj_cmd(self, a_name: str, fx: float, fy: float, fz: float, nx: float, ny: float, nz: float) -> None:
        """Pushes a body with a force, N, and a torque, N·m, world axes."""
        handle = self.get_obj_handle(a_name)
        if handle is not None:
            handle.wrench_command(fx, fy, fz, nx, ny, nz)
