"""Many worlds of a task in one `ambf.Batch`: observations and commands of all of them are arrays."""

from __future__ import annotations

import contextlib
import copy
from typing import Any, Callable, ContextManager, Dict, List, Optional, Sequence, Tuple, Union

import ambf
import gymnasium
import numpy as np
from ambf.names import find
from numpy.typing import NDArray

from .backend import FORCE, Array, Commands
from .env import Bounds, Task, Transition, action_space, names_of, stack
from .errors import InvalidDescription
from .gather import Gather, Layout, Seen, SeenStates, columns_by_name, is_known, narrow
from .in_process import physics_options, span
from .many import Infos, Mask, checked, judge
from .parts import DriveBody, DriveJoints, Hold, move
from .scene import Scene, resources

Outcome = Tuple[NDArray[np.float32], Array, Mask, Mask, Infos]

_KINDS = {"effort": ambf.EFFORT, "force": ambf.FORCE, "position": ambf.POSITION, "velocity": ambf.VELOCITY}
_AS_IT_IS: ContextManager[None] = contextlib.nullcontext()


class Worlds:
    """`num_envs` worlds of a task, without autoreset: each returns what `SimulatorEnv` returns, to the bit.

    Tasks observe bodies, joints, rays of sensors and actuators, and drive bodies, joints and actuators; observation parts of one's own read
    arrays of worlds in a task with `of_arrays`. Those with action parts of their own need `InProcessVectorEnv`. `states.sensors` is empty:
    what rays see stands in `batch.measurements` and `batch.sensed`.
    """

    def __init__(
        self,
        scene: Scene,
        task: Task,
        num_envs: int,
        *,
        max_episode_steps: Optional[int] = None,
        integrator: Optional[str] = None,
    ) -> None:
        """Loads the worlds; `integrator`: one of `scene.INTEGRATORS` instead of the scene's.

        Raises InvalidDescription, ambf.LoadError, ValueError.
        """
        if num_envs < 1:
            raise ValueError(f"num_envs={num_envs}: expected 1 or more")
        if task.n_skip_steps < 1 or task.settle_steps < 1 or (max_episode_steps or task.max_steps) < 1:
            raise InvalidDescription("n_skip_steps, settle_steps and the steps of an episode are 1 or more")
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps or task.max_steps
        self._task = task = copy.deepcopy(task)
        scene = scene.integrated_by(integrator)
        limits = scene.joint_limits()
        self._low, self._high, self._slices = stack([part.bounds(limits) for part in task.act])
        low, high, self._pieces = stack([part.bounds(limits) for part in task.observe])
        infinite = np.full(task.goal_size, np.inf)
        self._bounds = Bounds(self._low, self._high, task.scaled_actions)
        self.action_space = action_space(self._low, self._high, task.scaled_actions)
        self.observation_space = gymnasium.spaces.Box(
            np.concatenate((low, -infinite)).astype(np.float32), np.concatenate((high, infinite)).astype(np.float32)
        )
        launch = scene.launch() or str(resources() / "launch.yaml")
        options = physics_options(scene.options)
        self.batch = ambf.Batch(scene.model_files(), num_envs, launch_file=launch, **options)
        """The worlds: parameters may be changed through it."""
        batch = self.batch
        self.layout = Layout(len(batch.bodies), len(batch.joints), batch.measurements.shape[1], len(batch.actuators))
        self._columns: Dict[str, Dict[str, int]] = {}
        try:
            self._prepare()
        except BaseException:
            self.batch.close()
            raise

    def _prepare(self) -> None:
        """Finds where everything stands."""
        task, batch = self._task, self.batch
        bodies, _, actuators = names_of(task)
        try:
            self._rows = {name: batch.body(name) for name in bodies}
            self._actuators = {name: batch.actuator(name) for name in actuators}
            self._gather = Gather([part for part in task.observe if is_known(part)], self)
        except LookupError as error:
            raise InvalidDescription(f"{error}; with other parts use InProcessVectorEnv") from error
        self._seen = Seen(
            self.layout,
            [(name, row, list(self.joints(name).items())) for name, row in self._rows.items()],
            actuators=list(self._actuators.items()),
        )
        self._drives: List[_Drive] = []
        for part in task.act:
            makers: Dict[Any, Callable[[Any, Worlds], _Drive]] = {DriveJoints: _Joints, DriveBody: _Body, Hold: _Hold}
            if type(part) not in makers:
                raise InvalidDescription(f"{part} is no part of this package; use InProcessVectorEnv")
            self._drives.append(makers[type(part)](part, self))
        # Parts of one's own read the states; the numbers of all others stand between them.
        own = [not is_known(part) for part in task.observe]
        if any(own) and not task.of_arrays:
            raise InvalidDescription("parts of one's own read arrays of worlds: those of a task with of_arrays=True")
        self._own = [(part, piece) for part, piece, is_own in zip(task.observe, self._pieces, own) if is_own]
        places = [np.arange(piece.start, piece.stop) for piece, is_own in zip(self._pieces, own) if not is_own]
        self._others = span(np.concatenate([*places, np.zeros(0)]).astype(int).tolist())
        n = self.num_envs
        # What the functions of a task remember is of one world.
        self._tasks = [task] * n if task.of_arrays else [copy.deepcopy(task) for _ in range(n)]
        self._rngs: List[Optional[np.random.Generator]] = [None] * n
        self._goals = np.zeros((n, task.goal_size))
        self._steps = np.zeros(n, dtype=int)
        self._first_steps = np.zeros(n, dtype=np.int64)
        self._counts = np.ones(n, dtype=np.int64)
        self._ready = np.zeros(n, dtype=bool)
        batch.reset()
        batch.step(1)
        self._start = self._flat()
        self._states: Any = self._all_states(self._start)

    def reset(
        self, mask: Optional[Mask] = None, seeds: Optional[Sequence[Optional[int]]] = None
    ) -> NDArray[np.float32]:
        """Begins episodes in the worlds of `mask` (all if None); observations of all. `seeds`: one a world, None goes on."""
        chosen = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask)
        if chosen.shape != (self.num_envs,) or chosen.dtype != np.bool_:
            raise ValueError(f"mask: expected {self.num_envs} truth values")
        starts: Dict[int, Any] = {}
        for i in np.flatnonzero(chosen).tolist():
            seed = None if seeds is None else seeds[i]
            rng = self._rngs[i]
            if rng is None or seed is not None:
                rng = self._rngs[i] = gymnasium.utils.seeding.np_random(seed)[0]
            goal = np.asarray(self._tasks[i].goal(rng), dtype=np.float64)
            if goal.shape != (self._task.goal_size,):
                raise InvalidDescription(f"the goal has the shape {goal.shape}, goal_size is {self._task.goal_size}")
            self._goals[i] = goal
            start = self._tasks[i].start(rng)
            if start:
                starts[i] = start
        self._ready[chosen] = False
        states: Dict[str, Any] = {**self._state_arrays(starts)}
        self.batch.reset(chosen, **states)
        here = self._start
        if starts:
            set_ones = np.zeros(self.num_envs, dtype=bool)
            set_ones[list(starts)] = True
            self._step(np.where(set_ones, 1, 0))
            here = np.where(set_ones[:, None], self._flat(), self._start)
        self._rest(chosen, here)
        self._step(np.where(chosen, 1, 0))
        flat = self._flat()
        for drive in self._drives:
            drive.start(chosen, flat)
        if self._task.settle_steps > 1:
            self._rest(chosen, here)
            self._step(np.where(chosen, self._task.settle_steps - 1, 0))
            flat = self._flat()
        self._steps[chosen] = 0
        self._first_steps[chosen] = self._counts[chosen]
        self._ready[chosen] = True
        if self._task.of_arrays:
            self._states = self._all_states(flat)
        else:
            states = self._all_states(flat)
            for i in np.flatnonzero(chosen).tolist():
                self._states[i] = states[i]
        return self._observe(flat)

    def step(self, actions: Any) -> Outcome:
        """Observations, rewards, whether terminated and truncated, and infos of all worlds.

        A world whose state was lost is terminated with the reward 0 and `info["lost"]`. Raises InvalidAction, and no world has moved.
        """
        if not self._ready.all():
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        wanted = checked(actions, self.num_envs, len(self._low))
        applied, clipped = self._bounds.apply(wanted)
        for drive, piece in zip(self._drives, self._slices):
            drive.write(applied[:, piece])
        self._step(self._task.n_skip_steps)
        flat = self._flat()
        before, self._states = self._states, self._all_states(flat)
        self._steps += 1
        truncated = self._steps >= self.max_episode_steps
        columns = {"iterations": (self._counts - self._first_steps) % 2**32, "clipped": clipped}
        lost = self.batch.problems() if self.batch.lost.any() else {}
        if self._task.of_arrays:
            step: Any = Transition(before, self._states, applied, self._goals, self._steps)  # type: ignore[arg-type]
            # The functions see worlds that are lost, too.
            with np.errstate(invalid="ignore") if lost else _AS_IT_IS:
                rewards, terminated, more = judge(self._task, step, self.num_envs)
            infos = Infos({**columns, **more}, self.num_envs)
        else:
            infos = Infos(columns, self.num_envs)
            rewards, terminated = self._judge_each(before, applied, infos, lost)
        for i, problem in lost.items():
            infos[i]["lost"] = problem
            rewards[i], terminated[i] = 0.0, True
        return self._observe(flat), rewards, terminated, truncated & ~terminated, infos

    def _judge_each(self, before: Any, applied: Array, infos: Infos, lost: Any) -> Tuple[Array, Mask]:
        """Rewards and whether episodes have ended; adds to `infos`. Nothing is asked of worlds that are lost."""
        rewards, terminated = np.zeros(self.num_envs), np.zeros(self.num_envs, dtype=bool)
        for i in range(self.num_envs):
            if i in lost:
                continue
            step = Transition(before[i], self._states[i], applied[i], self._goals[i], int(self._steps[i]))
            task = self._tasks[i]
            infos[i].update(task.info(step))
            terminated[i] = bool(task.terminated(step))
            rewards[i] = float(task.reward(step))
        return rewards, terminated

    @property
    def states(self) -> Any:
        """What was observed last, in full: of all worlds as arrays, of which `states[i]` are those of one, in a task with `of_arrays`; else
        a list of those of each world.
        """
        return self._states

    def close(self) -> None:
        """Frees the worlds."""
        self.batch.close()

    def body(self, name: str) -> int:
        """See `gather.Finder`."""
        return self._rows[name]

    def joints(self, body: str) -> Dict[str, int]:
        """See `gather.Finder`."""
        if body not in self._columns:
            columns = self.batch.body_joints(self._rows[body])
            self._columns[body] = columns_by_name([self.batch.joints[i] for i in columns], columns.tolist(), body)
        return self._columns[body]

    def rays(self, sensor: str) -> Tuple[int, int]:
        """See `gather.Finder`."""
        columns, kinds = self.batch.columns(sensor), self.batch.sensor_types
        # Contact sensors have no rays.
        is_contact = kinds[find(sensor, self.batch.sensors, "sensors")] == "contact"
        return (0, 0) if is_contact else (columns.start, columns.stop)

    def actuator(self, name: str) -> int:
        """See `gather.Finder`."""
        return self._actuators[name]

    def _step(self, steps: Union[int, NDArray[Any]]) -> None:
        self.batch.step(steps)
        self._counts += steps

    def _flat(self) -> Array:
        """(worlds x numbers) all states; see `gather.Layout`."""
        b, n = self.batch, self.num_envs
        bodies = (b.poses.reshape(n, -1), b.twists.reshape(n, -1))
        joints = (b.joint_positions, b.joint_velocities, b.joint_efforts)
        flat: Array = np.concatenate((*bodies, *joints, b.measurements, b.holding, np.zeros((n, 1))), axis=1)
        narrow(flat, self.layout)
        return flat

    def _observe(self, flat: Array) -> NDArray[np.float32]:
        seen = self._gather.observe(flat)
        if self._own:
            known, seen = seen, np.empty((self.num_envs, self._pieces[-1].stop))
            seen[:, self._others] = known
            for part, piece in self._own:
                seen[:, piece] = part.read(self._states)
        return np.concatenate((seen, self._goals), axis=1, dtype=np.float32, casting="same_kind")

    def _all_states(self, flat: Array) -> Any:
        """States of each world, or of all at once."""
        states = SeenStates(self._counts.copy(), self.batch.times.copy(), flat, self._seen)
        return states if self._task.of_arrays else [states[i] for i in range(self.num_envs)]

    def _state_arrays(self, starts: Dict[int, Any]) -> Dict[str, Array]:
        """What `Task.start` has drawn, as arrays of all worlds."""
        shapes = {"joint_positions": (), "joint_velocities": (), "poses": (7,), "twists": (6,)}
        arrays: Dict[str, Array] = {}
        for i, start in starts.items():
            for what, values in start.items():
                if what not in shapes:
                    raise InvalidDescription(f"Task.start: {what}; expected {', '.join(shapes)}")
                names = self.batch.joints if what.startswith("joint_") else self.batch.bodies
                if what not in arrays:
                    arrays[what] = np.full((self.num_envs, len(names), *shapes[what]), np.nan)
                if isinstance(values, dict):
                    kind = "joints" if what.startswith("joint_") else "bodies"
                    for name, value in values.items():
                        arrays[what][i, find(name, names, kind)] = value
                else:
                    arrays[what][i] = values
        return arrays

    def _rest(self, chosen: Mask, flat: Array) -> None:
        """Commands that keep the chosen worlds as they are in `flat`, and those that are always the same."""
        also = Commands()
        self._task.also(also)
        for name, hold in also.actuators.items():
            self.batch.hold(self._actuators[name], hold.hold, chosen, sensor=hold.sensor, body=hold.body)
        # By body: column and kind of each joint that is commanded, with values of all worlds or one.
        joints: Dict[str, Dict[int, Tuple[int, Any]]] = {}
        for name, command in also.bodies.items():
            self._command_body(chosen, name, command.kind, command.linear, command.angular)
            columns = self.joints(name)
            joints[name] = {
                columns[joint]: (kind, float(np.float32(value))) for joint, (kind, value) in command.joints.items()
            }
        for drive in self._drives:
            drive.rest(chosen, flat, joints)
        for name, commanded in joints.items():
            if not commanded:
                continue
            below = self.batch.body_joints(self._rows[name]).tolist()
            # Joints before the last one that is commanded are told to do nothing, as over ROS.
            last = max(below.index(column) for column in commanded) + 1
            self.batch.joint_kinds[np.ix_(chosen, below[:last])] = ambf.EFFORT
            self.batch.joint_commands[np.ix_(chosen, below[:last])] = 0.0
            for column, (kind, value) in commanded.items():
                self.batch.joint_kinds[chosen, column] = kind
                self.batch.joint_commands[chosen, column] = value

    def _command_body(self, chosen: Mask, name: str, kind: int, linear: Any, angular: Any) -> None:
        row, batch = self._rows[name], self.batch
        batch.kinds[chosen, row] = kind
        target = {ambf.FORCE: batch.wrenches, ambf.POSITION: batch.target_poses, ambf.VELOCITY: batch.target_twists}[
            kind
        ]
        target[chosen, row, :3], target[chosen, row, 3:] = linear, angular


class _Drive:
    """An action part in all worlds."""

    def rest(self, chosen: Mask, flat: Array, joints: Dict[str, Dict[int, Tuple[int, Any]]]) -> None:
        """Keeps the chosen worlds as they are in `flat`: commands bodies, and names joints to command."""
        raise NotImplementedError

    def start(self, chosen: Mask, flat: Array) -> None:
        """Episodes begin."""

    def write(self, values: Array) -> None:
        """Puts actions of all worlds into the arrays."""
        raise NotImplementedError


class _Joints(_Drive):
    def __init__(self, part: DriveJoints, worlds: Worlds) -> None:
        self._part, self._worlds = part, worlds
        columns = worlds.joints(part.body)
        self._columns = np.array([columns[joint.replace(" ", "")] for joint in part.joints], dtype=np.intp)
        self._places = worlds.layout.joint(0, self._columns)
        self._commands = worlds.batch.joint_commands
        self._targets = span(self._columns.tolist())
        self._set_points = np.zeros((worlds.num_envs, len(self._columns)))

    def rest(self, chosen: Mask, flat: Array, joints: Dict[str, Dict[int, Tuple[int, Any]]]) -> None:
        kind, worlds = _KINDS[self._part.mode], self._worlds
        # Commands of joints are in single precision, as over ROS.
        here = np.full((chosen.sum(), len(self._places)), float(np.float32(self._part.at_rest or 0.0)))
        if self._part.mode == "position" and self._part.at_rest is None:
            here = flat[chosen][:, self._places]
        worlds._command_body(chosen, self._part.body, FORCE, 0.0, 0.0)
        commanded = joints.setdefault(self._part.body, {})
        commanded.update({int(column): (kind, here[:, k]) for k, column in enumerate(self._columns)})

    def start(self, chosen: Mask, flat: Array) -> None:
        self._set_points[chosen] = flat[chosen][:, self._places]

    def write(self, values: Array) -> None:
        if self._part.increment is not None:
            values = move(self._set_points, values, *self._part.span)
        self._commands[:, self._targets] = values.astype(np.float32)


class _Body(_Drive):
    def __init__(self, part: DriveBody, worlds: Worlds) -> None:
        self._part, self._worlds, self._row = part, worlds, worlds.body(part.body)

    def rest(self, chosen: Mask, flat: Array, joints: Dict[str, Dict[int, Tuple[int, Any]]]) -> None:
        del joints
        pose = flat[chosen][:, self._worlds.layout.pose(self._row)]
        is_position = self._part.mode == "position"
        linear, angular = (pose[:, :3], pose[:, 3:]) if is_position else (0.0, 0.0)
        self._worlds._command_body(chosen, self._part.body, _KINDS[self._part.mode], linear, angular)

    def start(self, chosen: Mask, flat: Array) -> None:
        if self._part.mode == "position":
            turn = flat[chosen][:, self._worlds.layout.pose(self._row)[3:]]
            self._worlds.batch.target_poses[chosen, self._row, 3:] = turn

    def write(self, values: Array) -> None:
        batch = self._worlds.batch
        targets = {"force": batch.wrenches, "velocity": batch.target_twists, "position": batch.target_poses}
        targets[self._part.mode][:, self._row, : self._part.size] = values


class _Hold(_Drive):
    def __init__(self, part: Hold, worlds: Worlds) -> None:
        self._part, self._batch, self._actuator = part, worlds.batch, worlds.actuator(part.actuator)

    def rest(self, chosen: Mask, flat: Array, joints: Dict[str, Dict[int, Tuple[int, Any]]]) -> None:
        del flat, joints
        self._batch.release(self._actuator, chosen)

    def write(self, values: Array) -> None:
        self._batch.hold(self._actuator, values[:, 0] > 0.0, sensor=self._part.sensor, body=self._part.body)
