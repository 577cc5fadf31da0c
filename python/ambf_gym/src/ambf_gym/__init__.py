"""Gymnasium environments in the AMBF simulator.

`SimulatorEnv` steps a `Task`, which is put together from parts of observations and actions and a few functions, in a `Backend`.
The worked tasks are registered as `ambf/Reach-v0` and `ambf/Lift-v0`.
"""

from __future__ import annotations

import gymnasium

from .backend import Backend, BodyCommand, BodyState, Commands, HoldCommand, SensorState, States
from .env import SimulatorEnv, Task, Transition
from .errors import GymError, InvalidAction, InvalidDescription, SimulatorFailed, StepMismatch
from .parts import (
    DriveBody,
    DriveJoints,
    Hold,
    Holds,
    JointEfforts,
    JointPositions,
    JointVelocities,
    Measurements,
    Position,
    Rotation,
    Twist,
)
from .scene import Scene

__all__ = [
    "Backend",
    "BodyCommand",
    "BodyState",
    "Commands",
    "DriveBody",
    "DriveJoints",
    "GymError",
    "Hold",
    "HoldCommand",
    "Holds",
    "InvalidAction",
    "InvalidDescription",
    "JointEfforts",
    "JointPositions",
    "JointVelocities",
    "Measurements",
    "Position",
    "RosBackend",
    "Rotation",
    "Scene",
    "SensorState",
    "SimulatorEnv",
    "SimulatorFailed",
    "States",
    "StepMismatch",
    "Task",
    "Transition",
    "Twist",
]

for _name in ("Reach", "Lift"):
    gymnasium.register(f"ambf/{_name}-v0", entry_point=f"ambf_gym.tasks:make_{_name.lower()}")


def __getattr__(name: str) -> object:
    # ROS is needed only by those who use it.
    if name == "RosBackend":
        from .ros_backend import RosBackend

        return RosBackend
    raise AttributeError(name)
