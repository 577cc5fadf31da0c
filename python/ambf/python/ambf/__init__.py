"""The AMBF simulator in the Python process: no ROS, no clock, the physics moves when it is told to.

import ambf

sim = ambf.Simulation(ambf.resources() / 'models/arm7.yaml', profile='accurate')
arm, flange = sim.body('arm7/base'), sim.body('arm7/flange')
arm.joint_kinds[:] = ambf.POSITION
arm.joint_commands[:] = 0.3
sim.step(1000)
print(sim.sim_time, arm.joint_positions, flange.pose)
"""

from __future__ import annotations

from ._ambf import State
from ._ambf import version as __version__
from .arms import Arm, Cartesian, Joints, OperatingState
from .arrays import EFFORT, FORCE, NONE, POSITION, VELOCITY
from .batch import Batch, BatchContacts
from .errors import (
    AmbfError,
    BusyError,
    ClosedError,
    ExportError,
    InvalidCommand,
    LoadError,
    NonFiniteError,
    NotFoundError,
    RecordingError,
    RenderError,
    StateError,
    TreeError,
)
from .recording import Recording
from .scenes import resources
from .simulation import (
    Actuator,
    Body,
    Contacts,
    Coupling,
    PassiveBody,
    Rays,
    Sensor,
    Simulation,
    StackedStates,
    Viewer,
    stack_states,
    step_all,
)
from .tree import Reached, Tree
from .volumes import Carved, Label, Volume

__all__ = [
    "EFFORT",
    "FORCE",
    "NONE",
    "POSITION",
    "VELOCITY",
    "Actuator",
    "AmbfError",
    "Arm",
    "Batch",
    "BatchContacts",
    "Body",
    "BusyError",
    "Cartesian",
    "Carved",
    "ClosedError",
    "Contacts",
    "Coupling",
    "ExportError",
    "InvalidCommand",
    "Joints",
    "Label",
    "LoadError",
    "NonFiniteError",
    "NotFoundError",
    "OperatingState",
    "PassiveBody",
    "Rays",
    "Reached",
    "Recording",
    "RecordingError",
    "RenderError",
    "Sensor",
    "Simulation",
    "StackedStates",
    "State",
    "StateError",
    "Tree",
    "TreeError",
    "Viewer",
    "Volume",
    "__version__",
    "resources",
    "stack_states",
    "step_all",
]
