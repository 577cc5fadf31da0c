"""Rigid bodies and the joints below them."""

from __future__ import annotations

from typing import Any, Optional, Sequence

from ambf_msgs.msg import RigidBodyCmd, RigidBodyState
from geometry_msgs.msg import Pose, Twist, Vector3

from .base_object import check_pose, number, point, quaternion, say
from .body import Body, check_vectors, vector
from .joints import NameOrIndex
from .ros_abstraction_layer import ral_may_come_first
from .rotations import quaternion_from_rpy


class RigidBody(Body):
    """A rigid body: pose, twist, and the joints below it.

    It is driven in one of three ways, by the last setter: with a wrench, which ends 0.1 s after the last setter; to a pose; with a
    twist. Joint commands are independent of that.

    Commanding joint k makes the joints before it follow an effort of 0, which means that they are free, unless they were commanded
    too: joint commands are one array.
    """

    @ral_may_come_first
    def __init__(self, a_name: str, time_out: float = 0.1) -> None:
        super().__init__(a_name, time_out, RigidBodyState(), RigidBodyCmd())
        self.object_type = "RIGID_BODY"
        self.body_type = "DYNAMIC"
        self._twist_cmd_set = False

    # --- state ------------------------------------------------------------------------------------------------------------------

    def get_linear_vel(self) -> Vector3:
        """Velocity of the centre of mass, m/s, world axes."""
        return self._state.twist.linear

    def get_angular_vel(self) -> Vector3:
        """Angular velocity, rad/s, world axes."""
        return self._state.twist.angular

    def get_mass(self) -> float:
        """Mass, kg; 0 is static."""
        return float(self._state.mass)

    def get_joint_vel(self, joint_name_or_idx: NameOrIndex) -> Optional[float]:
        """Velocity of a joint, rad/s or m/s; None if there is no such joint."""
        return self._value(self._state.joint_velocities, joint_name_or_idx)

    def get_joint_effort(self, joint_name_or_idx: NameOrIndex) -> Optional[float]:
        """Effort of a joint with `enable feedback`, N·m or N, else 0; None if there is no such joint."""
        return self._value(self._state.joint_efforts, joint_name_or_idx)

    def get_all_joint_vel(self) -> Any:
        """Velocities of all joints, rad/s or m/s."""
        return self._state.joint_velocities

    def get_all_joint_effort(self) -> Any:
        """Efforts of all joints, N·m or N."""
        return self._state.joint_efforts

    # --- the command as it is ---------------------------------------------------------------------------------------------------

    def get_linear_velocity_command(self) -> Vector3:
        """Commanded velocity, m/s; the present one if no twist has been commanded."""
        return self._cmd.twist.linear if self._twist_cmd_set else self._state.twist.linear

    def get_angular_velocity_command(self) -> Vector3:
        """Commanded angular velocity, rad/s; the present one if no twist has been commanded."""
        return self._cmd.twist.angular if self._twist_cmd_set else self._state.twist.angular

    def _choose_wrench(self) -> None:
        self._cmd.cartesian_cmd_type = RigidBodyCmd.TYPE_FORCE

    # --- pose -------------------------------------------------------------------------------------------------------------------

    def set_pose(self, pose: Pose) -> None:
        """A pose of the body frame in the world, `geometry_msgs/Pose`: set directly on a static body, else followed by a controller."""
        check_pose(pose)
        with self._lock:
            self._cmd.cartesian_cmd_type = RigidBodyCmd.TYPE_POSITION
            self._cmd.pose = pose
            self._pose_cmd_set = True
            self._apply_command()

    def set_pose_rpy(self, px: float, py: float, pz: float, roll: float, pitch: float, yaw: float) -> None:
        """A pose: position, m, and angles about the fixed axes x, y, z, rad, as in `set_rpy` and `get_rpy`."""
        angles = [number(angle, "an angle") for angle in (roll, pitch, yaw)]
        rotation = quaternion(quaternion_from_rpy(*angles))
        self.set_pose(Pose(position=point(px, py, pz), orientation=rotation))

    # --- twist ------------------------------------------------------------------------------------------------------------------

    def set_linear_vel(self, vx: float, vy: float, vz: float) -> None:
        """A velocity of the centre of mass, m/s, world axes; the commanded angular velocity is kept."""
        with self._lock:
            self.set_twist(Twist(linear=vector(vx, vy, vz), angular=self._cmd.twist.angular))

    def set_angular_vel(self, ax: float, ay: float, az: float) -> None:
        """An angular velocity, rad/s, world axes; the commanded velocity is kept."""
        with self._lock:
            self.set_twist(Twist(linear=self._cmd.twist.linear, angular=vector(ax, ay, az)))

    def velocity_command(self, vx: float, vy: float, vz: float, ax: float, ay: float, az: float) -> None:
        """Velocity of the centre of mass, m/s, and angular velocity, rad/s, world axes."""
        self.set_twist(Twist(linear=vector(vx, vy, vz), angular=vector(ax, ay, az)))

    def set_twist(self, twist: Twist) -> None:
        """A `geometry_msgs/Twist`, m/s and rad/s, world axes."""
        check_vectors(twist.linear, twist.angular)
        with self._lock:
            self._cmd.cartesian_cmd_type = RigidBodyCmd.TYPE_VELOCITY
            self._cmd.twist = twist
            self._twist_cmd_set = True
            self._apply_command()

    # --- joints -----------------------------------------------------------------------------------------------------------------

    def set_joint_pos(self, joint_name_or_idx: NameOrIndex, pos: float) -> None:
        """Lets the joint's controller follow a position, rad or m. Nothing happens, but a line says so, if there is no such joint."""
        self._set_joint(joint_name_or_idx, pos, RigidBodyCmd.TYPE_POSITION)

    def set_joint_vel(self, joint_name_or_idx: NameOrIndex, vel: float) -> None:
        """Lets the joint's motor hold a velocity, rad/s or m/s."""
        self._set_joint(joint_name_or_idx, vel, RigidBodyCmd.TYPE_VELOCITY)

    def set_joint_effort(self, joint_name_or_idx: NameOrIndex, effort: float) -> None:
        """Drives the joint with a torque or force, N·m or N."""
        self._set_joint(joint_name_or_idx, effort, RigidBodyCmd.TYPE_FORCE)

    def set_multiple_joint_pos(self, values: Sequence[float], indices: Sequence[int]) -> None:
        """Positions, rad or m, for the joints `indices`.

        If `values` reaches that far it is addressed by joint, as in the C++ simulator's client: joint i gets `values[i]`. Else it
        must be as long as `indices`, and joint `indices[k]` gets `values[k]`.
        """
        self._set_joints(values, indices, RigidBodyCmd.TYPE_POSITION)

    def set_multiple_joint_vel(self, values: Sequence[float], indices: Sequence[int]) -> None:
        """Velocities, rad/s or m/s, for the joints `indices`; see `set_multiple_joint_pos`."""
        self._set_joints(values, indices, RigidBodyCmd.TYPE_VELOCITY)

    def set_multiple_joint_effort(self, values: Sequence[float], indices: Sequence[int]) -> None:
        """Efforts, N·m or N, for the joints `indices`; see `set_multiple_joint_pos`."""
        self._set_joints(values, indices, RigidBodyCmd.TYPE_FORCE)

    def resize_joint_cmd_array(self, req_len: int) -> bool:
        """Makes the arrays of joint commands at least `req_len` long; new entries are efforts of 0. They never become shorter.

        False, and a line that says so, if there are not so many joints.
        """
        if req_len > self.get_num_joints():
            say(f"{self._name}: {req_len} joint commands, but {self.get_num_joints()} joints")
            return False
        with self._lock:
            missing = req_len - len(self._cmd.joint_cmds)
            if missing > 0:
                self._cmd.joint_cmds = [*self._cmd.joint_cmds, *[0.0] * missing]
                self._cmd.joint_cmds_types = [*self._cmd.joint_cmds_types, *[RigidBodyCmd.TYPE_FORCE] * missing]
        return True

    def _set_joint(self, name_or_idx: NameOrIndex, value: float, kind: int) -> None:
        value = number(value, "the command of a joint")
        index = self._index(name_or_idx)
        if index is None:
            return
        with self._lock:
            if self.resize_joint_cmd_array(index + 1):
                self._cmd.joint_cmds[index] = value
                self._cmd.joint_cmds_types[index] = kind
                self._apply_command()

    def _set_joints(self, values: Sequence[float], indices: Sequence[int], kind: int) -> None:
        if not all(self.is_joint_idx_valid(index) for index in indices) or len(indices) == 0:
            return
        if max(indices) < len(values):
            pairs = [(index, values[index]) for index in indices]
        elif len(values) == len(indices):
            pairs = list(zip(indices, values))
        else:
            say(f"{self._name}: {len(values)} values for {len(indices)} joints; nothing is commanded")
            return
        with self._lock:
            for index, value in pairs:
                self._set_joint(index, value, kind)
