"""Observations as places in one flat array of all states, which are found once.

The numbers of a world are, in this order: poses (7 a body), twists (6 a body), positions, velocities and efforts of joints, measurements of
rays, what actuators hold (1 or 0), and a zero. Joints and rays are in single precision, as over ROS.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Dict, List, NamedTuple, Protocol, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from .backend import Array, BodyState, Named, SensorState, States, named, plain
from .parts import (
    Holds,
    JointEfforts,
    JointPositions,
    JointVelocities,
    Measurements,
    Position,
    Rotation,
    Twist,
)

Places = NDArray[Any]

_LARGEST = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class Layout:
    """How many there are of each."""

    bodies: int
    joints: int
    rays: int = 0
    actuators: int = 0

    def pose(self, body: int) -> Places:
        """Places of a pose."""
        return np.arange(7 * body, 7 * body + 7)

    def twist(self, body: int) -> Places:
        """Places of a twist."""
        first = 7 * self.bodies + 6 * body
        return np.arange(first, first + 6)

    def joint(self, kind: int, columns: Any) -> Places:
        """Places of positions (0), velocities (1) or efforts (2) of joints."""
        return 13 * self.bodies + kind * self.joints + np.asarray(columns, dtype=np.intp)

    def ray(self, ray: int) -> int:
        """Place of a measurement."""
        return 13 * self.bodies + 3 * self.joints + ray

    def actuator(self, actuator: int) -> int:
        """Place of what an actuator holds."""
        return self.ray(self.rays) + actuator

    @property
    def zero(self) -> int:
        """Place of the zero, the last one."""
        return self.actuator(self.actuators)


class Seen(NamedTuple):
    """What of a scene a task sees."""

    layout: Layout
    bodies: Sequence[Tuple[str, int, Sequence[Tuple[str, int]]]]
    """Name, row, and the joints below: names and columns."""
    sensors: Sequence[str] = ()
    actuators: Sequence[Tuple[str, int]] = ()
    """Names and rows."""


class Finder(Protocol):
    """Where things of a scene stand, by the names that tasks use."""

    layout: Layout

    def body(self, name: str) -> int:
        """Row of a body."""

    def joints(self, body: str) -> Dict[str, int]:
        """Columns of the joints below a body, by plain name."""

    def rays(self, sensor: str) -> Tuple[int, int]:
        """First and one behind the last of the rays of a sensor."""

    def actuator(self, name: str) -> int:
        """Row of an actuator."""


def narrow(flat: Array, layout: Layout) -> None:
    """Brings what is in single precision over ROS to it, in place: joints and rays of (worlds x numbers). What is too large becomes the
    largest number, not infinite.
    """
    single = flat[:, 13 * layout.bodies : layout.ray(layout.rays)]
    np.maximum(single, -_LARGEST, out=single)
    np.minimum(single, _LARGEST, out=single)
    single[...] = single.astype(np.float32)


class Gather:
    """What parts observe, as places."""

    def __init__(self, parts: Sequence[Any], finder: Finder) -> None:
        """Raises LookupError for a part that is none of this package."""
        places: List[Any] = []
        minus: Dict[int, int] = {}
        self._rotations: List[int] = []
        for part in parts:
            begin = sum(len(found) for found in places)
            found, less = _places(part, finder)
            places.append(found)
            minus.update({begin + i: int(place) for i, place in enumerate(less)})
            if type(part) is Rotation:
                self._rotations.append(begin)
        self._plus: NDArray[np.intp] = np.concatenate([*places, np.zeros(0)]).astype(np.intp)
        self._relative = np.array(list(minus), dtype=np.intp)
        self._minus = np.array(list(minus.values()), dtype=np.intp)

    def observe(self, flat: Array) -> Array:
        """(… x size) the numbers of the parts in (… x numbers of a world)."""
        seen: Array = flat[..., self._plus]
        if len(self._minus):
            seen[..., self._relative] -= flat[..., self._minus]
        for first in self._rotations:
            # The quaternion with w of at least 0.
            turned = seen[..., first : first + 4]
            np.negative(turned, out=turned, where=turned[..., 3:] < 0.0)
        return seen


_JOINTS = {JointPositions: 0, JointVelocities: 1, JointEfforts: 2}


def is_known(part: Any) -> bool:
    """Whether an observation part is one of this package, whose numbers have places."""
    return type(part) in (*_JOINTS, Position, Rotation, Twist, Measurements, Holds)


def _places(part: Any, finder: Finder) -> Tuple[Any, Any]:
    """Places of a part, and of what is subtracted."""
    layout = finder.layout
    if type(part) in _JOINTS:
        columns = finder.joints(part.body)
        return layout.joint(_JOINTS[type(part)], [columns[plain(joint)] for joint in part.joints]), ()
    if type(part) is Position:
        less = () if part.relative_to is None else layout.pose(finder.body(part.relative_to))[:3]
        return layout.pose(finder.body(part.body))[:3], less
    if type(part) is Rotation:
        return layout.pose(finder.body(part.body))[3:], ()
    if type(part) is Twist:
        return layout.twist(finder.body(part.body)), ()
    if type(part) is Measurements:
        begin, end = finder.rays(part.sensor)
        rays = range(begin, min(end, begin + part.rays))
        return [layout.ray(ray) for ray in rays] + [layout.zero] * (part.rays - len(rays)), ()
    if type(part) is Holds:
        return [layout.actuator(finder.actuator(part.actuator))], ()
    raise LookupError(f"{part} is no part of this package")


class SeenBody(BodyState):
    """A body in a flat array: its numbers are taken out of it when they are asked for. Of an array of worlds they are arrays of worlds."""

    def __init__(self, flat: Array, layout: Layout, row: int, joints: Sequence[Tuple[str, int]]) -> None:
        self.__dict__["_of"] = (flat, layout, row, joints)

    def __repr__(self) -> str:
        motion = (self.position, self.rotation, self.linear_velocity, self.angular_velocity)
        return repr(BodyState(*motion, self.joint_positions, self.joint_velocities, self.joint_efforts))

    def _part(self, first: int, count: int) -> Array:
        flat: Array = self.__dict__["_of"][0]
        part: Array = flat[..., first : first + count].copy()
        return part

    def _joints(self, kind: int) -> Dict[str, float]:
        flat, layout, _, joints = self.__dict__["_of"]
        places = layout.joint(kind, [column for _, column in joints])
        values = flat[places].tolist() if flat.ndim == 1 else np.moveaxis(flat[..., places], -1, 0)
        return dict(zip((name for name, _ in joints), values))

    @cached_property
    def position(self) -> Array:
        """See BodyState."""
        return self._part(7 * self.__dict__["_of"][2], 3)

    @cached_property
    def rotation(self) -> Array:
        """See BodyState."""
        return self._part(7 * self.__dict__["_of"][2] + 3, 4)

    @cached_property
    def linear_velocity(self) -> Array:
        """See BodyState."""
        _, layout, row, _ = self.__dict__["_of"]
        return self._part(7 * layout.bodies + 6 * row, 3)

    @cached_property
    def angular_velocity(self) -> Array:
        """See BodyState."""
        _, layout, row, _ = self.__dict__["_of"]
        return self._part(7 * layout.bodies + 6 * row + 3, 3)

    @cached_property
    def joint_positions(self) -> Dict[str, float]:
        """See BodyState."""
        return self._joints(0)

    @cached_property
    def joint_velocities(self) -> Dict[str, float]:
        """See BodyState."""
        return self._joints(1)

    @cached_property
    def joint_efforts(self) -> Dict[str, float]:
        """See BodyState."""
        return self._joints(2)


class SeenStates(States):
    """States in a flat array: what is in them is taken out of it when it is asked for."""

    def __init__(
        self, sim_step: Any, sim_time: Any, flat: Array, scene: Seen, sensed: Sequence[SensorState] = ()
    ) -> None:
        """`flat`, `sim_step` and `sim_time`: of a world, or of an array of worlds. `sensed`: states of sensors."""
        self.__dict__.update(sim_step=sim_step, sim_time=sim_time, flat=flat, _of=(scene, sensed))

    def __repr__(self) -> str:
        return repr(States(self.sim_step, self.sim_time, self.bodies, self.sensors, self.actuators))

    def __len__(self) -> int:
        """How many worlds it is of."""
        assert self.flat is not None
        return len(self.flat)

    def __getitem__(self, world: Any) -> SeenStates:
        """Of one of an array of worlds, as a simulation of its own tells them; or of some."""
        assert self.flat is not None
        step, time = self.sim_step[world], self.sim_time[world]  # type: ignore[index]
        if isinstance(world, int):
            step, time = int(step), float(time)
        return SeenStates(step, time, self.flat[world], self.__dict__["_of"][0])

    @cached_property
    def bodies(self) -> Dict[str, BodyState]:
        """See States."""
        layout, bodies, *_ = self.__dict__["_of"][0]
        return named("body", {name: SeenBody(self.flat, layout, row, joints) for name, row, joints in bodies})  # type: ignore[arg-type]

    @cached_property
    def sensors(self) -> Dict[str, SensorState]:
        """See States."""
        scene, sensed = self.__dict__["_of"]
        return named("sensor", dict(zip(scene.sensors, sensed)))

    @cached_property
    def actuators(self) -> Dict[str, bool]:
        """See States."""
        scene: Seen = self.__dict__["_of"][0]
        assert self.flat is not None
        held = {name: self.flat[..., scene.layout.actuator(row)] != 0.0 for name, row in scene.actuators}
        if self.flat.ndim == 1:
            held = {name: bool(holds) for name, holds in held.items()}
        return named("actuator", held)


def columns_by_name(names: Sequence[str], columns: Sequence[int], body: str) -> Named[int]:
    """Columns of joints by plain name: the first of those of the same name."""
    pairs = list(zip((plain(name) for name in names), (int(column) for column in columns)))
    return Named(f"joint of {body}", dict(reversed(pairs)))
