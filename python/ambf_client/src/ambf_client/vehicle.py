"""Vehicles."""

from __future__ import annotations

from typing import List, Sequence

from ambf_msgs.msg import VehicleCmd, VehicleState

from .base_object import BaseObject, number, say
from .ros_abstraction_layer import ral_may_come_first


class Vehicle(BaseObject):
    """A vehicle: power, brake and steering of its wheels. Values stay until they are changed or the client ends."""

    _HAS_POSE_COMMAND = False

    @ral_may_come_first
    def __init__(self, a_name: str, time_out: float = 0.1) -> None:
        super().__init__(a_name, time_out, VehicleState(), VehicleCmd())
        self.object_type = "VEHICLE"
        self.body_type = "DYNAMIC"
        self._steered: List[int] = []
        self._powered: List[int] = []

    def get_wheel_count(self) -> int:
        """Number of wheels."""
        return int(self._state.wheel_count)

    def check_wheel_count(self, idx: int) -> bool:
        """Whether there is a wheel `idx`; says so if not."""
        there = 0 <= idx < self.get_wheel_count()
        if not there:
            say(f"{self._name}: there is no wheel {idx}, it has {self.get_wheel_count()}")
        return there

    def set_steered_wheel_indices(self, indices: Sequence[int]) -> bool:
        """Which wheels `set_vehicle_steering` turns; False, and no change, if one does not exist."""
        return self._set_indices(self._steered, indices)

    def set_powered_wheel_indices(self, indices: Sequence[int]) -> bool:
        """Which wheels `set_vehicle_power` and `set_vehicle_brake` act on; False, and no change, if one does not exist."""
        return self._set_indices(self._powered, indices)

    def _set_indices(self, kept: List[int], indices: Sequence[int]) -> bool:
        if not all(self.check_wheel_count(idx) for idx in indices):
            return False
        kept[:] = indices
        return True

    def initialize_wheel_cmds(self) -> None:
        """All wheels straight, without power, brakes released."""
        count = self.get_wheel_count()
        with self._lock:
            self._cmd.wheel_steering = [0.0] * count
            self._cmd.wheel_power = [0.0] * count
            self._cmd.wheel_brake = [0.0] * count

    def set_vehicle_steering(self, rad: float) -> None:
        """Turns the steered wheels, rad."""
        self._set_all("wheel_steering", self._steered, rad, "set_steered_wheel_indices")

    def set_vehicle_steering_ackerman(self, rad: float) -> None:
        """The same as `set_vehicle_steering`."""
        self.set_vehicle_steering(rad)

    def set_vehicle_power(self, val: float) -> None:
        """Force of the engine on each powered wheel, N."""
        self._set_all("wheel_power", self._powered, val, "set_powered_wheel_indices")

    def set_vehicle_brake(self, val: float) -> None:
        """Brake of the powered wheels, N·s in a sub-step."""
        self._set_all("wheel_brake", self._powered, val, "set_powered_wheel_indices")

    def set_wheel_steering(self, idx: int, val: float) -> None:
        """Turns one wheel, rad."""
        self._set("wheel_steering", idx, val)

    def set_wheel_power(self, idx: int, val: float) -> None:
        """Force of the engine on one wheel, N."""
        self._set("wheel_power", idx, val)

    def set_wheel_brake(self, idx: int, val: float) -> None:
        """Brake of one wheel, N·s in a sub-step."""
        self._set("wheel_brake", idx, val)

    def _set_all(self, field: str, indices: List[int], value: float, hint: str) -> None:
        if not indices:
            say(f"{self._name}: no wheels are named; call {hint} first")
        for idx in indices:
            self._set(field, idx, value)

    def _set(self, field: str, idx: int, value: float) -> None:
        value = number(value, field)
        if not self.check_wheel_count(idx):
            return
        with self._lock:
            values = list(getattr(self._cmd, field))
            values += [0.0] * (self.get_wheel_count() - len(values))
            values[idx] = value
            setattr(self._cmd, field, values)
