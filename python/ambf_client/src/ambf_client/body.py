"""What rigid bodies and the bodies of an older protocol have in common."""

from __future__ import annotations

from geometry_msgs.msg import Point, Pose, Vector3, Wrench

from .base_object import number, point, quaternion
from .joints import JointStates
from .rotations import quaternion_from_zyx


class Body(JointStates):
    """A body that takes wrenches and poses, and is asked what to say about itself."""

    def get_inertia(self) -> Point:
        """Principal moments of inertia, kg·m²."""
        state = self._state
        # ROS 2 refuses the name that it has in ROS 1.
        return state.p_inertia if hasattr(state, "p_inertia") else state.pInertia

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
        """Asks for the children's names; they stay once asked for."""
        self._cmd.publish_children_names = bool(state)

    def set_publish_joint_names_flag(self, state: bool) -> None:
        """Asks for the joints' names; they stay once asked for."""
        self._cmd.publish_joint_names = bool(state)

    def set_publish_joint_positions_flag(self, state: bool) -> None:
        """Asks for positions, velocities and efforts of the joints."""
        self._cmd.publish_joint_positions = bool(state)

    # --- wrench -----------------------------------------------------------------------------------------------------------------

    def set_force(self, fx: float, fy: float, fz: float) -> None:
        """A force at the centre of mass, N, world axes; the commanded torque is kept. To be refreshed at 10 Hz or more."""
        with self._lock:
            self.set_wrench(Wrench(force=vector(fx, fy, fz), torque=self._cmd.wrench.torque))

    def set_torque(self, nx: float, ny: float, nz: float) -> None:
        """A torque, N·m, world axes; the commanded force is kept. To be refreshed at 10 Hz or more."""
        with self._lock:
            self.set_wrench(Wrench(force=self._cmd.wrench.force, torque=vector(nx, ny, nz)))

    def wrench_command(self, fx: float, fy: float, fz: float, nx: float, ny: float, nz: float) -> None:
        """Force, N, and torque, N·m, world axes. To be refreshed at 10 Hz or more."""
        self.set_wrench(Wrench(force=vector(fx, fy, fz), torque=vector(nx, ny, nz)))

    def set_wrench(self, wrench: Wrench) -> None:
        """A `geometry_msgs/Wrench`, N and N·m, world axes. To be refreshed at 10 Hz or more."""
        check_vectors(wrench.force, wrench.torque)
        with self._lock:
            self._choose_wrench()
            self._cmd.wrench = wrench
            self._apply_command()

    def _choose_wrench(self) -> None:
        """The wrench counts from now on, not the pose."""
        raise NotImplementedError

    def _clear_command(self) -> None:
        self._cmd.wrench = Wrench()

    # --- pose -------------------------------------------------------------------------------------------------------------------

    def pose_command(
        self, px: float, py: float, pz: float, roll: float, pitch: float, yaw: float, *jnt_cmds: float
    ) -> None:
        """A pose with the angles as the C++ simulator's client takes them: `roll` about z, `pitch` about y, `yaw` about x, in this order.

        New programs use `set_pose_rpy`. `jnt_cmds` have no effect.
        """
        del jnt_cmds
        angles = [number(angle, "an angle") for angle in (roll, pitch, yaw)]
        rotation = quaternion(quaternion_from_zyx(*angles))
        self.set_pose(Pose(position=point(px, py, pz), orientation=rotation))


def vector(x: float, y: float, z: float) -> Vector3:
    """A `geometry_msgs/Vector3`. Raises ValueError if a number is not finite."""
    return Vector3(x=number(x, "x"), y=number(y, "y"), z=number(z, "z"))


def check_vectors(*vectors: Vector3) -> None:
    """Raises ValueError if a number in `vectors` is not finite."""
    for each in vectors:
        vector(each.x, each.y, each.z)
