"""The crate ros2-node beside CycloneDDS, which knows nothing of ROS: messages both ways."""

import os
from dataclasses import dataclass

from harness import Ros2Test, PATIENCE_S

# Both on the loopback interface, which has no multicast of its own accord.
os.environ["CYCLONEDDS_URI"] = (
    "<General><Interfaces><NetworkInterface address='127.0.0.1' multicast='true'/></Interfaces></General>"
    "<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address='127.0.0.1'/></Peers></Discovery>"
)

import time  # noqa: E402

from cyclonedds.core import Policy, Qos  # noqa: E402
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.idl import IdlStruct  # noqa: E402
from cyclonedds.idl.types import float32, float64, int8, int32, sequence, uint32  # noqa: E402
from cyclonedds.pub import DataWriter  # noqa: E402
from cyclonedds.sub import DataReader  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402
from cyclonedds.util import duration  # noqa: E402


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Vector3
    orientation: Quaternion


@dataclass
class Pair(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    first: Vector3
    second: Vector3


@dataclass
class RigidBodyCmd(IdlStruct, typename="ambf_msgs::msg::dds_::RigidBodyCmd_"):
    header: Header
    cartesian_cmd_type: int8
    pose: Pose
    wrench: Pair
    twist: Pair
    joint_cmds_types: sequence[int8]
    joint_cmds: sequence[float32]
    publish_children_names: bool
    publish_joint_names: bool
    publish_joint_positions: bool


def command(number):
    """A command with something in each field."""
    vector = Vector3(1.5, -2.5, 3.5)
    pose = Pose(vector, Quaternion(0.0, 0.0, 0.5, 0.25))
    header = Header(Time(1_700_000_000, 5), f"number {number}")
    return RigidBodyCmd(
        header, 2, pose, Pair(vector, vector), Pair(vector, vector), [0, 1, 2], [0.5, -1.0], True, False, True
    )


class Cyclone(Ros2Test):
    """Messages both ways."""

    def test_commands_come_back_as_they_were(self):
        self.peer()
        participant = DomainParticipant(self.domain)
        qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(1000))
        writer = DataWriter(participant, Topic(participant, "rt/test/Command", RigidBodyCmd, qos=qos), qos=qos)
        reader = DataReader(participant, Topic(participant, "rt/test/Echo", RigidBodyCmd, qos=qos), qos=qos)
        echoes, number, end = [], 0, time.monotonic() + PATIENCE_S
        while not echoes or echoes[-1].header.frame_id != "number 100":
            self.assertLess(time.monotonic(), end, "no echo")
            number = min(number + bool(echoes), 100)
            writer.write(command(number))
            time.sleep(0.01)
            echoes.extend(reader.take(1000))
        self.assertEqual(echoes[-1], command(100))
