"""Soft bodies: of this simulator only."""

from __future__ import annotations

from typing import List, Tuple

from ambf_msgs.msg import SoftBodyCmd, SoftBodyState

from .base_object import BaseObject, number
from .ros_abstraction_layer import ral_may_come_first


class SoftBody(BaseObject):
    """A soft body, such as a cloth: the positions of its nodes, and a force on all of it."""

    _HAS_POSE_COMMAND = False

    @ral_may_come_first
    def __init__(self, a_name: str, time_out: float = 0.1) -> None:
        super().__init__(a_name, time_out, SoftBodyState(), SoftBodyCmd())
        self.object_type = "SOFT_BODY"
        self.body_type = "DYNAMIC"

    def get_num_nodes(self) -> int:
        """Number of nodes."""
        return len(self._state.userdata) // 3

    def get_nodes(self) -> List[Tuple[float, float, float]]:
        """(n x 3) positions of the nodes in the world, m."""
        xyz = iter(self._state.userdata)
        return list(zip(xyz, xyz, xyz))

    def set_force(self, fx: float, fy: float, fz: float) -> None:
        """A force on the whole, N, world axes, shared among the nodes by mass. To be refreshed, as that on a rigid body."""
        force = [number(f, "the force") for f in (fx, fy, fz)]
        with self._lock:
            cmd = self._cmd.wrench.force
            cmd.x, cmd.y, cmd.z = force
            self._apply_command()

    def _clear_command(self) -> None:
        force = self._cmd.wrench.force
        force.x = force.y = force.z = 0.0
