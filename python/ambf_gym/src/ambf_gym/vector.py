"""Many worlds of a task in one process, stepped at once on threads."""

from __future__ import annotations

import concurrent.futures
import os
from typing import Any, Dict, Generator, List, Optional, Sequence, Tuple, Union

import ambf
import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.vector.utils import iterate
from numpy.typing import NDArray

from .backend import Pixels
from .env import Course, Info, Observation, Order, SimulatorEnv, Task, numbers_of_python
from .in_process import InProcessBackend
from .many import Columns, checked
from .scene import Scene
from .together import Stepped, Together

Ready = List[Any]


class InProcessVectorEnv(SyncVectorEnv):
    """`num_envs` environments of a task, each with a simulation of its own: what they return is what each would return alone.

    It is used like any vector environment of Gymnasium, with its three modes of autoreset; world `i` is seeded with `seed + i`. When a
    simulation fails the error is raised and all are closed; the next `reset` starts afresh.
    """

    def __init__(
        self,
        scene: Scene,
        task: Task,
        num_envs: int,
        autoreset_mode: Union[str, AutoresetMode] = AutoresetMode.NEXT_STEP,
        *,
        render_mode: Optional[str] = None,
        camera: Optional[str] = None,
        width: Optional[int] = None,
        height: Optional[int] = None,
        pixels: Union[Pixels, Sequence[Pixels]] = (),
        max_episode_steps: Optional[int] = None,
        integrator: Optional[str] = None,
    ) -> None:
        """`render_mode`, "rgb_array" or None, and what follows: as those of `SimulatorEnv`; pictures are drawn on threads too.
        `integrator`: one of `scene.INTEGRATORS` instead of the scene's.

        Raises InvalidDescription as `SimulatorEnv` does; simulations are loaded at the first reset.
        """
        if num_envs < 1:
            raise ValueError(f"num_envs={num_envs}: expected 1 or more")
        self._backends = [InProcessBackend(scene, integrator=integrator) for _ in range(num_envs)]
        if render_mode == "human":
            raise ValueError(
                "render_mode='human' shows one world: make a single environment with it, or use 'rgb_array'"
            )
        view: Dict[str, Any] = {"camera": camera, "width": width, "height": height, "pixels": pixels}
        view["max_episode_steps"] = max_episode_steps
        self._lanes = [_Lane(SimulatorEnv(backend, task, render_mode, **view)) for backend in self._backends]
        # Pictures are drawn side by side; what is only numbers is not worth a thread.
        self._draws = bool(pixels)
        self._together: Optional[Together] = None
        self._pool: Optional[concurrent.futures.ThreadPoolExecutor] = None
        super().__init__([lambda lane=lane: lane for lane in self._lanes], autoreset_mode=autoreset_mode)  # type: ignore[misc]

    def reset(
        self,
        *,
        seed: Union[int, List[Optional[int]], None] = None,
        options: Optional[Dict[str, Any]] = None,
    ) -> Tuple[Any, Dict[str, Any]]:
        """See `SyncVectorEnv.reset`; with the option `reset_mask` only those of the mask."""
        count = self.num_envs
        seeds = [seed + i for i in range(count)] if isinstance(seed, int) else seed or [None] * count
        mask = np.ones(count, dtype=np.bool_)
        if self._together is not None:
            self._env_obs = list(self._observations.copy())
        rest = dict(options or {})
        if "reset_mask" in rest:
            mask = rest.pop("reset_mask")
        # Otherwise the base class says what is wrong, and no world has moved.
        if len(seeds) == count and isinstance(mask, np.ndarray) and mask.shape == (count,) and mask.dtype == np.bool_:
            self._run(
                {i: _single(lane.unwrapped.resetting(seed=seeds[i], options=rest)) for i, lane in self._chosen(mask)}
            )
        return super().reset(seed=seed, options=options)

    def step(self, actions: Any) -> Tuple[Any, Any, Any, Any, Dict[str, Any]]:
        """See `SyncVectorEnv.step`. Raises InvalidAction; then no world has moved."""
        together = self._compiled()
        return self._step_each(actions) if together is None else self._step_together(actions, together)

    def _step_each(self, actions: Any) -> Tuple[Any, Any, Any, Any, Dict[str, Any]]:
        """Each world does what it does alone, but for the simulations, which are stepped at once."""
        for lane, action in zip(self._lanes, iterate(self.action_space, actions)):
            lane.unwrapped.checked(action)
        is_same_step = self.autoreset_mode == AutoresetMode.SAME_STEP
        courses: Dict[int, Course[Ready]] = {}
        for i, (action, lane) in enumerate(zip(iterate(self.action_space, actions), self._lanes)):
            if self.autoreset_mode == AutoresetMode.NEXT_STEP and self._autoreset_envs[i]:
                courses[i] = _single(lane.unwrapped.resetting())
            elif is_same_step:
                courses[i] = _step_and_reset(lane.unwrapped, action)
            else:
                courses[i] = _single(lane.unwrapped.stepping(action))
        self._run(courses)
        return super().step(actions)

    def _compiled(self) -> Optional[Together]:
        """The worlds as arrays; None if they are not open, or the task is none for arrays."""
        simulations = [backend.opened for backend in self._backends]
        # They are others after a failure.
        if self._together is None or self._together.simulations != simulations:
            self._together = None
            if None not in simulations and not self._draws:
                self._together = Together.of([lane.unwrapped for lane in self._lanes], self._backends)
        return self._together

    def _step_together(self, actions: Any, together: Together) -> Tuple[Any, Any, Any, Any, Dict[str, Any]]:
        """What `_step_each` does, with arrays of all worlds that make a step."""
        count, mode = self.num_envs, self.autoreset_mode
        wanted = checked(actions, count, self.single_action_space.shape[0])  # type: ignore[index]
        # As in the base class: who resets by hand has to.
        assert mode != AutoresetMode.DISABLED or not self._autoreset_envs.any(), f"{self._autoreset_envs=}"
        resets = self._resets(self._autoreset_envs) if mode == AutoresetMode.NEXT_STEP else {}
        rows = [i for i in range(count) if i not in resets]
        if rows:
            together.begin(wanted[rows] if resets else wanted, rows)
        stepped = self._run(resets, together if rows else None)
        if stepped is not None and not resets:
            observations, rewards, terminated, truncated, columns = stepped
        else:
            observations = np.zeros(self._observations.shape, dtype=np.float32)
            rewards, (terminated, truncated) = np.zeros(count), np.zeros((2, count), dtype=np.bool_)
            columns = {}
            if stepped is not None:
                (observations[rows], rewards[rows], terminated[rows], truncated[rows], columns) = stepped
        over = terminated | truncated
        # What is told of worlds one by one, in its order.
        told: Dict[int, List[Info]] = {i: [] for i in resets}
        if mode == AutoresetMode.SAME_STEP and over.any():
            for i in over.nonzero()[0].tolist():
                last = numbers_of_python({key: column[i] for key, column in columns.items()})
                told[i] = [{"final_obs": observations[i].copy(), "final_info": last}]
            self._run(self._resets(over))
        for i, infos in told.items():
            observations[i], begun = self._lanes[i].ready.pop(0)
            infos.append(begun)
        # What the base class needs when it resets some.
        self._observations[...], self._autoreset_envs = observations, over
        return observations, rewards, terminated, truncated, self._tell(columns, rows, told)

    def _resets(self, mask: NDArray[np.bool_]) -> Dict[int, Course[Ready]]:
        return {i: _single(self._lanes[i].unwrapped.resetting()) for i in mask.nonzero()[0].tolist()}

    def _tell(self, columns: Columns, rows: List[int], told: Dict[int, List[Info]]) -> Dict[str, Any]:
        """Infos as `_add_info` puts them together, world after world: those in `told`, and columns of the others among `rows`."""
        if not told:
            masks = {f"_{key}": np.ones(self.num_envs, dtype=np.bool_) for key in columns}
            return {key: value for pair in zip(columns.items(), masks.items()) for key, value in pair}
        infos: Dict[str, Any] = {}
        # The first world decides which key comes first.
        for info in told.get(0, ()):
            infos = self._add_info(infos, info, 0)
        others = [k for k, i in enumerate(rows) if i not in told]
        places = [rows[k] for k in others]
        for key, column in columns.items() if others else ():
            if key not in infos:
                empty = None if column.dtype == object else 0
                infos[key] = np.full((self.num_envs, *column.shape[1:]), empty, dtype=column.dtype)
                infos[f"_{key}"] = np.zeros(self.num_envs, dtype=np.bool_)
            infos[key][places], infos[f"_{key}"][places] = column[others], True
        for i, of_world in told.items():
            for info in of_world if i else ():
                infos = self._add_info(infos, info, i)
        return infos

    def render(self) -> Tuple[Any, ...]:
        """One picture a world, drawn side by side."""
        return tuple(self._threads().map(lambda lane: lane.unwrapped.render(), self._lanes))

    def close_extras(self, **kwargs: Any) -> None:
        """Closes all worlds and the threads that draw."""
        super().close_extras(**kwargs)
        pool, self._pool = self._pool, None
        if pool is not None:
            pool.shutdown()

    def _threads(self) -> concurrent.futures.ThreadPoolExecutor:
        if self._pool is None:
            workers = min(self.num_envs, os.cpu_count() or 1)
            self._pool = concurrent.futures.ThreadPoolExecutor(workers, thread_name_prefix="ambf-draw")
        return self._pool

    def _chosen(self, mask: Any) -> Sequence[Tuple[int, _Lane]]:
        return [(i, lane) for i, lane in enumerate(self._lanes) if mask[i]]

    def _run(self, courses: Dict[int, Course[Ready]], together: Optional[Together] = None) -> Optional[Stepped]:
        """Carries out all courses, their orders side by side, and a step of other worlds beside the first of them, which has begun;
        results of courses wait in the lanes.
        """
        for lane in self._lanes:
            lane.ready.clear()
        orders: Dict[int, Order] = {}
        stepped: Optional[Stepped] = None
        try:
            for i, course in courses.items():
                self._advance(orders, i, course, None)
            while orders or (together and not stepped):
                for i, order in orders.items():
                    self._backends[i].prepare(order.commands, order.reset, order.state)
                simulations = [self._backends[i].simulation for i in orders]
                steps = [order.steps for order in orders.values()]
                if together and not stepped:
                    simulations += together.stepping
                    steps += [together.n_skip_steps] * len(together.stepping)
                ambf.step_all(simulations, steps)
                if together and not stepped:
                    stepped = together.end()
                if orders:
                    done = list(orders.items())
                    # Where a course observes, it draws.
                    run = self._threads().map if self._draws else map
                    for _ in run(lambda one: self._observe(orders, courses, *one), done):
                        pass
        except BaseException:
            for lane in self._lanes:
                lane.close()
            raise
        return stepped

    def _observe(self, orders: Dict[int, Order], courses: Dict[int, Course[Ready]], i: int, order: Order) -> None:
        self._advance(orders, i, courses[i], self._backends[i].observe(order.steps))

    def _advance(self, orders: Dict[int, Order], i: int, course: Course[Ready], states: Any) -> None:
        try:
            orders[i] = course.send(states)
        except StopIteration as end:
            orders.pop(i, None)
            self._lanes[i].ready.extend(end.value)


class _Lane(gymnasium.Wrapper[Observation, Any, Observation, Any]):
    """An environment whose results have been computed before they are asked for."""

    def __init__(self, env: SimulatorEnv) -> None:
        super().__init__(env)
        self.ready: Ready = []

    @property
    def unwrapped(self) -> SimulatorEnv:
        """The environment."""
        env: SimulatorEnv = self.env  # type: ignore[assignment]
        return env

    def reset(self, *, seed: Optional[int] = None, options: Optional[Dict[str, Any]] = None) -> Any:
        """What is ready."""
        return self.ready.pop(0) if self.ready else self.env.reset(seed=seed, options=options)

    def step(self, action: Any) -> Any:
        """What is ready."""
        return self.ready.pop(0) if self.ready else self.env.step(action)


def _single(course: Course[Any]) -> Course[Ready]:
    result = yield from course
    return [result]


def _step_and_reset(env: SimulatorEnv, action: Any) -> Generator[Order, Any, Ready]:
    outcome = yield from env.stepping(action)
    if not (outcome[2] or outcome[3]):
        return [outcome]
    start = yield from env.resetting()
    return [outcome, start]
