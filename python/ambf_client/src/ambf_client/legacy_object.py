"""Objects of an older protocol, which the simulator no longer makes: kept for scripts that import the class."""

from __future__ import annotations

from typing import List

from ambf_msgs.msg import ObjectCmd, ObjectState

from .base_object import number
from .body import Body
from .joints import NameOrIndex
from .ros_abstraction_layer import ral_may_come_first


class Object(Body):
    """A body with `ObjectState` and `ObjectCmd`. Units as in `RigidBody`."""

    @ral_may_come_first
    def __init__(self, a_name: str, time_out: float = 0.1) -> None:
        super().__init__(a_name, time_out, ObjectState(), ObjectCmd())
        self.object_type = "DEFAULT_OBJECT"
        self.body_type = "DYNAMIC"

    def _choose_wrench(self) -> None:
        self._cmd.enable_position_controller = False

    def pose_command(
        self, px: float, py: float, pz: float, roll: float, pitch: float, yaw: float, *jnt_cmds: float
    ) -> None:
        """A pose, angles as in `RigidBody.pose_command`, and positions of the first joints."""
        joints: List[float] = [number(value, "the command of a joint") for value in jnt_cmds]
        with self._lock:
            super().pose_command(px, py, pz, roll, pitch, yaw)
            self._cmd.joint_cmds = joints
            self._cmd.position_controller_mask = [True] * len(joints)

    def set_joint_pos(self, joint_name_or_idx: NameOrIndex, pos: float) -> None:
        """Lets the joint follow a position, rad or m."""
        self._set_joint(joint_name_or_idx, pos, True)

    def set_joint_effort(self, joint_name_or_idx: NameOrIndex, effort: float) -> None:
        """Drives the joint with a torque or force, N·m or N."""
        self._set_joint(joint_name_or_idx, effort, False)

    def _set_joint(self, name_or_idx: NameOrIndex, value: float, is_position: bool) -> None:
        value = number(value, "the command of a joint")
        index = self._index(name_or_idx)
        if index is None:
            return
        with self._lock:
            missing = self.get_num_joints() - len(self._cmd.joint_cmds)
            self._cmd.joint_cmds = [*self._cmd.joint_cmds, *[0.0] * missing]
            self._cmd.position_controller_mask = [*self._cmd.position_controller_mask, *[False] * missing]
            self._cmd.joint_cmds[index] = value
            self._cmd.position_controller_mask[index] = is_position
            self._apply_command()
