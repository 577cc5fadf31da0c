"""Many worlds of one scene in one object."""

from __future__ import annotations

import operator
import os
from types import TracebackType
from typing import Any, Dict, NamedTuple, Optional, Sequence, Tuple, Type, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _ambf
from .arrays import Arrays
from .names import find
from .parameters import PARAMETERS, parameter_array, split_parameters

Array = NDArray[np.float64]
Path = Union[str, "os.PathLike[str]"]
Mask = Optional[ArrayLike]

_MOST_STEPS = 2**32 - 1


class BatchContacts(NamedTuple):
    """Contact points of all worlds, one a row, in the order of the worlds."""

    worlds: NDArray[np.intp]
    """(contacts) number of the world."""
    bodies: NDArray[np.intp]
    """(contacts x 2) places of the two bodies in the arrays; -1: a passive body, which has none."""
    points: Array
    """(contacts x 3) on the surface of the first body, m, world axes."""
    normals: Array
    """(contacts x 3) unit normals from the second body to the first, world axes."""
    distances: Array
    """(contacts) m; negative: they penetrate."""
    forces: Array
    """(contacts) normal force in the last sub-step, N, not negative."""
    friction_forces: Array
    """(contacts x 3) force of friction on the first body in the last sub-step, N, world axes."""
    frictions: Array
    """(contacts) coefficient of friction of the two bodies."""

    def normal_forces(self, n: int, body: int) -> Array:
        """(n) sum of the normal forces on a body by its place, N, of each of `n` worlds."""
        touches = (self.bodies == body).any(axis=1)
        sums = np.zeros(n)
        np.add.at(sums, self.worlds[touches], self.forces[touches])
        return sums


class Batch(Arrays):
    """`n` worlds of one scene that are stepped together, on as many threads as the process may use processors.

    Each world does what a `Simulation` of the scene does under the same commands, to the last bit, whatever the others do. Arrays are
    contiguous and begin with the world; they are written and read in place, so that NumPy, and what takes arrays by DLPack
    (`torch.from_dlpack(batch.poses)`), see them without a copy. What is written into states has no effect, and is overwritten.

    A world whose state was lost (`lost`) stands still until it is reset; the others go on. One thread at a time may use a batch; while
    it steps, Python's global lock is released, and the arrays of states hold what was before.
    """

    def __init__(
        self,
        models: Union[Path, Sequence[Path]] = (),
        n: int = 1,
        *,
        launch_file: Optional[Path] = None,
        world: Optional[Path] = None,
        indexes: Sequence[int] = (),
        profile: Optional[str] = None,
        solver: Optional[str] = None,
        integrator: Optional[str] = None,
        iterations: Optional[int] = None,
        articulated: Optional[bool] = None,
        sleep: Optional[bool] = None,
        step: float = 0.001,
    ) -> None:
        """Loads the scene `n` times; arguments are those of `Simulation`. Raises LoadError, ValueError."""
        files = [models] if isinstance(models, (str, os.PathLike)) else list(models)
        self.n = operator.index(n)
        """Number of worlds."""
        if self.n < 1:
            raise ValueError(f"n={n}: expected 1 world or more")
        self._inside = inside = _ambf.Batch(
            self.n,
            [os.fspath(file) for file in files],
            None if launch_file is None else os.fspath(launch_file),
            None if world is None else os.fspath(world),
            list(indexes),
            profile,
            solver,
            integrator,
            iterations,
            articulated,
            sleep,
            step,
        )
        self.warnings: Tuple[str, ...] = tuple(inside.warnings)
        """What was left out or guessed while the scene was loaded; each begins with file:line."""
        self.bodies: Tuple[str, ...] = tuple(inside.bodies)
        """Names of the bodies, in the order of the arrays."""
        self.joints: Tuple[str, ...] = tuple(inside.joints)
        """Names of the joints, in the order of the arrays."""
        self.joint_types: Tuple[str, ...] = tuple(inside.joint_types)
        """(joints) as in `Simulation.joint_types`."""
        self.poses: Array = inside.array("poses")
        """(n x bodies x 7) position, m, and quaternion x, y, z, w of the body frames, world axes."""
        self.twists: Array = inside.array("twists")
        """(n x bodies x 6) velocity of the centre of mass, m/s, and angular velocity, rad/s."""
        self.joint_positions: Array = inside.array("joint_positions")
        """(n x joints) rad or m."""
        self.joint_velocities: Array = inside.array("joint_velocities")
        """(n x joints) rad/s or m/s."""
        self.joint_efforts: Array = inside.array("joint_efforts")
        """(n x joints) N·m or N; 0 without `enable feedback`."""
        self._bind_sensors()
        self.times: Array = inside.array("times")
        """(n) simulated time of each world, s; it goes on through resets."""
        self.lost: NDArray[np.bool_] = inside.array("lost")
        """(n) whether the state of a world was lost: it became infinite, not a number or implausible; see `problems`."""
        self.kinds: NDArray[np.int8] = inside.array("kinds")
        """(n x bodies) how each body is commanded: NONE, FORCE, POSITION or VELOCITY."""
        self.wrenches: Array = inside.array("wrenches")
        """(n x bodies x 6) force at the centre of mass, N, and torque, N·m, for kind FORCE."""
        self.target_poses: Array = inside.array("target_poses")
        """(n x bodies x 7) position, m, and quaternion, for kind POSITION."""
        self.target_twists: Array = inside.array("target_twists")
        """(n x bodies x 6) velocity, m/s, and angular velocity, rad/s, for kind VELOCITY."""
        self.joint_kinds: NDArray[np.int8] = inside.array("joint_kinds")
        """(n x joints) how each joint is commanded: NONE, EFFORT, POSITION or VELOCITY; through the base of its tree."""
        self.joint_commands: Array = inside.array("joint_commands")
        """(n x joints) N·m or N, rad or m, rad/s or m/s."""

    def _bind_sensors(self) -> None:
        inside = self._inside
        listed = inside.sensors
        self.sensors: Tuple[str, ...] = tuple(name for name, *_ in listed)
        """Names of the sensors."""
        self.sensor_types: Tuple[str, ...] = tuple(kind for _, kind, *_ in listed)
        """(sensors) "proximity": rays that see; "resistance": rays that see and push; "contact": what touches its body."""
        self._columns = tuple(slice(begin, end) for *_, begin, end in listed)
        self.measurements: Array = inside.array("measurements")
        """(n x rays of all sensors) 1 - distance / length of the ray: 0 … 1, larger is closer, 0 is nothing. `columns`: a sensor's."""
        self.sensed: NDArray[np.int64] = inside.array("sensed")
        """(n x rays of all sensors) the place in the arrays of the body that each ray sees; -1: something without one, such as a passive
        body; -2: nothing."""
        self.contact_forces: Array = inside.array("contact_forces")
        """(n x contact sensors) sum of the normal forces on the body of each, N, not negative. `columns`: a sensor's."""
        self.touching: NDArray[np.int64] = inside.array("touching")
        """(n x contact sensors) how many bodies touch the body of each."""

        self.actuators: Tuple[str, ...] = tuple(inside.actuators)
        """Names of the actuators."""
        self.holding: NDArray[np.bool_] = inside.array("holding")
        """(n x actuators) whether each holds something."""

    def body(self, name: Union[str, int]) -> int:
        """The place of a body in the arrays: that of this name, or the end or a part of it that is unique. Raises NotFoundError."""
        return find(name, self.bodies, "bodies")

    def body_joints(self, body: Union[str, int]) -> NDArray[np.intp]:
        """Places of the joints below a body in the arrays, in the order of its joint commands. Raises NotFoundError."""
        return np.array(self._inside.body_joints(self.body(body)), dtype=np.intp)

    def columns(self, sensor: Union[str, int]) -> slice:
        """Where a sensor stands in `measurements` and `sensed`; a contact sensor in `contact_forces` and `touching`. The name as that of
        `body`. Raises NotFoundError.
        """
        return self._columns[find(sensor, self.sensors, "sensors")]

    def actuator(self, name: Union[str, int]) -> int:
        """The place of an actuator in `holding`; the name as that of `body`. Raises NotFoundError."""
        return find(name, self.actuators, "actuators")

    def hold(
        self, actuator: Union[str, int], hold: ArrayLike = True, mask: Mask = None, *, sensor: str = "", body: str = ""
    ) -> None:
        """Lets an actuator hold what a sensor sees, or a body, from the next step on in the worlds where `hold` (n truth values, or one for
        all) is true, and let go in the others; as `Actuator.hold` and `release` do. In the worlds of `mask` (n; None: all). What holds
        something goes on holding that. `sensor`, `body`: identifier, or a part of it that is unique.

        Raises NotFoundError where there is no such thing, ValueError, and nothing has changed; ClosedError, BusyError.
        """
        wanted = np.asarray(hold)
        chosen = np.asarray(True if mask is None else mask)
        for what, given in (("hold", wanted), ("mask", chosen)):
            if given.dtype != np.bool_ or given.shape not in ((), (self.n,)):
                raise ValueError(f"{what}: expected a truth value, or {self.n}")
        if bool(sensor) == bool(body) and (wanted & chosen).any():
            raise ValueError("give either sensor or body")
        hold_all, mask_all = (np.array(np.broadcast_to(given, (self.n,))) for given in (wanted, chosen))
        self._inside.hold(self.actuator(actuator), mask_all, hold_all, sensor, body)

    def release(self, actuator: Union[str, int], mask: Mask = None) -> None:
        """Lets an actuator let go in the next step, in the worlds of `mask` (n; None: all). Raises what `hold` does."""
        self.hold(actuator, False, mask)

    def step(self, steps: Union[int, Sequence[int], NDArray[Any]] = 1) -> None:
        """Makes `steps` iterations (a number for all, or n numbers) in every world that is not lost, under the commands of the arrays.

        Raises ValueError if a number is negative or above 2**32 - 1; InvalidCommand, and no world has moved; ClosedError, BusyError.
        """
        if type(steps) is int and 0 <= steps <= _MOST_STEPS:
            self._inside.step(steps)
            return
        numbers = np.asarray(steps)
        if numbers.dtype.kind not in "iu" or numbers.shape not in ((), (self.n,)):
            raise ValueError(f"steps={steps}: expected an integer, or {self.n}")
        if numbers.size and not (numbers.min() >= 0 and numbers.max() <= _MOST_STEPS):
            raise ValueError(f"steps={steps}: expected 0 to {_MOST_STEPS} iterations")
        self._inside.step(numbers.tolist())

    def reset(
        self,
        mask: Mask = None,
        *,
        joint_positions: Optional[ArrayLike] = None,
        joint_velocities: Optional[ArrayLike] = None,
        poses: Optional[ArrayLike] = None,
        twists: Optional[ArrayLike] = None,
        noise: ArrayLike = 0.0,
        seed: Optional[int] = None,
    ) -> None:
        """Returns the worlds of `mask` (n; None: all) to their start, as `Simulation.reset` does, and sets their states as
        `Simulation.set_state` does. Their commands are empty; parameters stay.

        States are arrays of the shapes of those of the same name, or what can be broadcast to them; NaN leaves what it stands for.
        `noise` (n x joints, or what can be broadcast to it; rad or m): positions of revolute and prismatic joints are drawn evenly from
        so far around those that are given (none: those of the start), within the limits. World i draws from
        `numpy.random.default_rng([seed, i])`, so that it draws the same whichever others are reset; without a seed from the system's
        entropy.

        Raises StateError, which names the world, if a state cannot be set: its world is at its start then; ValueError, ClosedError,
        BusyError.
        """
        chosen = np.ones(self.n, dtype=bool) if mask is None else np.asarray(mask)
        if chosen.shape != (self.n,) or chosen.dtype != np.bool_:
            raise ValueError(f"mask: expected {self.n} truth values, not {chosen.dtype} of the shape {chosen.shape}")
        moves = np.array([kind in ("revolute", "prismatic") for kind in self.joint_types], dtype=np.float64)
        around = np.broadcast_to(np.asarray(noise, dtype=np.float64), self.joint_positions.shape) * moves
        if not (np.isfinite(around) & (around >= 0.0)).all():
            raise ValueError("noise: expected finite numbers of at least 0")
        if seed is not None and seed < 0:
            raise ValueError(f"seed={seed}: expected 0 or more")
        positions = self._broadcast("joint_positions", joint_positions)
        if around.any():
            positions = self._draw(chosen, positions, around, seed)
        self._inside.reset(
            chosen.tolist(),
            None if positions is None else positions.ravel(),
            *(
                None if values is None else self._broadcast(name, values).ravel()  # type: ignore[union-attr]
                for name, values in (("joint_velocities", joint_velocities), ("poses", poses), ("twists", twists))
            ),
        )

    def _draw(self, chosen: NDArray[Any], positions: Optional[Array], around: Array, seed: Optional[int]) -> Array:
        """Joint positions around those that are given, or those of the start."""
        centres = np.full(self.joint_positions.shape, np.nan) if positions is None else positions
        if np.isnan(centres[chosen]).any():
            # Where the start is, is seen when it is there.
            self._inside.reset(chosen.tolist(), None, None, None, None)
            centres = np.where(np.isnan(centres), self.joint_positions, centres)
        limits = self.parameters()["joint_limits"]
        low, high = limits[..., 0], limits[..., 1]
        drawn = np.full_like(centres, np.nan)
        for i in np.flatnonzero(chosen):
            rng = np.random.default_rng(None if seed is None else [seed, int(i)])
            wanted = centres[i] + around[i] * rng.uniform(-1.0, 1.0, size=len(self.joints))
            drawn[i] = np.where(around[i] > 0.0, np.clip(wanted, low[i], high[i]), np.nan)
        return np.where(np.isnan(drawn), np.nan if positions is None else positions, drawn)

    def set_parameters(self, **values: Any) -> None:
        """Changes masses, frictions, gains, gravity and so on: names are those of `Simulation.set_parameters`.

        Arrays have the shape of those of one world, which then counts for all, or one more dimension in front, of size n; dicts by names
        have one value, or n. NaN leaves what it stands for as it is: `set_parameters(masses={"block": rng.uniform(0.1, 1, n)})`. Nothing
        has changed after an error: ValueError, NotFoundError, ClosedError, BusyError.
        """
        flat = []
        for name, value in values.items():
            if name not in (*PARAMETERS, "colors"):
                raise ValueError(f"{name}: no such parameters; expected {', '.join(PARAMETERS)}")
            if value is not None:
                names = self.joints if name.startswith("joint_") else self.bodies
                flat.append((name, parameter_array(name, value, names, (self.n,)).ravel()))
        self._inside.set_parameters(flat)

    def parameters(self) -> Dict[str, Array]:
        """Copies of the present parameters of all worlds, by the names of `Simulation.set_parameters`, n in front."""
        return split_parameters(*self._inside.parameters(), (self.n,))

    def contacts(self) -> BatchContacts:
        """All contact points of all worlds, as of the last sub-step; those whose distance is positive do not touch yet.

        Raises ClosedError, BusyError.
        """
        places, numbers = self._inside.contacts()
        whose, table = places.reshape(-1, 3).astype(np.intp), numbers.reshape(-1, 12)
        parts = (table[:, :3], table[:, 3:6], table[:, 6], table[:, 7], table[:, 8:11], table[:, 11])
        return BatchContacts(whose[:, 0], whose[:, 1:], *parts)

    def problems(self) -> Dict[int, str]:
        """Why worlds are lost, by their numbers."""
        return dict(self._inside.problems())

    def close(self) -> None:
        """Frees the worlds. Arrays keep the numbers they have. May be called more than once."""
        self._inside.close()

    def __enter__(self) -> Batch:
        return self

    def __exit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<ambf.Batch: {self.n} worlds of {len(self.bodies)} bodies and {len(self.joints)} joints>"

    def _broadcast(self, name: str, values: Optional[ArrayLike]) -> Optional[Array]:
        if values is None:
            return None
        shape = vars(self)[name].shape
        numbers = np.asarray(values, dtype=np.float64)
        try:
            return np.array(np.broadcast_to(numbers, shape))
        except ValueError:
            raise ValueError(f"{name}: expected {shape} numbers, not {numbers.shape}") from None
