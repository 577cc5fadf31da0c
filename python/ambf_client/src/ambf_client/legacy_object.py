"""Objects of an older protocol, which the simulator no longer makes: kept for scripts that import the class."""

from __future__ import annotations

from typing import List

from ambf_msgs.msg import ObjectCmd, ObjectState
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3, Wrench

from .base_object import check_pose, number
from .joints import JointStates, NameOrIndex
from .rotations import quaternion_from_zyx


class Object(JointStates):
    """A body with `ObjectState` and `ObjectCmd`. Units as in `RigidBody`."""

    def __init__(self, a_name: str, time_out: float = 0.1) -> None:
        super().__init__(a_name, time_out, ObjectState(), ObjectCmd())
        self.object_type = "DEFAULT_OBJECT"
        self.body_type = "DYNAMIC"

    def get_inertia(self) -> Point:
        """Principal moments of inertia, kg·m²."""
        return self._state.pInertia

    def get_force_command(self) -> Vector3:
        """Commanded force, N."""
        return self._cmd.wrench.force

    def get_torque_command(self) -> Vector3:
        """Commanded torque, N·m."""
        return self._cmd.wrench.torque

    def get_publish_children_name_flag(self) -> bool:
        """Whether the simulator is asked for the children's names."""
        return bool(self._cmd.publish_children_names)

    def get_publish_joint_names_flag(self) -> bool:
        """Whether the simulator is asked for the joints' names."""
        return bool(self._cmd.publish_joint_names)

    def get_publish_joint_positions_flag(self) -> bool:
        """Whether the simulator is asked for joint positions."""
        return bool(self._cmd.publish_joint_positions)

    def set_publish_children_names_flag(self, state: bool) -> None:
        """Asks for the children's names."""
        self._cmd.publish_children_names = bool(state)

    def set_publish_joint_names_flag(self, state: bool) -> None:
        """Asks for the joints' names."""
        self._cmd.publish_joint_names = bool(state)

    def set_publish_joint_positions_flag(self, state: bool) -> None:
        """Asks for joint positions."""
        self._cmd.publish_joint_positions = bool(state)

    def set_force(self, fx: float, fy: float, fz: float) -> None:
        """A force, N; the commanded torque is kept."""
        torque = self._cmd.wrench.torque
        self.wrench_command(fx, fy, fz, torque.x, torque.y, torque.z)

    def set_torque(self, nx: float, ny: float, nz: float) -> None:
        """A torque, N·m; the commanded force is kept."""
        force = self._cmd.wrench.force
        self.wrench_command(force.x, force.y, force.z, nx, ny, nz)

    def set_wrench(self, wrench: Wrench) -> None:
        """A `geometry_msgs/Wrench`, N and N·m."""
        force, torque = wrench.force, wrench.torque
        self.wrench_command(force.x, force.y, force.z, torque.x, torque.y, torque.z)

    def wrench_command(self, fx: float, fy: float, fz: float, nx: float, ny: float, nz: float) -> None:
        """Force, N, and torque, N·m."""
        f = [number(value, "the wrench") for value in (fx, fy, fz, nx, ny, nz)]
        with self._lock:
            self._cmd.enable_position_controller = False
            self._cmd.wrench = Wrench(Vector3(*f[:3]), Vector3(*f[3:]))
            self._apply_command()

    def pose_command(
        self, px: float, py: float, pz: float, roll: float, pitch: float, yaw: float, *jnt_cmds: float
    ) -> None:
        """A pose, angles as in `RigidBody.pose_command`, and positions of the first joints."""
        p = [number(value, "the pose") for value in (px, py, pz, roll, pitch, yaw)]
        pose = Pose(Point(*p[:3]), Quaternion(*quaternion_from_zyx(*p[3:])))
        check_pose(pose)
        joints: List[float] = [number(value, "the command of a joint") for value in jnt_cmds]
        with self._lock:
            self.set_pose(pose)
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

    def _clear_command(self) -> None:
        self._cmd.wrench = Wrench()
