"""What all objects of the simulator have in common."""

from __future__ import annotations

import math
import sys
import time
from typing import Any, List, Sequence, Tuple

from geometry_msgs.msg import Point, Pose, Quaternion
from std_msgs.msg import Header, String

from .errors import UnsupportedCommand
from .handle import Handle
from .ros_abstraction_layer import now_msg
from .rotations import quaternion_from_rpy, rpy_from_quaternion

# The children's and joints' names are in the state this long after they were asked for, s.
_ROUND_TRIP_S = 0.3


def say(text: str) -> None:
    """A line for the user."""
    print(text, file=sys.stderr)


def number(value: float, what: str) -> float:
    """`value` as a float.

    Raises ValueError if it is NaN or infinite: the simulator would refuse the whole command.
    """
    value = float(value)
    if not math.isfinite(value):
        raise ValueError(f"{what} is {value}; a command needs finite numbers")
    return value


class BaseObject(Handle):
    """An object of the simulator: its newest state, and the command that the client publishes.

    Setters change the command only; the client's thread publishes it as long as the object is active. Not for wrenches, which become
    zero when no setter was called for the time-out, a command stays until it is changed or the client ends.
    """

    # Whether commands of this type of object have a pose.
    _HAS_POSE_COMMAND = True

    def __init__(self, a_name: str, time_out: float, state: Any, command: Any) -> None:
        """`a_name`: name of the handle; `time_out` of the watch dog in s; `state` and `command`: empty messages."""
        super().__init__(a_name, time_out, state, command, topic=a_name)
        self.object_type = "BASE_OBJECT"
        self.body_type = "KINEMATIC"
        self._active_since = 0.0
        self._pose_cmd_set = False

    # --- life -------------------------------------------------------------------------------------------------------------------

    def take_step(self, state: Any) -> None:
        """Takes a state that `World.step` returned."""
        with self._arrived:
            for names in ("children_names", "joint_names"):
                if hasattr(state, names):
                    setattr(state, names, getattr(self._newest, names))
            self._state = state
            self._stepped = state.sim_step
            self._count += 1
            self._arrived.notify_all()

    def set_active(self) -> None:
        """Lets the client publish the command from now on."""
        if not self._active:
            self._active_since = time.monotonic()
        self._active = True

    def run_publisher(self) -> None:
        """Publishes the command; called by the client's thread."""
        with self._lock:
            if self.is_wd_expired():
                self._clear_command()
            if self.pub_flag and self._pub is not None:
                self._pub.publish(self._cmd)

    def close(self) -> None:
        """Ends publishing and subscribing for good."""
        self._active = False
        self._close(self._pub)
        self._close(self._sub)
        self._pub = self._sub = None

    def stop_listening(self) -> None:
        """Ends the subscription: states then come from `World.step` only."""
        self._close(self._sub)
        self._sub = None

    def _wait_for_names(self) -> None:
        """Right after activation: names that had to be asked for first may be on their way."""
        if self._active and not getattr(self._state, "children_names", True):
            left = self._active_since + _ROUND_TRIP_S - time.monotonic()
            if left > 0:
                with self._arrived:
                    self._arrived.wait_for(lambda: bool(self._state.children_names), left)

    def _clear_command(self) -> None:
        """What is left of the command when the watch dog has expired: everything."""

    def _apply_command(self) -> None:
        """Stamps the command and winds up the watch dog."""
        self._cmd.header.stamp = now_msg(self._ral)
        self.acknowledge_wd()

    # --- state ------------------------------------------------------------------------------------------------------------------

    def get_num_of_children(self) -> int:
        """Number of bodies below this one."""
        self._wait_for_names()
        return len(self._state.children_names)

    def get_children_names(self) -> List[str]:
        """Names of the bodies below this one, without namespace."""
        self._wait_for_names()
        return self._state.children_names  # type: ignore[no-any-return]

    def get_pos(self) -> Point:
        """Position, m: `geometry_msgs/Point`."""
        return self._state.pose.position

    def get_rot(self) -> Quaternion:
        """Orientation: `geometry_msgs/Quaternion`."""
        return self._state.pose.orientation

    def get_rpy(self) -> Tuple[float, float, float]:
        """Orientation as angles (roll, pitch, yaw) about the fixed axes x, y, z, rad."""
        return rpy_from_quaternion(self._state.pose.orientation)

    def get_pose(self) -> Any:
        """[x, y, z, roll, pitch, yaw], m and rad."""
        pose = self._state.pose
        return [pose.position.x, pose.position.y, pose.position.z, *rpy_from_quaternion(pose.orientation)]

    def get_pos_command(self) -> Point:
        """Commanded position, m; the present one if no pose has been commanded."""
        return self._cmd.pose.position if self._pose_cmd_set else self._state.pose.position

    def get_rot_command(self) -> Quaternion:
        """Commanded orientation; the present one if no pose has been commanded."""
        return self._cmd.pose.orientation if self._pose_cmd_set else self._state.pose.orientation

    def get_identifier(self) -> str:
        """Namespace and key of the object in its scene file."""
        return str(self._state.identifier.data)

    def get_parent_name(self) -> String:
        """Name of the parent: a `std_msgs/String`, so `.data` is the text."""
        return self._state.parent_name

    def get_msg_header(self) -> Header:
        """Header of the last state."""
        return self._state.header

    def get_msg_time_stamp(self) -> Any:
        """System time of the physics step of the last state."""
        return self._state.header.stamp

    def get_msg_seq_num(self) -> int:
        """Running number of the last state; headers of ROS 2 have none: then of those that have come."""
        return int(getattr(self._state.header, "seq", self._count))

    def get_msg_frame_id(self) -> str:
        """Frame in the last state's header: always empty."""
        return str(self._state.header.frame_id)

    # --- commands ---------------------------------------------------------------------------------------------------------------

    def set_pos(self, px: float, py: float, pz: float) -> None:
        """Commands a position, m; the commanded (else the present) orientation is kept."""
        self._check_pose_command()
        with self._lock:
            self.set_pose(Pose(position=point(px, py, pz), orientation=self.get_rot_command()))

    def set_rpy(self, roll: float, pitch: float, yaw: float) -> None:
        """Commands an orientation, angles about the fixed axes x, y, z, rad; the commanded (else the present) position is kept."""
        angles = [number(angle, name) for angle, name in ((roll, "roll"), (pitch, "pitch"), (yaw, "yaw"))]
        self.set_rot(quaternion_from_rpy(*angles))

    def set_rot(self, quat: Sequence[float]) -> None:
        """Commands an orientation, a quaternion [x, y, z, w]; the commanded (else the present) position is kept."""
        if len(quat) != 4:
            raise ValueError(f"a quaternion has four numbers, not {len(quat)}")
        rotation = quaternion([number(q, "the quaternion") for q in quat])
        self._check_pose_command()
        with self._lock:
            self.set_pose(Pose(position=self.get_pos_command(), orientation=rotation))

    def set_pose(self, pose: Pose) -> None:
        """Commands a pose, `geometry_msgs/Pose`."""
        self._check_pose_command()
        check_pose(pose)
        with self._lock:
            self._cmd.enable_position_controller = True
            self._cmd.pose = pose
            self._pose_cmd_set = True
            self._apply_command()

    def _check_pose_command(self) -> None:
        if not self._HAS_POSE_COMMAND:
            raise UnsupportedCommand(
                f"{self._name} has no poses in its commands: it is of the type {type(self).__name__}"
            )


def point(x: float, y: float, z: float) -> Point:
    """A `geometry_msgs/Point`. Raises ValueError if a number is not finite."""
    return Point(x=number(x, "x"), y=number(y, "y"), z=number(z, "z"))


def quaternion(xyzw: Sequence[float]) -> Quaternion:
    """A `geometry_msgs/Quaternion`."""
    x, y, z, w = xyzw
    return Quaternion(x=x, y=y, z=z, w=w)


def check_pose(pose: Pose) -> None:
    """Raises ValueError if a number in `pose` is not finite."""
    position, rotation = pose.position, pose.orientation
    for value in (position.x, position.y, position.z, rotation.x, rotation.y, rotation.z, rotation.w):
        number(value, "a number of the pose")
