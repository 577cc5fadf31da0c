"""What an environment needs of a simulator, whichever way it is reached.

A backend steps one world. All of them do the same, number for number, if the simulator's steps are fixed:

* Physics iterations are a loop of *update* (Bullet), *commands*, *publish*. Between the calls of a backend it rests after the update
  of an iteration, before its commands. So commands act from the second iteration of a step on, and what is observed after `n`
  iterations is published by the n-th.
* A reset is done at that point of rest too. Nothing is left of what was before: controllers, solver and contacts forget, actuators let
  go. Simulated time and the count of iterations go on.
* Joint commands and joint states are single precision, poses and twists double.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, Mapping, NoReturn, Optional, Protocol, Sequence, Tuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from .errors import NotObserved

Value = TypeVar("Value")
Array = NDArray[np.float64]

FORCE, POSITION, VELOCITY = 0, 1, 2
"""How joints and bodies are driven."""


class Named(Dict[str, Value]):
    """Things by their names. Who asks for another name gets a NotObserved, with those that are like it."""

    def __init__(self, what: str, things: Mapping[str, Value]) -> None:
        super().__init__(things)
        self._what = what

    def __missing__(self, name: str) -> NoReturn:
        listed = difflib.get_close_matches(str(name), self, 3) or list(self)[:8]
        there = f"there are {', '.join(listed)}" if listed else "there are none"
        raise NotObserved(f'"{name}" is no {self._what}: {there}')


@dataclass
class BodyCommand:
    """What is commanded to a body and to the joints below it. The default does nothing: zero force, joints as they are."""

    kind: int = FORCE
    """Which of the following counts for the body."""
    linear: Tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Force, N; position, m; or velocity, m/s; world axes."""
    angular: Tuple[float, ...] = (0.0, 0.0, 0.0)
    """Torque, N·m; quaternion (x, y, z, w); or angular velocity, rad/s; world axes."""
    joints: Dict[str, Tuple[int, float]] = field(default_factory=dict)
    """By plain name of joint: how it is driven, and effort (N·m, N), position (rad, m) or velocity (rad/s, m/s)."""


@dataclass
class HoldCommand:
    """What is commanded to an actuator."""

    hold: bool = False
    sensor: str = ""
    """Hold what this sensor sees."""
    body: str = ""
    """Or else this body."""


@dataclass
class Commands:
    """Commands by the names of bodies and actuators."""

    bodies: Dict[str, BodyCommand] = field(default_factory=dict)
    actuators: Dict[str, HoldCommand] = field(default_factory=dict)


@dataclass
class Prepared(Commands):
    """Commands that a backend has compiled: what is in force stays, and `write` changes what differs."""

    writers: Sequence[Callable[[Array], None]] = ()
    """One a part of the action."""
    pieces: Sequence[slice] = ()
    """Where the numbers of each part stand."""
    action: Array = field(default_factory=lambda: np.zeros(0))
    """Within the bounds, in the units of the parts."""

    def write(self) -> None:
        """Puts the action in force."""
        for writer, piece in zip(self.writers, self.pieces):
            writer(self.action[piece])


@dataclass(frozen=True)
class BodyState:
    """State of a body, world axes."""

    position: Array
    """(3) m."""
    rotation: Array
    """(4) quaternion x, y, z, w."""
    linear_velocity: Array
    """(3) of the centre of mass, m/s."""
    angular_velocity: Array
    """(3) rad/s."""
    joint_positions: Dict[str, float]
    """rad or m, by plain name of joint."""
    joint_velocities: Dict[str, float]
    """rad/s or m/s."""
    joint_efforts: Dict[str, float]
    """N·m or N; 0 without `enable feedback`."""


@dataclass(frozen=True)
class SensorState:
    """State of a sensor: one number a ray."""

    measurement: Array
    """0 … 1, larger is closer, 0 is nothing."""
    sensed: Tuple[str, ...]
    """Names of what the rays see, empty for nothing."""


@dataclass(frozen=True)
class States:
    """State of everything that is observed, all of the same step."""

    sim_step: int
    """Physics iterations since the simulator started."""
    sim_time: float
    """Simulated time, s."""
    bodies: Dict[str, BodyState]
    sensors: Dict[str, SensorState]
    actuators: Dict[str, bool]
    """Whether they hold something."""
    flat: Optional[Array] = field(default=None, repr=False, compare=False)
    """All numbers in the order of `gather.Layout`, where the backend has them."""

    def __post_init__(self) -> None:
        for what, plural in (("body", "bodies"), ("sensor", "sensors"), ("actuator", "actuators")):
            things = getattr(self, plural)
            if not isinstance(things, Named):
                object.__setattr__(self, plural, named(what, things))


def named(what: str, things: Mapping[str, Value]) -> Named[Value]:
    """States of bodies, sensors or actuators, by the names with which the task names them."""
    return Named(f"{what} that the task names in its parts or in `bodies`", things)


Picture = Dict[str, NDArray[Any]]
"""`"rgb"`: (height x width x 3) uint8; `"depth"`: (height x width) float32, distance along the camera's axis, m. Top row first."""


@dataclass(frozen=True)
class Pixels:
    """A camera whose pictures are part of the observations."""

    camera: Optional[str] = None
    """Its name, or a part of it that is unique; None: the first."""
    width: int = 84
    height: int = 84
    rgb: bool = True
    """Observed under `name`: (height x width x 3) uint8."""
    depth: bool = False
    """Observed under `name` with "_depth" behind: (height x width x 1) float32, distance along the camera's axis, m."""
    depth_limit: float = float("inf")
    """Larger depths are observed as this, m."""
    name: str = "pixels"
    """Key in the dict of observations; several cameras need several."""


class Backend(Protocol):
    """One world of a simulator."""

    @property
    def interval(self) -> float:
        """Simulated time of an iteration, s."""

    def open(self, bodies: Sequence[str], sensors: Sequence[str], actuators: Sequence[str]) -> Dict[str, Sequence[str]]:
        """Connects, holds the physics, and will observe these from now on; the plain names of the joints of each body.

        Calling it again after an error starts afresh.
        """

    def step(self, commands: Commands, steps: int, reset: bool = False) -> States:
        """Puts `commands` in force, makes `steps` (1 or more) iterations and observes. With `reset` all returns to the start first.

        Raises StepMismatch if another number of iterations was made.
        """

    def close(self) -> None:
        """Lets go of the simulator; ends it if the backend has started it. May be called more than once."""

    def render(
        self, camera: Optional[str], width: Optional[int], height: Optional[int], rgb: bool, depth: bool
    ) -> Picture:
        """What a camera sees of the states that were observed last. `camera`: name, or a part of it that is unique; None: the first.

        `width`, `height`: pixels; None: as published, else 640 x 480. Raises InvalidDescription if the camera can't do that.
        """

    def show(self) -> None:
        """From the next `open` on there are windows, where there is a display. Raises InvalidDescription if there can't be any."""

    def joint_limits(self) -> Optional[Dict[str, Tuple[float, float]]]:
        """Lower and upper limit, rad or m, of the joints by name; None if the backend can't know."""


def plain(name: str) -> str:
    """The name of a joint as the simulator tells it: blanks of the scene file left out."""
    return name.replace(" ", "")


def array(values: Any) -> Array:
    """A copy of some numbers."""
    return np.array(values, dtype=np.float64)
