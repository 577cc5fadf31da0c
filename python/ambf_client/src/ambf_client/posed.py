"""Cameras and lights: objects that only have a pose."""

from __future__ import annotations

from ambf_msgs.msg import CameraCmd, CameraState, LightCmd, LightState

from .base_object import BaseObject
from .ros_abstraction_layer import ral_may_come_first


class Camera(BaseObject):
    """A camera. Its pose is in the frame of its parent; it looks along its -x axis, z is up."""

    @ral_may_come_first
    def __init__(self, a_name: str, time_out: float = 0.1) -> None:
        super().__init__(a_name, time_out, CameraState(), CameraCmd())
        self.object_type = "CAMERA"


class Light(BaseObject):
    """A light. Its pose is in the frame of its parent; it shines along its x axis."""

    @ral_may_come_first
    def __init__(self, a_name: str, time_out: float = 0.1) -> None:
        super().__init__(a_name, time_out, LightState(), LightCmd())
        self.object_type = "LIGHT"
