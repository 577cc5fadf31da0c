"""Gymnasium environments in the AMBF simulator.

`SimulatorEnv` steps a `Task`, which is put together from parts of observations and actions and a few functions, in a `Backend`:
`RosBackend`, or `InProcessBackend` with the package `ambf`. `InProcessVectorEnv` steps many at once.
The worked tasks are registered as `ambf/Reach-v0`, `ambf/Lift-v0`, `ambf/NeedlePick-v0`, `ambf/PegTransfer-v0`, `ambf/PegLift-v0` and
`ambf/RingOnWire-v0`.
"""

from __future__ import annotations

import importlib

import gymnasium

from .backend import Backend, BodyCommand, BodyState, Commands, HoldCommand, Pixels, SensorState, States
from .env import SimulatorEnv, Task, Transition
from .errors import GymError, InvalidAction, InvalidDescription, NotObserved, SimulatorFailed, StepMismatch
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
    "InProcessBackend",
    "InProcessVectorEnv",
    "InvalidAction",
    "InvalidDescription",
    "JointEfforts",
    "JointPositions",
    "JointVelocities",
    "Measurements",
    "NotObserved",
    "Pixels",
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
    "Worlds",
]

for _name, _function, _steps in (
    ("Reach", "reach", 50),
    ("Lift", "lift", 200),
    ("NeedlePick", "needle_pick", 400),
    ("PegTransfer", "peg_transfer", 3600),
    ("PegLift", "peg_lift", 100),
    ("RingOnWire", "ring_on_wire", 2400),
):
    gymnasium.register(
        f"ambf/{_name}-v0",
        max_episode_steps=_steps,
        entry_point=f"ambf_gym.tasks:make_{_function}",
        vector_entry_point=f"ambf_gym.tasks:make_{_function}_vec",
    )


# ROS and the module of the simulator are needed only by those who use them.
_LAZY = {
    "RosBackend": "ros_backend",
    "InProcessBackend": "in_process",
    "InProcessVectorEnv": "vector",
    "Worlds": "worlds",
}


def __getattr__(name: str) -> object:
    if name in _LAZY:
        return getattr(importlib.import_module(f"{__name__}.{_LAZY[name]}"), name)
    raise AttributeError(f"module {__name__} has no attribute {name}")
