"""Constraint actuators."""

from __future__ import annotations

from typing import Optional

from ambf_msgs.msg import ActuatorCmd, ActuatorState
from geometry_msgs.msg import Pose

from .base_object import BaseObject, check_pose
from .ros_abstraction_layer import ral_may_come_first


class Actuator(BaseObject):
    """Holds a body, or what a sensor sees, as long as the client runs. It holds one thing: release it before you hold another."""

    _HAS_POSE_COMMAND = False

    @ral_may_come_first
    def __init__(self, a_name: str, time_out: float = 0.1) -> None:
        super().__init__(a_name, time_out, ActuatorState(), ActuatorCmd())
        self.object_type = "ACTUATOR"

    def is_actuated(self) -> bool:
        """Whether it holds something."""
        return bool(self._state.actuated)

    def actuate(self, obj_name: str, pose: Optional[Pose] = None) -> None:
        """Holds the body called `obj_name`: its identifier, or any part of it that is unique.

        `pose`: where the actuator is to be in the inertial frame of that body; without it, where it is now.
        """
        if pose is not None:
            check_pose(pose)
        with self._lock:
            self._cmd.actuate = True
            self._cmd.use_sensor_data = False
            self._cmd.body_name.data = str(obj_name)
            self._cmd.use_offset = pose is not None
            if pose is not None:
                self._cmd.body_offset = pose

    def actuate_from_sensor_data(self, sensor_identifier: str) -> None:
        """Holds what the sensor `sensor_identifier` sees: its identifier, or any part of it that is unique."""
        with self._lock:
            self._cmd.actuate = True
            self._cmd.use_sensor_data = True
            self._cmd.sensor_identifier.data = str(sensor_identifier)

    def deactuate(self) -> None:
        """Lets go."""
        with self._lock:
            self._cmd.actuate = False
            self._cmd.use_sensor_data = False
            self._cmd.sensor_identifier.data = ""
