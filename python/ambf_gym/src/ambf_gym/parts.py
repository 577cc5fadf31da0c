"""Parts of which observations and actions are put together.

Each part is a slice of a vector: `size` numbers between `low` and `high`. Names of bodies, sensors and actuators are those of topics
without `/State`, or a part that is unique.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Dict, Mapping, Optional, Protocol, Sequence, Tuple, Union

import numpy as np

from .backend import FORCE, POSITION, VELOCITY, Array, BodyCommand, Commands, HoldCommand, States, plain
from .errors import InvalidDescription

Bound = Union[float, Sequence[float], None]
Limits = Mapping[str, Tuple[float, float]]

_KINDS = {"effort": FORCE, "force": FORCE, "position": POSITION, "velocity": VELOCITY}
_INFINITY = math.inf


class ObservationPart(Protocol):
    """A slice of the observation."""

    def bounds(self, limits: Optional[Limits]) -> Tuple[Array, Array]:
        """Lower and upper bounds; `limits` are those of joints."""

    def read(self, states: States) -> Array:
        """The numbers in `states`."""


class ActionPart(Protocol):
    """A slice of the action."""

    def bounds(self, limits: Optional[Limits]) -> Tuple[Array, Array]:
        """Lower and upper bounds; `limits` are those of joints."""

    def start(self, states: States) -> None:
        """An episode begins with `states`: whatever is remembered is forgotten."""

    def write(self, values: Array, commands: Commands) -> None:
        """Puts an action into `commands`."""

    def rest(self, states: States, commands: Commands) -> None:
        """Puts into `commands` what keeps things as they are in `states`."""


def _bound(value: Bound, size: int, default: float) -> Array:
    values = np.full(size, default) if value is None else np.asarray(value, dtype=np.float64)
    if values.ndim > 1 or (values.ndim == 1 and values.size not in (1, size)):
        raise InvalidDescription(f"bounds {value} for {size} numbers")
    return np.array(np.broadcast_to(values, (size,)), dtype=np.float64)


def _joint_bounds(joints: Sequence[str], low: Bound, high: Bound, limits: Optional[Limits]) -> Tuple[Array, Array]:
    lower, upper = _bound(low, len(joints), -_INFINITY), _bound(high, len(joints), _INFINITY)
    for i, joint in enumerate(joints):
        given = (limits or {}).get(plain(joint))
        if given is not None:
            lower[i] = given[0] if low is None else lower[i]
            upper[i] = given[1] if high is None else upper[i]
    return lower, upper


# --- observations -----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class JointPositions:
    """Positions of joints below a body, rad or m. A joint may be past its limit a little, by which the bounds are wider."""

    body: str
    joints: Sequence[str]

    def bounds(self, limits: Optional[Limits]) -> Tuple[Array, Array]:
        """The joints' limits, and a tenth of the range more."""
        low, high = _joint_bounds(self.joints, None, None, limits)
        margin = np.where(np.isfinite(high - low), 0.1 * (high - low), 0.0)
        return low - margin, high + margin

    def read(self, states: States) -> Array:
        """The positions."""
        return _joint_values(states.bodies[self.body].joint_positions, self)


@dataclass(frozen=True)
class JointVelocities:
    """Velocities of joints below a body, rad/s or m/s."""

    body: str
    joints: Sequence[str]

    def bounds(self, limits: Optional[Limits]) -> Tuple[Array, Array]:
        """None."""
        return _unbounded(len(self.joints))

    def read(self, states: States) -> Array:
        """The velocities."""
        return _joint_values(states.bodies[self.body].joint_velocities, self)


@dataclass(frozen=True)
class JointEfforts:
    """Efforts of joints below a body that have `enable feedback`, N·m or N."""

    body: str
    joints: Sequence[str]

    def bounds(self, limits: Optional[Limits]) -> Tuple[Array, Array]:
        """None."""
        return _unbounded(len(self.joints))

    def read(self, states: States) -> Array:
        """The efforts."""
        return _joint_values(states.bodies[self.body].joint_efforts, self)


@dataclass(frozen=True)
class Position:
    """Position of a body in the world, or from the position of another one, world axes, m."""

    body: str
    relative_to: Optional[str] = None

    def bounds(self, limits: Optional[Limits]) -> Tuple[Array, Array]:
        """None."""
        return _unbounded(3)

    def read(self, states: States) -> Array:
        """x, y, z."""
        position = states.bodies[self.body].position
        return position if self.relative_to is None else position - states.bodies[self.relative_to].position


@dataclass(frozen=True)
class Rotation:
    """Orientation of a body: the quaternion x, y, z, w with w ≥ 0."""

    body: str

    def bounds(self, limits: Optional[Limits]) -> Tuple[Array, Array]:
        """-1 … 1, w 0 … 1, and a little for rounding."""
        return np.array([-1.0, -1.0, -1.0, 0.0]) - 1e-6, np.ones(4) + 1e-6

    def read(self, states: States) -> Array:
        """x, y, z, w."""
        rotation = states.bodies[self.body].rotation
        return -rotation if rotation[3] < 0.0 else rotation


@dataclass(frozen=True)
class Twist:
    """Velocity of the centre of mass, m/s, and angular velocity, rad/s, world axes."""

    body: str

    def bounds(self, limits: Optional[Limits]) -> Tuple[Array, Array]:
        """None."""
        return _unbounded(6)

    def read(self, states: States) -> Array:
        """Linear, angular."""
        state = states.bodies[self.body]
        return np.concatenate((state.linear_velocity, state.angular_velocity))


@dataclass(frozen=True)
class Measurements:
    """What the first `rays` rays of a proximity sensor measure: 0 … 1, larger is closer, 0 is nothing."""

    sensor: str
    rays: int = 1

    def bounds(self, limits: Optional[Limits]) -> Tuple[Array, Array]:
        """0 … 1."""
        return np.zeros(self.rays), np.ones(self.rays)

    def read(self, states: States) -> Array:
        """One number a ray."""
        measured = states.sensors[self.sensor].measurement[: self.rays]
        return np.concatenate((measured, np.zeros(self.rays - len(measured))))


@dataclass(frozen=True)
class Holds:
    """Whether an actuator holds something: 1, else 0."""

    actuator: str

    def bounds(self, limits: Optional[Limits]) -> Tuple[Array, Array]:
        """0 … 1."""
        return np.zeros(1), np.ones(1)

    def read(self, states: States) -> Array:
        """One number."""
        return np.array([float(states.actuators[self.actuator])])


def _unbounded(size: int) -> Tuple[Array, Array]:
    return np.full(size, -_INFINITY), np.full(size, _INFINITY)


def _joint_values(values: Dict[str, float], part: Any) -> Array:
    return np.array([values[plain(joint)] for joint in part.joints], dtype=np.float64)


# --- actions ----------------------------------------------------------------------------------------------------------------------


@dataclass
class DriveJoints:
    """Commands joints below a body."""

    body: str
    joints: Sequence[str]
    mode: str = "position"
    """`position` (rad, m), `velocity` (rad/s, m/s) or `effort` (N·m, N)."""
    low: Bound = None
    """Lower bounds; for positions those of the joints if not given."""
    high: Bound = None
    """Upper bounds."""
    increment: Bound = None
    """For positions: actions lie between -`increment` and `increment` and move a set point, which stays within the bounds."""
    tied: bool = False
    """One number for all of the joints, such as the fingers of a jaw; its bounds are those that hold for each of them."""
    at_rest: Optional[float] = None
    """For positions, rad or m: where the joints are kept before an episode's first action. None: where they are."""
    _set_point: Array = field(init=False, repr=False)
    _low: Array = field(init=False, repr=False)
    _high: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.mode not in ("position", "velocity", "effort"):
            raise InvalidDescription(f'joints are driven by "position", "velocity" or "effort", not "{self.mode}"')
        if self.increment is not None and self.mode != "position":
            raise InvalidDescription("only positions have increments")
        if self.at_rest is not None and self.mode != "position":
            raise InvalidDescription("only positions have a position at rest")
        self._set_point = np.zeros(len(self.joints))

    def bounds(self, limits: Optional[Limits]) -> Tuple[Array, Array]:
        """As given, or the joints' limits."""
        self._low, self._high = _joint_bounds(
            self.joints, self.low, self.high, limits if self.mode == "position" else None
        )
        if self.tied:
            self._low, self._high = self._low.max(keepdims=True), self._high.min(keepdims=True)
        if not (np.isfinite(self._low) & np.isfinite(self._high) & (self._low < self._high)).all():
            raise InvalidDescription(f"{self.mode} of {', '.join(self.joints)}: give low and high, the scene does not")
        if self.increment is None:
            return self._low, self._high
        increment = _bound(self.increment, len(self._low), 0.0)
        return -increment, increment

    @property
    def span(self) -> Tuple[Array, Array]:
        """Bounds of the set point."""
        return self._low, self._high

    def start(self, states: States) -> None:
        """The set point is where the joints are."""
        self._set_point[...] = _joint_values(states.bodies[self.body].joint_positions, self)

    @property
    def set_point(self) -> Array:
        """Where increments have led."""
        return self._set_point

    def keep_in(self, row: Array) -> None:
        """The set point is kept in this array from now on, which holds it."""
        self._set_point = row

    def write(self, values: Array, commands: Commands) -> None:
        """One number a joint, or for all of them."""
        self._put(self.targets(values), commands)

    def targets(self, values: Array) -> Array:
        """What the joints are told; increments move the set point."""
        if self.increment is None:
            return values
        return move(self._set_point, values, self._low, self._high)

    def rest(self, states: States, commands: Commands) -> None:
        """Positions as they are, or `at_rest`; velocity and effort zero."""
        if self.mode == "position" and self.at_rest is None:
            self._put(_joint_values(states.bodies[self.body].joint_positions, self), commands)
        else:
            self._put(np.array([self.at_rest or 0.0]), commands)

    def _put(self, values: Array, commands: Commands) -> None:
        command = commands.bodies.setdefault(self.body, BodyCommand())
        of_each = np.broadcast_to(values, (len(self.joints),)).tolist()
        command.joints.update({plain(joint): (_KINDS[self.mode], value) for joint, value in zip(self.joints, of_each)})


def move(set_points: Array, by: Array, low: Array, high: Array) -> Array:
    """Moves set points (… x joints) within bounds."""
    set_points += by
    np.maximum(set_points, low, out=set_points)
    np.minimum(set_points, high, out=set_points)
    return set_points


@dataclass
class DriveBody:
    """Commands a body: three numbers, world axes, or six with rotation (torque or angular velocity)."""

    body: str
    mode: str = "force"
    """`force` (N, N·m), `velocity` (m/s, rad/s) or `position` (m; three numbers, the orientation stays)."""
    low: Bound = None
    high: Bound = None
    size: int = 3
    _rotation: Tuple[float, ...] = field(init=False, default=(0.0, 0.0, 0.0, 1.0), repr=False)

    def __post_init__(self) -> None:
        if self.mode not in ("force", "velocity", "position"):
            raise InvalidDescription(f'a body is driven by "force", "velocity" or "position", not "{self.mode}"')
        if self.size not in ((3,) if self.mode == "position" else (3, 6)):
            raise InvalidDescription(f"{self.mode} of {self.body}: {self.size} numbers")

    def bounds(self, limits: Optional[Limits]) -> Tuple[Array, Array]:
        """As given."""
        low, high = _bound(self.low, self.size, -_INFINITY), _bound(self.high, self.size, _INFINITY)
        if not (np.isfinite(low) & np.isfinite(high) & (low < high)).all():
            raise InvalidDescription(f"{self.mode} of {self.body}: give low and high")
        return low, high

    def start(self, states: States) -> None:
        """The orientation is what it is."""
        self._rotation = tuple(states.bodies[self.body].rotation)

    def write(self, values: Array, commands: Commands) -> None:
        """Linear, angular."""
        command = commands.bodies.setdefault(self.body, BodyCommand())
        command.kind = _KINDS[self.mode]
        x, y, z = (float(v) for v in values[:3])
        command.linear = (x, y, z)
        if self.mode == "position":
            command.angular = self._rotation
        else:
            command.angular = tuple(float(v) for v in values[3:6]) if self.size == 6 else (0.0, 0.0, 0.0)

    def rest(self, states: States, commands: Commands) -> None:
        """No force, no velocity, the pose as it is."""
        self.start(states)
        position = states.bodies[self.body].position
        self.write(position if self.mode == "position" else np.zeros(self.size), commands)


@dataclass
class Hold:
    """One number: above 0 an actuator holds what a sensor sees, or a body; else it lets go."""

    actuator: str
    sensor: str = ""
    """Identifier of the sensor, or a part of it that is unique."""
    body: str = ""
    """Or the identifier of the body."""

    def bounds(self, limits: Optional[Limits]) -> Tuple[Array, Array]:
        """-1 … 1."""
        return -np.ones(1), np.ones(1)

    def start(self, states: States) -> None:
        """Nothing is remembered."""

    def write(self, values: Array, commands: Commands) -> None:
        """One number."""
        commands.actuators[self.actuator] = HoldCommand(bool(values[0] > 0.0), self.sensor, self.body)

    def rest(self, states: States, commands: Commands) -> None:
        """Lets go."""
        commands.actuators[self.actuator] = HoldCommand()
