"""Simulations of a task of arrays: what is done with each in a step of all is done with arrays of worlds."""

from __future__ import annotations

from typing import Any, List, NamedTuple, Optional, Sequence, Tuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from .backend import Array
from .env import Compiled, Row, SimulatorEnv, Transition
from .gather import Flattener, SeenStates
from .in_process import InProcessBackend
from .many import Columns, Mask, judge
from .parts import DriveJoints, move


class Stepped(NamedTuple):
    """What the worlds that made a step return, in their order."""

    observations: NDArray[np.float32]
    rewards: Array
    terminated: Mask
    truncated: Mask
    columns: Columns


class Together:
    """Environments of one task, which is one of arrays, each with a simulation of its own."""

    def __init__(self, envs: Sequence[SimulatorEnv], backends: Sequence[InProcessBackend], parts: Compiled) -> None:
        """`envs` are open and compiled; `parts`: those of the first of them."""
        self.simulations = [backend.simulation for backend in backends]
        """The simulations; after a failure there are others."""
        self._envs, self._backends = envs, backends
        self._task, self._bounds, self._gather, self._pieces = parts
        self.steps = self._task.n_skip_steps
        """Iterations of a step."""
        self._flatten, self._seen = Flattener(backends[0].layout), backends[0].seen
        self._arrays = [backend.arrays() for backend in backends]
        acts = zip(*(env.compiled.task.act for env in envs if env.compiled))
        self._drives = [_Drive(parts_of_all, backends) for parts_of_all in acts]
        self.rows: List[int] = []
        """Numbers of the worlds that make a step."""

    @classmethod
    def of(cls, envs: Sequence[SimulatorEnv], backends: Sequence[InProcessBackend]) -> Optional[Together]:
        """None if the task is not one of arrays, has parts of other kinds, or observes or drives sensors, actuators or pictures."""
        parts = envs[0].compiled
        if parts is None or not parts.task.of_arrays or backends[0].seen.sensors or backends[0].seen.actuators:
            return None
        return cls(envs, backends, parts)

    def begin(self, wanted: Array, rows: Sequence[int]) -> None:
        """Commands the actions (rows x size) in the worlds `rows`. Raises ResetNeeded, and nothing has changed."""
        self.rows = list(rows)
        self._before = self._states()
        self._applied, self._clipped = self._bounds.apply(wanted)
        for drive, piece in zip(self._drives, self._pieces):
            drive.write(self._applied[:, piece], self.rows)

    def end(self) -> Stepped:
        """What is seen after the iterations. Raises StepMismatch."""
        rows, count = self.rows, len(self.rows)
        envs = [self._envs[i] for i in rows]
        counts = np.array([self._backends[i].count(self.steps) for i in rows])
        times = np.array([self.simulations[i].sim_time for i in rows])
        flat = self._flatten.worlds([self._arrays[i] for i in rows])
        after = SeenStates(counts, times, flat, self._seen)
        goals = np.empty((count, self._task.goal_size))
        made, first = np.empty(count, dtype=int), np.empty(count, dtype=int)
        for k, env in enumerate(envs):
            made[k], first[k], goals[k] = env.moved(Row(after, k))
        step: Any = Transition(self._before, after, self._applied, goals, made)  # type: ignore[arg-type]
        rewards, terminated, columns = judge(self._task, step, count)
        truncated = ~terminated & (made >= envs[0].max_episode_steps)
        columns = {"iterations": (counts - first) % 2**32, "clipped": self._clipped, **columns}
        seen = (self._gather.observe(flat), goals)
        observations = np.concatenate(seen, axis=1, dtype=np.float32, casting="same_kind")
        return Stepped(observations, rewards, terminated, truncated, columns)

    def _states(self) -> SeenStates:
        """States of the worlds that are to make a step."""
        seen = [self._envs[i].latest for i in self.rows]
        if isinstance(seen[0], Row):
            before = seen[0].all
            places = [one.world for one in seen if isinstance(one, Row) and one.all is before]
            if len(before) == len(seen) and places == list(range(len(seen))):
                return before
        states = [self._envs[i].states for i in self.rows]
        if any(one is None for one in states):
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        steps, times, flats = zip(*((one.sim_step, one.sim_time, one.flat) for one in states if one is not None))
        return SeenStates(np.array(steps), np.array(times), np.stack(flats), self._seen)


class _Drive:
    """An action part in all worlds: each has one of its own, which goes into arrays of its simulation."""

    def __init__(self, parts: Sequence[Any], backends: Sequence[InProcessBackend]) -> None:
        targets: List[Tuple[Array, Any]] = [backend.target(part) for part, backend in zip(parts, backends)]
        self._arrays = [array for array, _ in targets]
        self._places = targets[0][1]
        self._part = parts[0]
        self._set_points: Optional[Array] = None
        if isinstance(self._part, DriveJoints) and self._part.increment is not None:
            # The parts go on to use them: a reset begins with where the joints are.
            self._set_points = np.stack([part.set_point for part in parts])
            for part, row in zip(parts, self._set_points):
                part.keep_in(row)

    def write(self, values: Array, rows: Sequence[int]) -> None:
        """Commands values (rows x size) in the worlds `rows`."""
        if self._set_points is not None:
            points = self._set_points[rows]
            self._set_points[rows] = values = move(points, values, *self._part.span)
        if isinstance(self._part, DriveJoints):
            values = values.astype(np.float32)
        for i, row in zip(rows, values):
            self._arrays[i][self._places] = row
