"""Recordings as bags of ROS 1 and ROS 2: the states that the simulator publishes.

Needs the package `rosbags`; ROS need not be there. `ambf_export --to rosbag1` and `--to rosbag2` use it.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Callable, Dict, List, Sequence, Tuple

import numpy as np

from .errors import AmbfError
from .recording import Recording
from .simulation import Array, Simulation

_BODY = "ambf_msgs/msg/RigidBodyState"
_WORLD = "ambf_msgs/msg/WorldState"
_TEXT = "std_msgs/msg/String"

DEFINITIONS: Dict[str, str] = {
    _BODY: "\n".join(
        (
            "std_msgs/Header header",
            "uint32 sim_step",
            "std_msgs/String identifier",
            "std_msgs/String name",
            "float32 wall_time",
            "float32 sim_time",
            "float32 mass",
            "geometry_msgs/Point pInertia",
            "geometry_msgs/Pose pose",
            "geometry_msgs/Twist twist",
            "geometry_msgs/Wrench wrench",
            "string[] children_names",
            "string[] joint_names",
            "float32[] joint_positions",
            "float32[] joint_velocities",
            "float32[] joint_efforts",
        )
    ),
    _WORLD: "\n".join(
        (
            "std_msgs/Header header",
            "uint64 graphics_loop_freq",
            "uint64 dynamic_loop_freq",
            "uint8 n_devices",
            "uint32 sim_step",
            "float32 wall_time",
            "float32 sim_time",
        )
    ),
}
"""The fields of the messages of `ambf_msgs` that bags hold."""


class BagError(AmbfError, ValueError):
    """Error when a bag can't be written: the package `rosbags` is missing."""


def check() -> None:
    """Whether bags can be written. Raises BagError."""
    try:
        import rosbags.rosbag1
        import rosbags.rosbag2  # noqa: F401
    except ImportError as error:
        raise BagError("bags need the package rosbags: pip install rosbags") from error


def _store(version: int) -> Any:
    """The types of messages."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_JAZZY)
    for name, text in DEFINITIONS.items():
        # `Header` in definitions of ROS 1 is what its sum is made of.
        store.register(get_types_from_msg(text.replace("std_msgs/Header", "Header") if version == 1 else text, name))
    return store


def topic(name: str) -> str:
    """The beginning of an object's topics: the simulator has `_` for what ROS doesn't allow."""
    parts = [re.sub(r"[^0-9A-Za-z_]", "_", part) for part in name.split("/") if part]
    return "/" + "/".join(parts)


class _Messages:
    """Makes messages of a replay."""

    def __init__(self, store: Any, version: int, simulation: Simulation) -> None:
        self._types = store.types
        self._version = version
        self._simulation = simulation
        self._count = 0
        self._joints = [simulation.body(index).joint_indices for index in range(len(simulation.bodies))]
        self._joint_names = [list(simulation.body(index).joints) for index in range(len(simulation.bodies))]

    def _make(self, type_name: str, /, **fields: Any) -> Any:
        return self._types[type_name](**fields)

    def text(self, text: str) -> Any:
        """`std_msgs/String`."""
        return self._make(_TEXT, data=text)

    def _vector(self, kind: str, numbers: Array) -> Any:
        x, y, z = (float(number) for number in numbers)
        return self._make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def _header(self) -> Any:
        time_ns = round(self._simulation.sim_time * 1e9)
        stamp = self._make("builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)
        sequence = {"seq": self._count} if self._version == 1 else {}
        return self._make("std_msgs/msg/Header", stamp=stamp, frame_id="", **sequence)

    def world(self) -> Any:
        """The state of the world, which begins a new moment."""
        self._count += 1
        time = self._simulation.sim_time
        return self._make(
            _WORLD,
            header=self._header(),
            graphics_loop_freq=0,
            dynamic_loop_freq=0,
            n_devices=0,
            sim_step=self._simulation.sim_step,
            wall_time=time,
            sim_time=time,
        )

    def body(self, index: int) -> Any:
        """The state of a body."""
        simulation, joints = self._simulation, self._joints[index]
        pose, twist = simulation.poses[index], simulation.twists[index]
        x, y, z, w = (float(number) for number in pose[3:])
        zero = np.zeros(3)
        name = simulation.bodies[index]

        def single(numbers: Array) -> Any:
            return np.array(numbers[joints], dtype=np.float32)

        return self._make(
            _BODY,
            header=self._header(),
            sim_step=simulation.sim_step,
            identifier=self.text(name),
            name=self.text(name.rsplit("/", 1)[-1]),
            wall_time=simulation.sim_time,
            sim_time=simulation.sim_time,
            mass=float(simulation.masses[index]),
            pInertia=self._vector("Point", simulation.inertias[index]),
            pose=self._make(
                "geometry_msgs/msg/Pose",
                position=self._vector("Point", pose[:3]),
                orientation=self._make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
            ),
            twist=self._make(
                "geometry_msgs/msg/Twist",
                linear=self._vector("Vector3", twist[:3]),
                angular=self._vector("Vector3", twist[3:]),
            ),
            wrench=self._make(
                "geometry_msgs/msg/Wrench", force=self._vector("Vector3", zero), torque=self._vector("Vector3", zero)
            ),
            children_names=[],
            joint_names=self._joint_names[index],
            joint_positions=single(simulation.joint_positions),
            joint_velocities=single(simulation.joint_velocities),
            joint_efforts=single(simulation.joint_efforts),
        )


def write(
    recording: Recording, out: Path, version: int, rate: float, notes: Sequence[Tuple[float, str]]
) -> List[float]:
    """Replays a recording into a bag of ROS `version`: a file, or the folder of an MCAP file. The simulated times, s, of its moments.

    Stamps are simulated time, as with `--clock`. `notes` go to `/ambf/notes`. Raises BagError, RecordingError.
    """
    check()
    store = _store(version)
    writer: Any
    if version == 1:
        from rosbags.rosbag1 import Writer as Writer1

        writer = Writer1(out)
    else:
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2

        writer = Writer2(out, version=9, storage_plugin=StoragePlugin.MCAP)
    encode: Callable[[Any, str], Any] = store.serialize_ros1 if version == 1 else store.serialize_cdr
    times: List[float] = []
    with writer:
        connections: Dict[str, Any] = {}

        def send(name: str, kind: str, time: float, message: Any) -> None:
            if name not in connections:
                connections[name] = writer.add_connection(name, kind, typestore=store)
            writer.write(connections[name], round(time * 1e9), encode(message, kind))

        waiting = sorted(notes)
        for simulation in recording.sample(rate):
            if not times:
                messages = _Messages(store, version, simulation)
                names = [f"{topic(name)}/State" for name in simulation.bodies]
                # The environment is in the namespace of the world.
                namespace = simulation.models[0].rpartition("/")[0]
                world = topic(f"{namespace}/World") + "/State"
            time = simulation.sim_time
            while waiting and waiting[0][0] <= time:
                at, text = waiting.pop(0)
                send("/ambf/notes", _TEXT, at, messages.text(text))
            send(world, _WORLD, time, messages.world())
            for index, name in enumerate(names):
                send(name, _BODY, time, messages.body(index))
            times.append(time)
        for at, text in waiting:
            send("/ambf/notes", _TEXT, at, messages.text(text))
    return times
