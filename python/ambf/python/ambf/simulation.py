"""Simulations, and handles of what is in them."""

from __future__ import annotations

import atexit
import math
import operator
import os
import weakref
from types import TracebackType
from typing import (
    Any,
    Dict,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Type,
    Union,
    overload,
)

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _ambf
from ._ambf import State, version
from .arms import Arm
from .arrays import FORCE, KINDS, NONE, POSITION, VELOCITY, Arrays
from .errors import BusyError, ClosedError, NonFiniteError, NotFoundError
from .names import find as _find
from .names import place
from .parameters import PARAMETERS, parameter_array, split_parameters
from .tree import Tree
from .volumes import Volume

Array = NDArray[np.float64]
Kinds = NDArray[np.int8]
Path = Union[str, "os.PathLike[str]"]
Camera = Union[str, int, None]
"""A camera by its name, or the only one whose name contains it; by its index in `Simulation.cameras`; or the first (None)."""

Values = Union[ArrayLike, Mapping[Union[str, int], ArrayLike]]
"""Numbers in the order of an array, or by name."""

_MOST_PIXELS = 16384
_MOST_STEPS = 2**32 - 1

_STATES = (
    "poses",
    "twists",
    "joint_positions",
    "joint_velocities",
    "joint_efforts",
    "joint_wrenches",
    "measurements",
    "holding",
)
_COMMANDS = ("kinds", "wrenches", "target_poses", "target_twists")


class Coupling(NamedTuple):
    """A joint that follows others: its position is the sum of theirs, each times its ratio, plus the offset."""

    follower: int
    """Where it stands in the arrays of joints."""
    leaders: Tuple[Tuple[int, float], ...]
    """Where the others stand there, and the rate of the follower over that of each: rad/rad, m/m, m/rad or rad/m."""
    offset: float
    """rad or m."""


class Contacts(NamedTuple):
    """Contact points, one a row."""

    bodies: NDArray[np.intp]
    """(contacts x 2) rows of the two bodies in the arrays of bodies; -1: a passive body, which has none."""
    names: Tuple[Tuple[str, str], ...]
    """Names of the two bodies."""
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


class Rays(NamedTuple):
    """What rays have met, one a row."""

    bodies: NDArray[np.intp]
    """(rays) row of the body in the arrays of bodies; -1: something without a row there, such as a passive body; -2: nothing."""
    distances: Array
    """(rays) from the origin, m; infinite: nothing."""
    points: Array
    """(rays x 3) m, world axes; NaN: nothing."""
    normals: Array
    """(rays x 3) unit normal of the surface, towards the origin, world axes; 0: nothing."""


class Simulation(Arrays):
    """A scene that moves when `step` is called.

    **States** are arrays that the simulation writes at the end of `step`, `reset` and `restore`: they need not be asked for again,
    and can't be written. World axes, m, rad, s; quaternions x, y, z, w. **Commands** are arrays that `step` reads; they stay in force
    until they are changed or all is reset. Assigning to their names writes into them: `body.wrench = (0, 0, 5, 0, 0, 0)`. A command that
    is not finite, of no known kind, or a pose whose quaternion is zero, is an `InvalidCommand`, and nothing moves.

    An iteration is update (Bullet), commands, publication; between calls the physics rests after an update, before the commands. So a
    command acts from the second iteration of a call on, and the states are those that the last iteration published: exactly as over
    ROS with the service `World/step`.

    One thread at a time may use a simulation; Python's global lock is released while it steps. Ctrl+C ends a long step after
    a whole number of iterations.
    """

    def __init__(
        self,
        models: Union[Path, Sequence[Path]] = (),
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
        saving: bool = False,
        joint_wrenches: bool = True,
        step: float = 0.001,
        plugins: Sequence[Path] = (),
        crtk: Sequence[Path] = (),
        seed: Optional[int] = None,
    ) -> None:
        """Loads `models` (ADF, URDF or MJCF files), then those at `indexes` of the launch file's list, into the world of `world`, else of
        the launch file, else an empty one.

        `profile`: "legacy", "accurate" or "pybullet"; `solver`, `integrator`, `iterations`, `articulated`, `sleep`: as the options of
        the programs. None: what the world file says, else the profile; the profile is "accurate" unless the world file names another one
        (that of the programs is "legacy"). `step`: interval of an iteration, s, in sub-steps of 1 ms or, if it is shorter, in one of
        its length, unless the world file has a `sub step`. `saving`: allows `save`. `joint_wrenches`: measures those of all joints, not
        only of those with `enable feedback`; it costs time and changes nothing of the motion. `plugins`: simulator plugins, shared
        libraries. `crtk`: files that configure arms for CRTK clients, for `arm`; `seed`: draws what they draw, as the
        program's option `--seed`.

        Raises LoadError. What of a scene had to be left out or guessed is in `warnings`.
        """
        files = [models] if isinstance(models, (str, os.PathLike)) else list(models)
        self._world = _ambf.World(
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
            saving,
            joint_wrenches,
            step,
            [os.fspath(file) for file in plugins],
            [os.fspath(file) for file in crtk],
            seed,
        )
        self.warnings: Tuple[str, ...] = tuple(self._world.warnings)
        """What was left out or guessed while the scene was loaded; each begins with file:line."""
        self._handles: Dict[int, Body] = {}
        self._bind()

    @classmethod
    def _of(cls, world: _ambf.World) -> Simulation:
        """A simulation around a world that is there."""
        made = cls.__new__(cls)
        made._world = world
        made.warnings = tuple(world.warnings)
        made._handles = {}
        made._bind()
        return made

    def _bind(self) -> None:
        """Takes the names and arrays of what there is."""
        vars(self).update(dict.fromkeys((*_STATES, *_COMMANDS, *PARAMETERS)))
        inside = self._world
        self.bodies: Tuple[str, ...] = tuple(inside.bodies)
        """Names of the bodies, in the order of the arrays; called as their topics are over ROS."""
        self.joints: Tuple[str, ...] = tuple(inside.joints)
        """Names of the joints, in the order of the arrays."""
        self.sensors: Tuple[str, ...] = tuple(inside.sensors)
        self.actuators: Tuple[str, ...] = tuple(inside.actuators)
        self.cameras: Tuple[str, ...] = tuple(inside.cameras)
        """Names of the cameras. A world that lists none has `default_camera` at the origin, which looks along -x."""
        self.poses: Array = inside.poses
        """(bodies x 7) position, m, and quaternion of the body frames. Read-only."""
        self.twists: Array = inside.twists
        """(bodies x 6) velocity of the centre of mass, m/s, and angular velocity, rad/s. Read-only."""
        self.joint_positions: Array = inside.joint_positions
        """(joints) rad or m. Read-only."""
        self.joint_velocities: Array = inside.joint_velocities
        """(joints) rad/s or m/s. Read-only."""
        self.joint_efforts: Array = inside.joint_efforts
        """(joints) N·m or N; 0 without `enable feedback`. Read-only."""
        self.joint_wrenches: Array = inside.joint_wrenches
        """(joints x 6) what each joint exerts on its child: force, N, and torque about the child's end of the joint, N·m, world axes;
        the mean over the last sub-step. Motors, limits and springs of the joint count. Profile `legacy`: what Bullet applied, without
        commanded efforts. 0 for joints whose wrench is not measured. Read-only."""
        self.measurements: Array = inside.measurements
        """(rays of all sensors) 0 … 1, larger is closer, 0 is nothing. Read-only. `Sensor.measurements` is a sensor's part."""
        self.holding: NDArray[np.bool_] = inside.holding
        """(actuators) whether they hold something. Read-only."""
        self.kinds: Kinds = inside.kinds
        """(bodies) how each is commanded: NONE, FORCE, POSITION or VELOCITY."""
        self.wrenches: Array = inside.wrenches
        """(bodies x 6) force at the centre of mass, N, and torque, N·m, for kind FORCE."""
        self.target_poses: Array = inside.target_poses
        """(bodies x 7) position, m, and quaternion, for kind POSITION."""
        self.target_twists: Array = inside.target_twists
        """(bodies x 6) velocity, m/s, and angular velocity, rad/s, for kind VELOCITY."""
        self._read_parameters()
        self.joint_types: Tuple[str, ...] = tuple(inside.joint_types)
        """(joints) "revolute", "prismatic", "linear spring", "torsion spring"; and those without a coordinate: "fixed", "p2p", …"""
        self.lights: Tuple[str, ...] = tuple(inside.lights)
        """Names of the lights."""
        self.couplings: Tuple[Coupling, ...] = tuple(
            Coupling(follower, tuple(leaders), offset) for follower, leaders, offset in inside.couplings
        )
        """Joints that follow others."""

    @property
    def keyframes(self) -> Dict[str, Dict[str, Array]]:
        """States that files name (`keyframe` of MJCF), by name: arrays as `set_state` takes them, NaN where a state says nothing.
        `set_state(**sim.keyframes["home"])`. Those of the same name in several models are one.
        """
        made: Dict[str, Dict[str, Array]] = {}
        for name, positions, velocities, poses, twists in self._world.keyframes:
            state = made[name] = {
                "joint_positions": np.full(len(self.joints), np.nan),
                "joint_velocities": np.full(len(self.joints), np.nan),
                "poses": np.full((len(self.bodies), 7), np.nan),
                "twists": np.full((len(self.bodies), 6), np.nan),
            }
            for index, number in positions:
                state["joint_positions"][index] = number
            for index, number in velocities:
                state["joint_velocities"][index] = number
            for index, numbers in poses:
                state["poses"][index] = numbers
            for index, numbers in twists:
                state["twists"][index] = numbers
        return made

    def _read_parameters(self) -> None:
        """Shows the present parameters in arrays that can't be written."""
        for name, numbers in split_parameters(*self._world.parameters()).items():
            numbers.flags.writeable = False
            object.__setattr__(self, name, numbers)

    masses: Array
    """(bodies) kg; 0: static. Read-only, as all that follow: `set_parameters` changes them."""
    inertias: Array
    """(bodies x 3) principal moments of inertia about the centre of mass, kg·m²."""
    frictions: Array
    """(bodies) coefficients of friction; that of a contact is the product of both."""
    restitutions: Array
    """(bodies) coefficients of restitution; that of a contact is the product of both."""
    dampings: Array
    """(bodies x 2) shares of the linear and the angular velocity that are lost in 1 s."""
    gravities: Array
    """(bodies x 3) gravity that each feels, m/s²: its own, or the world's."""
    body_gains: Array
    """(bodies x 4) gains of the controllers of poses: linear P and D, angular P and D."""
    joint_limits: Array
    """(joints x 2) lower and upper limit, rad or m; infinite where there is none."""
    joint_dampings: Array
    """(joints) viscous damping, N·m·s/rad or N·s/m."""
    joint_frictions: Array
    """(joints) dry friction, N·m or N."""
    joint_gains: Array
    """(joints x 3) gains of the controllers of positions: P, I, D."""
    gravity: Array
    """(3) of the world, m/s²."""

    @property
    def profile(self) -> str:
        """The profile that simulates: "accurate", "legacy" or "pybullet"."""
        return self._world.profile

    @property
    def version(self) -> str:
        """Version of the simulator; with the commit if it is known."""
        return version

    @property
    def models(self) -> Tuple[str, ...]:
        """Names of the models, by which they are removed; the first is the environment."""
        return tuple(self._world.models)

    def __repr__(self) -> str:
        try:
            what = f"{self.profile}, {len(self.models)} models"
        except (ClosedError, BusyError) as error:
            what = "closed" if isinstance(error, ClosedError) else "busy"
        return (
            f"<ambf.Simulation: {what}, {len(self.bodies)} bodies, {len(self.joints)} joints, "
            f"{self.sim_time:.3f} s, iteration {self.sim_step}>"
        )

    @property
    def sim_step(self) -> int:
        """Iteration whose states the arrays hold. It begins with 1: the scene before any command. It goes on through resets: the
        arrays then hold that scene as the next iteration.

        It wraps at 2**32.
        """
        return self._world.sim_step

    @property
    def sim_time(self) -> float:
        """Simulated time, s. It goes on through resets."""
        return self._world.sim_time

    @property
    def lost_time(self) -> float:
        """Simulated seconds that were not computed, because `step` is longer than the world's `max iterations` of sub-steps."""
        return self._world.lost_time

    def body(self, name: Union[str, int]) -> Body:
        """The body of that name, else the only one whose name ends with it after a slash, else the only one whose name contains it; or
        that at an index.

        Raises NotFoundError.
        """
        index = _find(name, self.bodies, "bodies")
        if index not in self._handles:
            self._handles[index] = Body(self, index)
        return self._handles[index]

    @property
    def passive_bodies(self) -> Tuple[str, ...]:
        """Names of the bodies with `passive: true`, which have no topics over ROS and no rows in the arrays."""
        return tuple(name for _, name in self._world.passive_bodies())

    def passive_body(self, name: Union[str, int]) -> PassiveBody:
        """One of them, as `body` finds others. Raises NotFoundError, ClosedError, BusyError."""
        listed = self._world.passive_bodies()
        number, full = listed[_find(name, [other for _, other in listed], "passive bodies")]
        return PassiveBody(self, number, full)

    def sensor(self, name: Union[str, int]) -> Sensor:
        """The sensor of that name, as `body` finds it. Raises NotFoundError."""
        return Sensor(self, _find(name, self.sensors, "sensors"))

    def actuator(self, name: Union[str, int]) -> Actuator:
        """The actuator of that name, as `body` finds it. Raises NotFoundError."""
        return Actuator(self, _find(name, self.actuators, "actuators"))

    @property
    def arms(self) -> Tuple[str, ...]:
        """Names of the arms for CRTK clients, such as "/CRTK/psm1", in the order of their configuration."""
        return tuple(dict.fromkeys(space for space, *_ in self._world.crtk_topics()))

    def arm(self, name: str) -> Arm:
        """The arm of that name, or the only one whose name ends with it after a slash, or contains it. Raises NotFoundError."""
        arms = self.arms
        return Arm(self, arms[_find(name, arms, "arms")])

    def tree(self, body: Union[str, int]) -> Tree:
        """The tree of bodies that hang together with `body` by joints: Jacobians, mass matrix, forces, inverse kinematics.

        What stands still is the base of what hangs on it. Raises TreeError, which names the joint, if joints close a loop, or one is
        neither revolute nor prismatic nor fixed; NotFoundError, ClosedError, BusyError.
        """
        return Tree(self, _find(body, self.bodies, "bodies"))

    @property
    def volumes(self) -> Tuple[str, ...]:
        """Names of the volumes."""
        return tuple(self._world.volumes)

    def volume(self, name: Union[str, int]) -> Volume:
        """A volume by its name, or by a part of it that only it has. Raises NotFoundError."""
        return Volume(self, name)

    def step(self, steps: int = 1) -> None:
        """Makes `steps` iterations under the commands of the arrays; 0 changes nothing.

        Raises ValueError if `steps` is negative or above 2**32 - 1; NonFiniteError, InvalidCommand, ClosedError or BusyError.
        """
        self._world.step(_steps(steps))

    def reset(self) -> None:
        """Returns everything to the start: states, and what follows under the same commands, are to the last bit those of a simulation
        that was just made. The arrays of commands are empty again, actuators hold nothing. Only `sim_step`, `sim_time` and
        `lost_time` go on. What `set_parameters`, `add_model` and `remove_model` have changed stays.
        """
        self._world.reset()

    def set_state(
        self,
        *,
        joint_positions: Optional[Values] = None,
        joint_velocities: Optional[Values] = None,
        poses: Optional[Values] = None,
        twists: Optional[Values] = None,
    ) -> None:
        """Sets joint positions (rad, m), joint velocities (rad/s, m/s), poses of body frames (m, quaternion) and twists (velocity of the
        centre of mass, m/s, and angular velocity, rad/s; world axes), and shows them in the arrays.

        Each is an array as that of the same name, in which NaN leaves what it stands for as it is, or a dict by names (or indices):
        `set_state(joint_positions={"elbow": 0.5}, poses={"block": (0, 0, 1, 0, 0, 0, 1)})`. Poses and twists are those of bodies that
        hang below no joint; what hangs below them goes along. Joints that are not named keep position and velocity relative to their
        parent; those that close loops follow. Nothing else moves, and commands stay in force; controllers forget what they remember of
        what was set.

        It is the state before the commands of the next iteration: as after `reset`, `step(1)` shows it once more, and the next iteration
        what became of it. Raises StateError, and changes nothing, if a coordinate is beyond its limits, a joint has none, a loop would
        open, or the state was lost; NotFoundError, ValueError, ClosedError, BusyError.
        """
        self._world.set_state(
            _values("joint_positions", joint_positions, self.joints, ()),
            _values("joint_velocities", joint_velocities, self.joints, ()),
            _values("poses", poses, self.bodies, (7,)),
            _values("twists", twists, self.bodies, (6,)),
        )

    def set_parameters(
        self,
        *,
        masses: Optional[Values] = None,
        inertias: Optional[Values] = None,
        frictions: Optional[Values] = None,
        restitutions: Optional[Values] = None,
        dampings: Optional[Values] = None,
        gravity: Optional[ArrayLike] = None,
        gravities: Optional[Values] = None,
        body_gains: Optional[Values] = None,
        colors: Optional[Values] = None,
        joint_limits: Optional[Values] = None,
        joint_dampings: Optional[Values] = None,
        joint_frictions: Optional[Values] = None,
        joint_gains: Optional[Values] = None,
    ) -> None:
        """Changes what the scene is made of, at once; the arrays of these names show it.

        Each is an array of the shape of the attribute of that name, in which NaN leaves what it stands for as it is, or a dict by
        names (or indices): `set_parameters(masses={"block": 0.2}, frictions=sim.frictions * 1.5, gravity=(0, 0, -3.7))`. `colors` are
        (bodies x 4): red, green, blue, opacity, 0 to 1. A mass takes its moments of inertia along, unless they are given; a body with
        mass 0 stands still for good. `gravity` is that of all bodies that have none of their own. Velocities stay, contacts that are
        there get new coefficients; a joint beyond its new limits returns to them. Gains act from the next command on.

        `reset` keeps what was changed; `restore` brings back what was in force at `save`, but for colours. Raises ValueError, and
        changes nothing, if a number is out of range or of the wrong shape, or a body or joint can't have it; NotFoundError,
        ClosedError, BusyError.
        """
        given = {
            "masses": masses,
            "inertias": inertias,
            "frictions": frictions,
            "restitutions": restitutions,
            "dampings": dampings,
            "gravity": gravity,
            "gravities": gravities,
            "body_gains": body_gains,
            "colors": colors,
            "joint_limits": joint_limits,
            "joint_dampings": joint_dampings,
            "joint_frictions": joint_frictions,
            "joint_gains": joint_gains,
        }
        flat = []
        for name, values in given.items():
            if values is None:
                continue
            names = () if name == "gravity" else self.joints if name.startswith("joint_") else self.bodies
            flat.append((name, parameter_array(name, values, names).ravel().tolist()))
        self._world.set_parameters(flat)
        self._read_parameters()

    def place_camera(self, camera: Camera, pose: ArrayLike) -> None:
        """Puts a camera at a pose (7: position, m, and quaternion x, y, z, w; world). It looks along its -x axis, +z is up. A reset
        returns it. Raises ValueError, NotFoundError, ClosedError, BusyError.
        """
        self._world.place_camera(self._camera(camera), _pose(pose))

    def place_light(self, light: Union[str, int], pose: ArrayLike) -> None:
        """Puts a light at a pose, as `place_camera` does. It shines along its +x axis."""
        self._world.place_light(_find(light, self.lights, "lights"), _pose(pose))

    def add_model(self, path: Path) -> str:
        """Adds what a model file (ADF or URDF) describes to the running simulation; the name of the model.

        What is there keeps its state, its commands and its order; as after `set_state`, the state before the commands of the next
        iteration is shown. Arrays are new ones: those of the simulation, and of its bodies
        that `body` returned, are replaced; other handles find theirs when they are asked next. What was left out or guessed is
        added to `warnings`. States that were saved before can't be restored. A reset keeps the model, at its start. Raises LoadError,
        and nothing has changed; ClosedError, BusyError.
        """
        self._world, name, report = self._world.add_model(os.fspath(path))
        self.warnings = (*self.warnings, *report)
        self._rebind()
        return name

    def remove_model(self, name: str) -> str:
        """Removes the model of that name, or the only one whose name contains it, with all that hangs on it; its name.

        Arrays are new ones, as after `add_model`; those of handles of what is gone keep their numbers and command nothing. Raises
        NotFoundError, also for the environment; ClosedError, BusyError.
        """
        self._world, removed = self._world.remove_model(name)
        self._rebind()
        return removed

    def _rebind(self) -> None:
        """Takes names and arrays of the new world, and gives it the commands and handles of the one before."""
        old, handles = self.bodies, list(self._handles.values())
        commands = {name: vars(self)[name] for name in _COMMANDS}
        self._bind()
        places = {name: row for row, name in enumerate(self.bodies)}
        kept = [(index, places[name]) for index, name in enumerate(old) if name in places]
        for name, array in commands.items():
            for index, row in kept:
                vars(self)[name][row] = array[index]
        self._handles.clear()
        for handle in handles:
            if handle.name in places:
                new = places[handle.name]
                kinds, values, joints = handle.joint_kinds, handle.joint_commands, handle.joints
                handle._bind(self, new)
                for joint, kind, value in zip(joints, kinds, values):
                    if joint in handle.joints:
                        index = handle.joints.index(joint)
                        handle.joint_kinds[index], handle.joint_commands[index] = kind, value
                self._handles[new] = handle

    def contacts(self) -> Contacts:
        """All contact points between bodies, as of the last sub-step; those whose distance is positive do not touch yet.

        Raises ClosedError, BusyError.
        """
        rows, names, numbers = self._world.contacts()
        table = numbers.reshape(-1, 12)
        bodies = np.array(rows, dtype=np.intp).reshape(-1, 2)
        parts = (table[:, :3], table[:, 3:6], table[:, 6], table[:, 7], table[:, 8:11], table[:, 11])
        return Contacts(bodies, tuple(names), *parts)

    def cast_rays(self, origins: ArrayLike, directions: ArrayLike, length: float = 100.0) -> Rays:
        """What rays meet first: `origins` and `directions` are (rays x 3) or (3), world axes, m; a direction has any length above 0.
        They end after `length` m.

        A ray that starts inside a convex body does not meet it. Raises ValueError, ClosedError, BusyError.
        """
        begins, ways = np.broadcast_arrays(np.asarray(origins, np.float64), np.asarray(directions, np.float64))
        if begins.shape[-1:] != (3,) or begins.ndim > 2:
            raise ValueError(f"origins and directions: expected (rays x 3) numbers or 3, not {begins.shape}")
        begins, ways = begins.reshape(-1, 3), ways.reshape(-1, 3)
        norms = np.linalg.norm(ways, axis=1, keepdims=True)
        if not (np.isfinite(begins).all() and np.isfinite(norms).all() and (norms > 0).all() and 0 < length < np.inf):
            raise ValueError("origins, directions and length must be finite, and directions and length not zero")
        ends = begins + ways / norms * length
        rows, numbers = self._world.cast_rays(begins.tolist(), ends.tolist())
        table = numbers.reshape(-1, 7)
        return Rays(np.array(rows, dtype=np.intp), table[:, 0] * length, table[:, 1:4], table[:, 4:])

    def save(self) -> State:
        """Everything that decides what happens from now on: the physics to the last bit, time, commands.

        Raises StateError unless the simulation was made with `saving=True`.
        """
        return self._world.save()

    def restore(self, state: State) -> None:
        """Brings back a state that this simulation has saved, as often as wanted; the arrays of states and commands hold what they held.

        Raises StateError if another simulation has saved it. What plugins keep for themselves is not part of it.
        """
        self._world.restore(state)
        self._read_parameters()

    def record(self, path: Path) -> None:
        """Records all that changes the motion from now on, so that another process can make the same motion again, bit for bit:
        `Recording`. To be called before the first `step`, or directly after `reset`, before anything is commanded or changed.

        A thread writes; a disk that is too slow or full, or a state from before that is restored, ends the recording, which `notices`
        and `stop_recording` say, and not the simulation. A file that is there is not overwritten. Raises RecordingError, and there is no
        file then.
        """
        self._world.record(os.fspath(path))

    def stop_recording(self) -> int:
        """Completes the recording; how many updates are in it. Closing the simulation does it, too.

        Raises RecordingError if there is none, or if it has ended before.
        """
        return self._world.stop_recording()

    def note(self, text: str) -> None:
        """Puts a note into the recording, such as the name of a stage; it has the present time."""
        self._world.note(text)

    def set_energy_ledger(self, enabled: bool) -> None:
        """Switches the energy ledger on, with all sums at 0, or off. It is off at first. It changes no motion."""
        self._world.set_energy_ledger(enabled)

    def energy(self) -> Dict[str, float]:
        """The energy ledger after the last iteration's update, J; all 0 while it is off.

        Energies: `kinetic`, `potential` (against the start), `elastic`. Sums of work, positive where energy was gained: `set_states`
        (poses, velocities and parameters that were set), `wrenches`, `motors`, `body_drives`, `damping`, `joints`, `limits`,
        `contacts`, `friction`, `corrections` of positions, `outside` (wheels of vehicles, soft bodies), and `unexplained`, the error of
        the integration.
        """
        return dict(self._world.energy())

    def take_solver_statistics(self) -> Dict[str, float]:
        """What the solver of profile "accurate" did since this was called the last time; zeros in other profiles.

        Sums: `islands_solved`, `islands_approximate` (as far as the budget went), `islands_iterated` (by sequential impulses),
        `position_problems`, `divided_sub_steps` (jointed bodies turned fast), `rows`, `factorisations`, `pivots`, `sweeps`. Maxima:
        `residual` of the complementarity problem, m/s or rad/s; `joint_gap`, m, and `joint_angle`, rad, of joints that are solved by
        rows; `penetration` of contacts, m.
        """
        return dict(self._world.take_solver_statistics())

    @overload
    def render(
        self,
        camera: Camera = None,
        width: Optional[int] = None,
        height: Optional[int] = None,
        *,
        samples: int = 1,
        pose: Optional[ArrayLike] = None,
        field_view_angle: Optional[float] = None,
    ) -> NDArray[np.uint8]: ...

    @overload
    def render(
        self,
        camera: Camera = None,
        width: Optional[int] = None,
        height: Optional[int] = None,
        *,
        rgb: bool = True,
        depth: bool = False,
        ids: bool = False,
        normals: bool = False,
        samples: int = 1,
        pose: Optional[ArrayLike] = None,
        field_view_angle: Optional[float] = None,
    ) -> Any: ...

    def render(
        self,
        camera: Camera = None,
        width: Optional[int] = None,
        height: Optional[int] = None,
        *,
        rgb: bool = True,
        depth: bool = False,
        ids: bool = False,
        normals: bool = False,
        samples: int = 1,
        pose: Optional[ArrayLike] = None,
        field_view_angle: Optional[float] = None,
    ) -> Any:
        """What a camera sees of the states that the arrays hold: an array, or a dict of arrays if several are asked for.

        All have the top row first and belong to the caller.

        * `"rgb"`: (height x width x 3) uint8, as the camera publishes it: with its `preprocessing shaders` it is a mask.
        * `"depth"`: (height x width) float32, distance along the axis of the camera, m, without noise; the far clipping plane where
          nothing is seen.
        * `"ids"`: (height x width) int32, which object is seen: `id_names[ids[row, column]]`; 0 is nothing.
        * `"normals"`: (height x width x 3) float32, unit normal of the surface in the camera's frame (it looks along -x, +y is right in
          the picture, +z up), towards the camera; 0 where nothing is seen.

        `width`, `height`: pixels, 1 to 16384 (less if the graphics card says so); None: the published resolution, else 640 x 480; with
        one of them the other keeps the shape. A camera with two eyes shows them side by side. `samples`: of a pixel, 1 to 8; more
        smooth the edges of "rgb".

        `pose`, `field_view_angle`: the picture is taken from there, (7) position, m, and quaternion x, y, z, w, world axes, and with this
        vertical field of view, 0 to pi rad, in place of the camera's own. The camera stays where it is.

        No window and no X server are needed. A graphics card is used if there is one. The lock of Python is released, and other threads
        may go on to step this simulation while it is drawn. The first call loads the meshes. What cannot be drawn as described is in
        `notices`.

        Raises NotFoundError, ValueError, ClosedError, BusyError; RenderError without OpenGL, and in a process that was forked from one
        that has drawn before: start those by "spawn" or "forkserver", or draw in the parent after the fork only.
        """
        if not (rgb or depth or ids or normals):
            raise ValueError("nothing is asked for: switch rgb, depth, ids or normals on")
        if not 1 <= samples <= 8:
            raise ValueError(f"samples={samples}: expected 1 to 8")
        if field_view_angle is not None and not 0.0 < field_view_angle < math.pi:
            raise ValueError(f"field_view_angle={field_view_angle}: expected an angle above 0 and below pi, rad")
        size = _pixels("width", width), _pixels("height", height)
        place = None if pose is None else np.asarray(pose, np.float64).ravel().tolist()
        if place is not None and len(place) != 7:
            raise ValueError(f"pose: {len(place)} numbers; expected 7")
        planes = (rgb, depth, ids, normals)
        arrays = dict(self._world.render(self._camera(camera), *size, *planes, samples, place, field_view_angle))
        return next(iter(arrays.values())) if len(arrays) == 1 else arrays

    @property
    def id_names(self) -> Tuple[str, ...]:
        """Names of objects by their number in "ids" of `render`, as in `bodies`, `cameras` and so on; the first is "", nothing.

        The wheels of a vehicle have its name. Raises what `render` raises.
        """
        return tuple(self._world.id_names())

    def camera_matrix(self, camera: Camera = None, width: Optional[int] = None, height: Optional[int] = None) -> Array:
        """(3 x 3) camera matrix K of pictures of that size, pixels: K @ (right, down, forward) is homogeneous in (column, row).

        Centres of pixels are at half numbers: that of the upper left one is (0.5, 0.5). A point p of the camera's frame is right p[1],
        down -p[2], forward -p[0]. Raises ValueError for orthographic cameras and those with two eyes; NotFoundError, ClosedError,
        BusyError.
        """
        name = self._camera(camera)
        matrix = self._world.camera_matrix(name, _pixels("width", width), _pixels("height", height))
        if matrix is None:
            raise ValueError(f"{name or self.cameras[0]} is no pinhole camera: it is orthographic or has two eyes")
        return np.array(matrix, dtype=np.float64).reshape(3, 3)

    def camera_pose(self, camera: Camera = None) -> Array:
        """(7) where a camera is: position, m, and quaternion x, y, z, w, world axes. Raises NotFoundError, ClosedError, BusyError."""
        return np.array(self._world.camera_pose(self._camera(camera)), dtype=np.float64)

    def view(self) -> Viewer:
        """Opens a window for each visible camera, with the mouse and the keys of the simulator's windows; a handle that closes them.

        They show the states of each call of `step`, `reset` or `restore`, in a thread of their own, and take no time from the physics.
        The mouse moves cameras and pulls bodies: what is pulled moves in the steps. While the simulation is paused there (Ctrl+P), `step`
        waits, and Space lets one iteration through; Ctrl+C ends the waiting. The windows that are open are returned when there are some.

        A process can open windows for one simulation, once: the window system is not entered a second time. Raises RenderError if they
        cannot be opened, for example without a display; ClosedError, BusyError.
        """
        self._world.view()
        atexit.register(_close_view, weakref.ref(self._world))
        return Viewer(self)

    def _camera(self, camera: Camera) -> Optional[str]:
        if camera is None or isinstance(camera, str):
            return camera
        return self.cameras[_find(camera, self.cameras, "cameras")]

    def notices(self) -> List[str]:
        """Takes the sentences about commands that name what is not there, about what can't be drawn, and what plugins have to say."""
        return self._world.notices()

    def close(self) -> None:
        """Frees the physics. Arrays keep the numbers they have. May be called more than once."""
        self._world.close()

    def __enter__(self) -> Simulation:
        return self

    def __exit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        self.close()


class Viewer:
    """The windows of a simulation. `with` closes them in the end; without, they close with the simulation or the program."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation

    @property
    def is_open(self) -> bool:
        """Whether nobody has closed them."""
        return self.simulation._world.is_viewed

    def close(self) -> None:
        """Closes them; the simulation goes on. May be called more than once."""
        self.simulation._world.close_view()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        self.close()


class PassiveBody:
    """A body that can only be looked at."""

    def __init__(self, simulation: Simulation, number: int, name: str) -> None:
        self.simulation = simulation
        self.name = name
        self._number = number

    @property
    def pose(self) -> Array:
        """(7) position, m, and quaternion x, y, z, w of the body frame, now: a copy. Raises NotFoundError when it has left the scene."""
        return np.array(self._state()[0])

    @property
    def twist(self) -> Array:
        """(6) velocity of the centre of mass, m/s, and angular velocity, rad/s, now: a copy. Raises as `pose`."""
        return np.array(self._state()[1])

    def _state(self) -> Tuple[List[float], List[float]]:
        state = self.simulation._world.body_state(self._number)
        if state is None:
            raise NotFoundError(f"{self.name} has left the scene")
        return state


class Body(Arrays):
    """A body of a simulation and the joints below it. Its arrays are rows of those of the simulation."""

    def __init__(self, simulation: Simulation, index: int) -> None:
        self._bind(simulation, index)

    def _bind(self, simulation: Simulation, index: int) -> None:
        vars(self).clear()
        self.simulation = simulation
        self.index = index
        """Row in the arrays of bodies."""
        self.name = simulation.bodies[index]
        joints, indices = simulation._world.body_joints(index)
        self.joints: Tuple[str, ...] = tuple(joints)
        """Names of the joints below it, in the order of its joint commands."""
        self.joint_indices: NDArray[np.intp] = np.array(indices, dtype=np.intp)
        """(joints below) where they stand in the simulation's arrays."""
        self.pose: Array = simulation.poses[index]
        """(7) position, m, and quaternion x, y, z, w of the body frame. Read-only."""
        self.twist: Array = simulation.twists[index]
        """(6) velocity of the centre of mass, m/s, and angular velocity, rad/s. Read-only."""
        self.wrench: Array = simulation.wrenches[index]
        """(6) force, N, and torque, N·m; in force while `kind` is FORCE."""
        self.target_pose: Array = simulation.target_poses[index]
        """(7) position, m, and quaternion; in force while `kind` is POSITION."""
        self.target_twist: Array = simulation.target_twists[index]
        """(6) velocity, m/s, and angular velocity, rad/s; in force while `kind` is VELOCITY."""
        self.joint_kinds: Kinds
        self.joint_commands: Array
        self.joint_kinds, self.joint_commands = simulation._world.joint_commands(index)

    def __repr__(self) -> str:
        return f"<ambf.Body: {self.name}, {len(self.joints)} joints below, at {self.pose[:3].round(4).tolist()} m>"

    @property
    def kind(self) -> int:
        """How the body is commanded: NONE, FORCE, POSITION or VELOCITY."""
        return int(self.simulation.kinds[self.index])

    @kind.setter
    def kind(self, kind: int) -> None:
        if kind not in (NONE, FORCE, POSITION, VELOCITY):
            raise ValueError(f"kind: {kind} is no kind of command; expected {KINDS}")
        self.simulation.kinds[self.index] = kind

    @property
    def joint_positions(self) -> Array:
        """(joints below) rad or m: a copy."""
        return self.simulation.joint_positions[self.joint_indices]

    @property
    def joint_velocities(self) -> Array:
        """(joints below) rad/s or m/s: a copy."""
        return self.simulation.joint_velocities[self.joint_indices]

    @property
    def joint_efforts(self) -> Array:
        """(joints below) N·m or N: a copy."""
        return self.simulation.joint_efforts[self.joint_indices]

    @property
    def joint_wrenches(self) -> Array:
        """(joints below x 6) N and N·m: see `Simulation.joint_wrenches`. A copy."""
        return self.simulation.joint_wrenches[self.joint_indices]


class Sensor(Arrays):
    """A sensor of a simulation."""

    def __init__(self, simulation: Simulation, index: int) -> None:
        self.simulation = simulation
        self.name = simulation.sensors[index]
        self._bind()

    def _bind(self) -> _ambf.World:
        """The world, in which the sensor is looked for where models have come or gone."""
        world = self.simulation._world
        if vars(self).get("_world") is not world:
            vars(self).pop("measurements", None)
            self.index = place(self.name, self.simulation.sensors, "sensors")
            begin, end = world.sensor_rays(self.index)
            self.measurements: Array = self.simulation.measurements[begin:end]
            """(rays) 0 … 1, larger is closer, 0 is nothing. Read-only. Contact sensors have no rays: `readings` tells theirs."""
            self._world = world
        return world

    def __repr__(self) -> str:
        return f"<ambf.Sensor: {self.name}, {len(self.measurements)} rays>"

    def readings(self) -> Tuple[Array, Tuple[str, ...]]:
        """One number and one name a ray, or a contact (normal force, N): measurement, and body that is seen; "" for none."""
        measured, seen = self._bind().sensor_readings(self.index)
        return measured, tuple(seen)


class Actuator:
    """An actuator of a simulation: holds bodies."""

    def __init__(self, simulation: Simulation, index: int) -> None:
        self.simulation = simulation
        self.name = simulation.actuators[index]
        self._world: Optional[_ambf.World] = None
        self._bind()

    def _bind(self) -> _ambf.World:
        """The world, in which the actuator is looked for where models have come or gone."""
        world = self.simulation._world
        if self._world is not world:
            self.index = place(self.name, self.simulation.actuators, "actuators")
            self._world = world
        return world

    def __repr__(self) -> str:
        return f"<ambf.Actuator: {self.name}, {'holds something' if self.holding else 'holds nothing'}>"

    @property
    def holding(self) -> bool:
        """Whether it holds something."""
        self._bind()
        return bool(self.simulation.holding[self.index])

    def hold(self, *, sensor: str = "", body: str = "") -> None:
        """Holds what a sensor sees, or a body, from the next step on; given by identifier, or a part of it that is unique.

        Whether there is such a thing turns out in the step; `Simulation.notices` says so.
        """
        if bool(sensor) == bool(body):
            raise ValueError("give either sensor or body")
        self._bind().hold(self.index, True, sensor, body)

    def release(self) -> None:
        """Lets go in the next step."""
        self._bind().hold(self.index, False, "", "")


def step_all(simulations: Sequence[Simulation], steps: Union[int, Sequence[int]] = 1) -> None:
    """`Simulation.step` for each of them, at once on up to as many threads as there are processors; the threads are kept for the next call.

    The calling thread steps simulations, too, and alone where that is measured to be no slower: single steps of small scenes, or cores
    that other programs use. `steps`: iterations, the same for all or one number each. Each does what it would do alone, to the last
    bit. A simulation may not be given twice (ValueError). When some fail the others are stepped all the same, and the error of the
    first is raised; `NonFiniteError.index` says which it is.
    """
    worlds = [simulation._world for simulation in simulations]
    numbers = [_steps(number) for number in steps] if isinstance(steps, Iterable) else _steps(steps)
    problems = _ambf.step_all(worlds, numbers)
    if problems is None:
        return
    for index, problem in enumerate(problems):
        if problem is not None:
            if isinstance(problem, NonFiniteError):
                problem.index = index
            raise problem


class StackedStates(NamedTuple):
    """States of several simulations of the same scene, as copies."""

    sim_steps: NDArray[np.int64]
    """(simulations) iteration whose states they are."""
    sim_times: Array
    """(simulations) simulated time, s."""
    numbers: Array
    """(simulations x numbers) of each, one after the other: `poses`, `twists`, `joint_positions`, `joint_velocities`, `joint_efforts`,
    `measurements`, `holding` (1 or 0) and a zero, for what is not there.
    """


def stack_states(simulations: Sequence[Simulation]) -> StackedStates:
    """States of all simulations in one array. Raises ValueError if they have other numbers of bodies, joints, rays or actuators."""
    return StackedStates(*_ambf.stack_states([simulation._world for simulation in simulations]))


def _close_view(world: weakref.ref[_ambf.World]) -> None:
    """Windows are drawn by a thread that must not outlive the interpreter."""
    alive = world()
    if alive is not None:
        alive.close_view()


def _steps(steps: int) -> int:
    number = operator.index(steps)
    if not 0 <= number <= _MOST_STEPS:
        raise ValueError(f"steps={steps}: expected 0 to {_MOST_STEPS} iterations")
    return number


def _values(what: str, values: Optional[Values], names: Sequence[str], shape: Tuple[int, ...]) -> Optional[List[Any]]:
    """An array of values by the order of `names`, NaN where there is none."""
    if values is None:
        return None
    full = (len(names), *shape)
    if isinstance(values, Mapping):
        array = np.full(full, np.nan)
        for name, value in values.items():
            numbers = np.asarray(value, dtype=np.float64)
            if numbers.shape != shape:
                raise ValueError(
                    f"{what} of {name}: expected {shape or 'a'} number{'s' if shape else ''}, not {numbers.shape}"
                )
            array[_find(name, names, "joints" if not shape else "bodies")] = numbers
    else:
        array = np.asarray(values, dtype=np.float64)
        if array.shape != full:
            raise ValueError(f"{what}: expected {full} numbers, not {array.shape}")
    if shape == (7,):
        lengths = np.linalg.norm(array[:, 3:], axis=1)
        if (lengths == 0).any():
            raise ValueError(f"{what}: a quaternion (x, y, z, w) is zero, which is no orientation")
        array = np.column_stack([array[:, :3], array[:, 3:] / lengths[:, None]])
    listed: List[Any] = array.tolist()
    return listed


def _pose(values: ArrayLike) -> List[float]:
    numbers = np.asarray(values, dtype=np.float64)
    if numbers.shape != (7,):
        raise ValueError(f"a pose: expected 7 numbers (position, quaternion x, y, z, w), not {numbers.shape}")
    listed: List[float] = numbers.tolist()
    return listed


def _pixels(what: str, number: Optional[int]) -> Optional[int]:
    if number is not None and not 1 <= number <= _MOST_PIXELS:
        raise ValueError(f"{what}={number}: expected 1 to {_MOST_PIXELS} pixels")
    return None if number is None else int(number)
