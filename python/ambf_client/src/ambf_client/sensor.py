"""Proximity and resistance sensors."""

from __future__ import annotations

from typing import List, Optional

from ambf_msgs.msg import SensorCmd, SensorState
from geometry_msgs.msg import Pose
from std_msgs.msg import String

from .base_object import BaseObject
from .ros_abstraction_layer import ral_may_come_first


class Sensor(BaseObject):
    """A proximity or resistance sensor. It has one entry a ray."""

    _HAS_POSE_COMMAND = False

    @ral_may_come_first
    def __init__(self, a_name: str, time_out: float = 0.1) -> None:
        super().__init__(a_name, time_out, SensorState(), SensorCmd())
        self.object_type = "SENSOR"

    def get_type(self) -> str:
        """`PROXIMITY` or `RESISTANCE`."""
        return str(self._state.type.data)

    def get_count(self) -> int:
        """Number of rays."""
        return int(self._state.count)

    def is_triggered(self, idx: int) -> Optional[bool]:
        """Whether ray `idx` sees something; None if there is no such ray."""
        return bool(self._state.triggered[idx]) if 0 <= idx < len(self._state.triggered) else None

    def get_range(self, idx: int = 0) -> Optional[float]:
        """Range of the rays, m. Only `idx` 0 exists."""
        return float(self._state.range[idx]) if 0 <= idx < len(self._state.range) else None

    def get_measurement(self, idx: int) -> Optional[float]:
        """0 … 1, larger is closer, 0 is nothing."""
        return float(self._state.measurement[idx]) if 0 <= idx < len(self._state.measurement) else None

    def get_all_measurements(self) -> List[float]:
        """`get_measurement` of all."""
        return list(self._state.measurement)

    def get_sensed_object(self, idx: int) -> Optional[str]:
        """Name of the body that ray `idx` sees, without namespace; empty if none."""
        seen = self._state.sensed_objects
        return str(seen[idx].data) if 0 <= idx < len(seen) else None

    def get_parent(self) -> String:
        """Name of the parent body: a `std_msgs/String`."""
        return self._state.parent_name

    def get_pose(self) -> Pose:
        """Pose in the frame of the parent body: a `geometry_msgs/Pose`, unlike that of other objects."""
        return self._state.pose
