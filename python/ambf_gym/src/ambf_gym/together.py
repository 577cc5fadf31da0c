"""Simulations of a task of arrays: what is done with each in a step of all is done with arrays of worlds."""

from __future__ import annotations

from typing import Any, List, NamedTuple, Optional, Sequence, Tuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from .backend import Array
from .env import Compiled, Row, SimulatorEnv, Transition
from .gather import SeenStates
from .in_process import InProcessBackend, stacked
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
        self.n_skip_steps = self._task.n_skip_steps
        """Iterations of a step."""
        acts = zip(*(env.compiled.task.act for env in envs if env.compiled))
        self._drives = [_Drive(of_all, backends) for of_all in acts]
        self.stepping = self.simulations
        """Those that make a step."""
        self._stepping = list(range(len(envs)))
        self._place: Any = slice(None)
        count = len(envs)
        self._rows: List[Any] = [Row(self, i) for i in range(count)]
        self.steps = np.zeros(count, dtype=np.intp)
        """(worlds) steps of the episodes."""
        self._first = np.zeros(count, dtype=np.int64)
        self._goals = np.zeros((count, self._task.goal_size))
        self._seen = backends[0].seen
        nothing = np.zeros((count, self._seen.layout.zero + 1))
        self.states = SeenStates(np.zeros(count, dtype=np.int64), np.zeros(count), nothing, self._seen)
        """(worlds) of all, after the last step; those of worlds that did not make it are in their environments."""

    @classmethod
    def of(cls, envs: Sequence[SimulatorEnv], backends: Sequence[InProcessBackend]) -> Optional[Together]:
        """None if the task is not one of arrays, has parts of other kinds, or observes or drives sensors, actuators or pictures."""
        parts = envs[0].compiled
        if parts is None or not parts.task.of_arrays or backends[0].seen.sensors or backends[0].seen.actuators:
            return None
        return cls(envs, backends, parts)

    def begin(self, wanted: Array, rows: List[int]) -> None:
        """Commands the actions (rows x size) in the worlds `rows`. Raises ResetNeeded, and nothing has changed."""
        self._take_in(rows)
        is_all = len(rows) == len(self._envs)
        self._stepping, self._place = rows, slice(None) if is_all else np.array(rows, dtype=np.intp)
        self.stepping = self.simulations if is_all else [self.simulations[i] for i in rows]
        self._before = self.states if is_all else self.states[self._place]
        self._applied, self._clipped = self._bounds.apply(wanted)
        for drive, piece in zip(self._drives, self._pieces):
            drive.write(self._applied[:, piece], rows, self._place)

    def end(self) -> Stepped:
        """What is seen after the iterations. Raises StepMismatch."""
        rows, place = self._stepping, self._place
        found = stacked([self._backends[i] for i in rows], self.n_skip_steps)
        after = SeenStates(found.sim_steps, found.sim_times, found.numbers, self._seen)
        self.steps[place] += 1
        if len(rows) == len(self._envs):
            self.states = after
        else:
            self._replace(place, after)
        steps, goals = self.steps[place].copy(), self._goals[place].copy()
        first = self._first[place]
        step: Any = Transition(self._before, after, self._applied, goals, steps)
        rewards, terminated, told = judge(self._task, step, len(rows))
        truncated = ~terminated & (steps >= self._envs[0].max_episode_steps)
        columns = {"iterations": (after.sim_step - first) % 2**32, "clipped": self._clipped, **told}
        assert after.flat is not None
        seen = (self._gather.observe(after.flat), goals)
        observations = np.concatenate(seen, axis=1, dtype=np.float32, casting="same_kind")
        return Stepped(observations, rewards, terminated, truncated, columns)

    def _take_in(self, rows: Sequence[int]) -> None:
        """Takes over what those of the worlds `rows` have reached that were not stepped here last. Raises ResetNeeded."""
        own = [i for i in rows if self._envs[i].latest is not self._rows[i]]
        states = [self._envs[i].states for i in own]
        if not own:
            return
        if not all(isinstance(one, SeenStates) for one in states):
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        for i in own:
            self.steps[i], self._first[i], self._goals[i] = self._envs[i].episode
            self._envs[i].latest = self._rows[i]
        steps, times, flat = zip(*((one.sim_step, one.sim_time, one.flat) for one in states if one is not None))
        self._replace(own, SeenStates(np.array(steps), np.array(times), np.stack(flat), self._seen))

    def _replace(self, rows: Any, states: SeenStates) -> None:
        """Other states of the worlds `rows`; the arrays of before stay what they are."""
        names = ("sim_step", "sim_time", "flat")
        arrays = {name: getattr(self.states, name).copy() for name in names}
        for name, array in arrays.items():
            array[rows] = getattr(states, name)
        self.states = SeenStates(**arrays, scene=self._seen)


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

    def write(self, values: Array, rows: Sequence[int], place: Any) -> None:
        """Commands values (rows x size) in the worlds `rows`, which are those at `place`."""
        if self._set_points is not None:
            self._set_points[place] = values = move(self._set_points[place], values, *self._part.span)
        if isinstance(self._part, DriveJoints):
            values = values.astype(np.float32)
        places = self._places
        for i, row in zip(rows, values):
            self._arrays[i][places] = row
