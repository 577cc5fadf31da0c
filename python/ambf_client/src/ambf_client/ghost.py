"""Ghost objects."""

from __future__ import annotations

from typing import List, Optional

from ambf_msgs.msg import GhostObjectCmd, GhostObjectState

from .base_object import BaseObject
from .ros_abstraction_layer import ral_may_come_first


class GhostObject(BaseObject):
    """A ghost object: where it is in the world, and which bodies overlap it. It has no commands."""

    _HAS_POSE_COMMAND = False

    @ral_may_come_first
    def __init__(self, a_name: str, time_out: float = 0.1) -> None:
        super().__init__(a_name, time_out, GhostObjectState(), GhostObjectCmd())
        self.object_type = "GHOST"

    def get_num_sensed_obj(self) -> int:
        """Number of bodies inside."""
        return len(self._state.sensed_objects)

    def get_sensed_obj_name(self, i: int) -> Optional[str]:
        """Identifier (namespace and key) of body `i` of those inside; None if there is no such body."""
        names = self.get_all_sensed_obj_names()
        return names[i] if 0 <= i < len(names) else None

    def get_all_sensed_obj_names(self) -> List[str]:
        """Identifiers (namespace and key) of the bodies inside, as `Actuator.actuate` takes them."""
        return [str(each.data) for each in self._state.sensed_objects]

    def get_bodies_inside(self) -> List[str]:
        """The same as `get_all_sensed_obj_names`."""
        return self.get_all_sensed_obj_names()
