"""A Gymnasium environment whose physics is the simulator."""

from __future__ import annotations

import copy
import os
import time
from dataclasses import dataclass, field
from typing import (
    Any,
    Callable,
    Dict,
    Generator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Protocol,
    Sequence,
    Tuple,
    TypeVar,
    Union,
)

import gymnasium
import numpy as np
from numpy.typing import NDArray

from .backend import Array, Backend, Commands, Named, Pixels, Prepared, States, plain
from .errors import InvalidAction, InvalidDescription, NotObserved
from .gather import Gather, SeenStates
from .parts import ActionPart, ObservationPart

Observation = Any
"""A vector (float32); with pixels a dict of it ("state") and of pictures."""
Info = Dict[str, Any]
Outcome = Tuple[Observation, float, bool, bool, Info]
Result = TypeVar("Result")


class Order(NamedTuple):
    """Arguments of `Backend.step`."""

    commands: Commands
    steps: int
    reset: bool
    state: Optional[Mapping[str, Any]] = None
    """What the reset is followed by: arguments of `ambf.Simulation.set_state`."""


class Table(Protocol):
    """What several environments that are stepped as arrays have reached: arrays of worlds."""

    states: SeenStates
    steps: NDArray[np.intp]
    """(worlds) steps of the episodes."""


class Row(NamedTuple):
    """What a world has reached, as a row of a table: it is looked up when it is asked for."""

    table: Table
    world: int


Course = Generator[Order, States, Result]
"""Says what is to be stepped, is sent the states, and ends with a result."""


@dataclass(frozen=True)
class Transition:
    """A step, as reward and termination see it."""

    before: States
    after: States
    action: Array
    """As applied: within the bounds."""
    goal: Array
    """What `Task.goal` has drawn for this episode."""
    steps: int
    """Steps of the episode, this one included."""

    def once(self, function: Callable[[Transition], Result]) -> Result:
        """`function(self)`, computed when it is asked for first: what reward, end and info have in common."""
        kept: Dict[Any, Any] = self.__dict__.setdefault("_kept", {})
        if function not in kept:
            kept[function] = function(self)
        result: Result = kept[function]
        return result


def _no_goal(rng: np.random.Generator) -> Array:
    del rng
    return np.zeros(0)


def _no_start(rng: np.random.Generator) -> Mapping[str, Any]:
    del rng
    return {}


def _never(transition: Transition) -> bool:
    del transition
    return False


@dataclass(frozen=True)
class Task:
    """What is observed, what is done and what it is for."""

    observe: Sequence[ObservationPart]
    act: Sequence[ActionPart]
    reward: Callable[[Transition], float]
    terminated: Callable[[Transition], bool] = _never
    """Whether the episode has come to an end of its own: success or failure."""
    goal: Callable[[np.random.Generator], Array] = _no_goal
    """Draws a goal at the start of an episode; it is the last part of the observation."""
    start: Callable[[np.random.Generator], Mapping[str, Any]] = _no_start
    """Draws the state in which an episode begins, after the goal: arguments of `ambf.Simulation.set_state`, such as
    `{"joint_positions": {"elbow": rng.uniform(-1, 1)}}`. In this process only."""
    goal_size: int = 0
    """How many numbers `goal` returns."""
    also: Callable[[Commands], None] = field(default=lambda commands: None)
    """Adds commands that are always the same, such as those of joints that are not to move."""
    info: Callable[[Transition], Info] = field(default=lambda transition: {})
    """More about a step, for example `is_success`."""
    max_steps: int = 200
    """Steps after which an episode is truncated, unless `max_episode_steps` says otherwise where the environment is made."""
    scaled_actions: bool = True
    """Actions lie between -1 and 1, which stand for the bounds of the parts; else they are in the units of the parts."""
    n_skip_steps: int = 10
    """Physics iterations of a step: with the usual 1 ms, 10 are 100 steps a simulated second."""
    settle_steps: int = 1
    """Physics iterations between a reset and the first observation, 1 or more."""
    bodies: Sequence[str] = ()
    """Bodies whose state the functions need besides those that are observed."""
    of_arrays: bool = False
    """`reward`, `terminated` and `info` compute along the last axis of what they are given. `Worlds` and `InProcessVectorEnv` then call
    them once for all worlds, with states, actions, goals and steps that have an axis of worlds in front."""


class Compiled(NamedTuple):
    """What is done in a step, as arrays."""

    task: Task
    """With the memory of its parts."""
    bounds: Bounds
    gather: Gather
    pieces: Sequence[slice]
    """Where the numbers of each part of the action stand."""


class SimulatorEnv(gymnasium.Env[Any, Any]):
    """Steps a task in a backend. The simulator is started, or attached to, at the first reset, and after it failed at the next.

    Actions outside their bounds are moved to the nearest within; `info['clipped']` says so. `info['iterations']` counts the physics
    iterations of the episode.
    """

    metadata: Dict[str, Any] = {"render_modes": ["rgb_array", "human"], "render_fps": 100}  # noqa: RUF012  as in the base class

    def __init__(
        self,
        backend: Backend,
        task: Task,
        render_mode: Optional[str] = None,
        *,
        camera: Optional[str] = None,
        width: Optional[int] = None,
        height: Optional[int] = None,
        pixels: Union[Pixels, Sequence[Pixels]] = (),
        max_episode_steps: Optional[int] = None,
    ) -> None:
        """`render_mode`: "rgb_array": `render` returns what `camera` sees, (height x width x 3) uint8; "human": windows show the
        simulation in real time. `camera`: name, or a part of it that is unique; the first if None. `width`, `height`: pixels; what the
        camera publishes, else 640 x 480, if None.

        `pixels`: cameras whose pictures are observed. Observations are then a dict: `"state"`, the vector that is observed otherwise (if
        it is not empty), and what `Pixels` says.

        `max_episode_steps`: steps after which an episode is truncated; those of the task if None.

        Raises InvalidDescription if the task lacks bounds that the scene does not tell.
        """
        if max_episode_steps is not None and max_episode_steps < 1:
            raise ValueError(f"max_episode_steps={max_episode_steps}: expected 1 or more")
        self._most_steps = max_episode_steps
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode={render_mode!r}: expected one of {self.metadata['render_modes']}, or None")
        if task.n_skip_steps < 1 or task.settle_steps < 1 or task.max_steps < 1:
            raise InvalidDescription("n_skip_steps, settle_steps and max_steps are 1 or more")
        self.render_mode = render_mode
        self._backend = backend
        # What the backend in this process has beyond others.
        self._recorder: Any = backend if hasattr(backend, "next_recording") else None
        self._record_into: Optional[str] = None
        # Parts remember set points: those of another environment are not ours.
        self._task = copy.deepcopy(task)
        limits = backend.joint_limits()
        self._low, self._high, self._slices = stack([part.bounds(limits) for part in self._task.act])
        low, high, _ = stack([part.bounds(limits) for part in self._task.observe])
        infinite = np.full(task.goal_size, np.inf)
        low, high = np.concatenate((low, -infinite)), np.concatenate((high, infinite))
        self._bounds = Bounds(self._low, self._high, task.scaled_actions)
        self.action_space = action_space(self._low, self._high, task.scaled_actions)
        self._gather: Optional[Gather] = None
        self._writers: Optional[List[Callable[[Array], None]]] = None
        self._prepared = Prepared(pieces=self._slices)
        state = gymnasium.spaces.Box(low.astype(np.float32), high.astype(np.float32))
        self._pixels = (pixels,) if isinstance(pixels, Pixels) else tuple(pixels)
        self._has_state = len(low) > 0 or not self._pixels
        self.observation_space = _with_pixels(state if self._has_state else None, self._pixels)
        self._view = (camera, width, height)
        if render_mode is not None:
            # A rate of the instance, which follows from the task.
            rate = 1.0 / (task.n_skip_steps * backend.interval)
            self.metadata = {**self.metadata, "render_fps": max(1, round(rate))}
        if render_mode == "human":
            backend.show()
        self._shown_until = 0.0
        self._is_open = False
        self.latest: Union[States, Row, None] = None
        """What `states` tells, or where it stands."""
        self._goal: Array = np.zeros(task.goal_size)
        self._steps = 0
        self._first_step = 0

    def reset(
        self, *, seed: Optional[int] = None, options: Optional[Dict[str, Any]] = None
    ) -> Tuple[Observation, Info]:
        """Returns the simulation to its start. The same seed draws the same goals."""
        result = self._drive(self.resetting(seed=seed, options=options))
        self._shown_until = time.monotonic()
        return result

    def step(self, action: Any) -> Outcome:
        """Commands an action and lets `n_skip_steps` iterations pass.

        Raises InvalidAction; StepMismatch or an error of the backend if the simulator fails, after which `reset` starts afresh.
        """
        outcome = self._drive(self.stepping(action))
        if self.render_mode == "human":
            # In real time, or slower if the simulation is.
            now = time.monotonic()
            self._shown_until = max(self._shown_until + 1.0 / self.metadata["render_fps"], now)
            time.sleep(self._shown_until - now)
        return outcome

    def record(self, file: Union[str, os.PathLike[str]]) -> None:
        """Records the next episode, from its reset on, into a file that is not there yet, such as `episode.mcap`; until the reset after,
        `close` or `stop_recording`. A note `goal:` with the numbers of the goal stands where the first step begins. `ambf_export` makes
        data sets of recordings.

        In this process only, and not for environments that are stepped together: InvalidDescription.
        """
        if self._recorder is None:
            raise InvalidDescription(
                "episodes are recorded in this process only: make the environment with in_process=True"
            )
        self._record_into = os.fspath(file)

    def stop_recording(self) -> Optional[int]:
        """Completes the recording of an episode; how many updates are in it, or None if there is none. Raises ambf.RecordingError."""
        updates: Optional[int] = None if self._recorder is None else self._recorder.stop_recording()
        return updates

    def resetting(
        self, *, seed: Optional[int] = None, options: Optional[Dict[str, Any]] = None
    ) -> Course[Tuple[Observation, Info]]:
        """`reset` as a series of orders, for whoever steps many environments at once."""
        super().reset(seed=seed)
        if options:
            raise ValueError(f"there are no options, so not {sorted(options)}")
        self._goal = np.asarray(self._task.goal(self.np_random), dtype=np.float64)
        if self._goal.shape != (self._task.goal_size,):
            raise InvalidDescription(f"the goal has the shape {self._goal.shape}, goal_size is {self._task.goal_size}")
        if not self._is_open:
            self._open()
            # How things are at the start: what a reset returns to.
            self._start = yield Order(Commands(), 1, True)
        start = self._task.start(self.np_random)
        if self._record_into is not None:
            self._recorder.next_recording, self._record_into = self._record_into, None
        here = self._start
        if start:
            # What keeps things as they are there is seen when they are there.
            here = yield Order(Commands(), 1, True, start)
        states = yield Order(self._rest(here), 1, not start)
        for part in self._task.act:
            part.start(states)
        if self._task.settle_steps > 1:
            states = yield Order(self._rest(here), self._task.settle_steps - 1, False)
        self.latest = states
        self._steps = 0
        self._first_step = states.sim_step
        if self._recorder is not None and self._recorder.is_recording:
            self._recorder.simulation.note("goal: " + " ".join(repr(float(number)) for number in self._goal))
        return self._observation(states), {"iterations": 0}

    def stepping(self, action: Any) -> Course[Outcome]:
        """`step` as a series of orders."""
        before = self.states
        if before is None:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        wanted = self.checked(action)
        applied, is_clipped = self._bounds.apply(wanted)
        after = yield Order(self._commands(applied), self._task.n_skip_steps, False)
        self.latest = after
        self._steps += 1
        transition = Transition(before, after, applied, self._goal, self._steps)
        iterations = (after.sim_step - self._first_step) % 2**32
        info: Info = {"iterations": iterations, "clipped": bool(is_clipped)}
        more = self._task.info(transition)
        # Of array functions they are numbers of NumPy, of others what the task says.
        info.update(numbers_of_python(more) if self._task.of_arrays else more)
        terminated = bool(self._task.terminated(transition))
        truncated = not terminated and self._steps >= self.max_episode_steps
        return self._observation(after), float(self._task.reward(transition)), terminated, truncated, info

    @property
    def compiled(self) -> Optional[Compiled]:
        """What is done in a step, if the backend has found where all that is observed and done stands."""
        if self._gather is None or self._writers is None or self._pixels:
            return None
        return Compiled(self._task, self._bounds, self._gather, self._slices)

    @property
    def episode(self) -> Tuple[int, int, Array]:
        """Steps of the episode, the iteration after its reset, and its goal."""
        return self._steps, self._first_step, self._goal

    @property
    def max_episode_steps(self) -> int:
        """Steps after which an episode is truncated: as given, else those of the registered environment, else those of the task."""
        given = self._most_steps or (self.spec.max_episode_steps if self.spec is not None else None)
        return given or self._task.max_steps

    def _commands(self, applied: Array) -> Commands:
        """An action as commands. Those that are always the same are in force since the reset where the backend has compiled parts."""
        if self._writers is not None:
            self._prepared.writers, self._prepared.action = self._writers, applied
            return self._prepared
        commands = Commands()
        self._task.also(commands)
        for part, piece in zip(self._task.act, self._slices):
            part.write(applied[piece], commands)
        return commands

    def checked(self, action: Any) -> Array:
        """An action as an array of numbers. Raises InvalidAction."""
        wanted = np.asarray(action, dtype=np.float64)
        if wanted.shape != self._low.shape:
            raise InvalidAction(f"an action of the shape {wanted.shape}; expected {self._low.shape}")
        if not np.logical_and.reduce(np.isfinite(wanted)):
            raise InvalidAction(f"an action that is not finite: {wanted}")
        return wanted

    def render(self) -> Any:
        """The picture of mode "rgb_array", (height x width x 3) uint8; None in the others: windows show each step by themselves.

        Raises InvalidDescription if there is no such camera, or over ROS none that publishes; what the backend raises where nothing can
        be drawn.
        """
        if self.render_mode is None:
            gymnasium.logger.warn("render() without render_mode shows nothing; give render_mode='rgb_array' or 'human'")
            return None
        if self.latest is None:
            raise gymnasium.error.ResetNeeded("call reset() before render()")
        if self.render_mode == "human":
            return None
        return self._backend.render(*self._view, True, False)["rgb"]

    def close(self) -> None:
        """Lets go of the simulator; ends it if the environment has started it."""
        self._is_open = False
        self.latest = None
        self._backend.close()

    def action_parts(self) -> Sequence[Tuple[str, slice]]:
        """The body or actuator that each part of the action commands, and where its numbers stand."""
        named = (getattr(part, "actuator", "") or getattr(part, "body", "") for part in self._task.act)
        return [(str(name), piece) for name, piece in zip(named, self._slices)]

    @property
    def states(self) -> Optional[States]:
        """What was observed last, in full."""
        if isinstance(self.latest, Row):
            table, world = self.latest
            self.latest, self._steps = table.states[world], int(table.steps[world])
        return self.latest

    def _open(self) -> None:
        bodies, sensors, actuators = names_of(self._task)
        joints = self._backend.open(bodies, sensors, actuators)
        also = Commands()
        self._task.also(also)
        used: List[Tuple[str, Sequence[str]]] = [(name, list(body.joints)) for name, body in also.bodies.items()]
        used += [
            (getattr(part, "body", ""), getattr(part, "joints", ())) for part in (*self._task.observe, *self._task.act)
        ]
        for body, names in used:
            there = Named(f"joint of {body}", {name: name for name in joints.get(body, ())})
            try:
                for name in names:
                    _ = there[plain(name)]
            except NotObserved as error:
                self._backend.close()
                raise InvalidDescription(str(error)) from None
        gather, writers = getattr(self._backend, "gather", None), getattr(self._backend, "writers", None)
        self._gather = gather and gather(self._task.observe)
        self._writers = writers and writers(self._task.act)
        self._is_open = True

    def _rest(self, states: States) -> Commands:
        commands = Commands()
        self._task.also(commands)
        for part in self._task.act:
            part.rest(states, commands)
        return commands

    def _drive(self, course: Course[Result]) -> Result:
        """Carries out the orders. After a failure of the simulator the next reset starts afresh."""
        try:
            order = next(course)
            while True:
                state: Dict[str, Any] = {}
                if order.state:
                    if not getattr(self._backend, "sets_states", False):
                        raise InvalidDescription("Task.start: states are set in this process only, not over ROS")
                    state["state"] = order.state
                try:
                    states = self._backend.step(order.commands, order.steps, order.reset, **state)
                except BaseException:
                    self.close()
                    raise
                order = course.send(states)
        except StopIteration as end:
            result: Result = end.value
            return result

    def _observation(self, states: States) -> Observation:
        if self._gather is not None and states.flat is not None:
            parts = [self._gather.observe(states.flat)]
        else:
            parts = [part.read(states) for part in self._task.observe]
        state = np.concatenate((*parts, self._goal), dtype=np.float32, casting="same_kind")
        if not self._pixels:
            return state
        observation = {"state": state} if self._has_state else {}
        for view in self._pixels:
            picture = self._backend.render(view.camera, view.width, view.height, view.rgb, view.depth)
            if view.rgb:
                observation[view.name] = picture["rgb"]
            if view.depth:
                depth = np.minimum(picture["depth"], np.float32(view.depth_limit))
                observation[f"{view.name}_depth"] = depth[:, :, np.newaxis]
        return observation


def names_of(task: Task) -> Tuple[Sequence[str], Sequence[str], Sequence[str]]:
    """Names of the bodies, sensors and actuators that a task uses."""
    parts: List[Any] = [*task.observe, *task.act]
    also = Commands()
    task.also(also)
    bodies: List[Any] = [*task.bodies, *also.bodies]
    for part in parts:
        if not hasattr(part, "actuator"):
            bodies += [getattr(part, "body", None), getattr(part, "relative_to", None)]
    sensors = [part.sensor for part in parts if hasattr(part, "sensor") and not hasattr(part, "actuator")]
    actuators = [*(getattr(part, "actuator", None) for part in parts), *also.actuators]
    unique = [tuple(dict.fromkeys(name for name in names if name)) for names in (bodies, sensors, actuators)]
    return unique[0], unique[1], unique[2]


def action_space(low: Array, high: Array, is_scaled: bool) -> gymnasium.spaces.Box:
    """Between the bounds, or between -1 and 1, which stand for them."""
    if is_scaled:
        return gymnasium.spaces.Box(-1.0, 1.0, low.shape, np.float32)
    return gymnasium.spaces.Box(low.astype(np.float32), high.astype(np.float32))


class Bounds:
    """Bounds of actions: what actions stand for, within them."""

    def __init__(self, low: Array, high: Array, is_scaled: bool) -> None:
        self._low, self._high = low, high
        self._middle, self._half = 0.5 * (low + high), 0.5 * (high - low)
        self._is_scaled = is_scaled

    def apply(self, wanted: Array) -> Tuple[Array, NDArray[np.bool_]]:
        """(… x size) actions in the units of the parts and within the bounds; and (…) whether some were beyond."""
        if not self._is_scaled:
            inside = clip(wanted, self._low, self._high)
            return inside, np.logical_or.reduce(inside != wanted, axis=-1)
        inside = clip(wanted, -1.0, 1.0)
        # A rounding error may lead beyond the bounds.
        applied = clip(self._middle + self._half * inside, self._low, self._high)
        return applied, np.logical_or.reduce(inside != wanted, axis=-1)


def clip(values: Array, low: Any, high: Any) -> Array:
    """What `numpy.clip` does, in half the time where there are few numbers."""
    clipped: Array = np.minimum(np.maximum(values, low), high)
    return clipped


def numbers_of_python(info: Info) -> Info:
    """Scalars of NumPy as numbers and truth values of Python."""
    return {key: value.item() if isinstance(value, np.generic) else value for key, value in info.items()}


def _with_pixels(state: Optional[gymnasium.spaces.Box], pixels: Sequence[Pixels]) -> gymnasium.spaces.Space[Any]:
    if not pixels:
        assert state is not None
        return state
    spaces: Dict[str, gymnasium.spaces.Space[Any]] = {} if state is None else {"state": state}
    for view in pixels:
        if not (view.rgb or view.depth) or min(view.width, view.height) < 1 or not view.depth_limit > 0.0:
            raise InvalidDescription(f"{view}: give rgb or depth, sizes of 1 or more, and a limit above 0")
        shape = (view.height, view.width)
        new: Dict[str, gymnasium.spaces.Space[Any]] = {}
        if view.rgb:
            new[view.name] = gymnasium.spaces.Box(0, 255, (*shape, 3), np.uint8)
        if view.depth:
            new[f"{view.name}_depth"] = gymnasium.spaces.Box(0.0, view.depth_limit, (*shape, 1), np.float32)
        if spaces.keys() & new.keys():
            raise InvalidDescription(
                f"two observations are called {', '.join(spaces.keys() & new.keys())}; give pixels a name each"
            )
        spaces.update(new)
    return gymnasium.spaces.Dict(spaces)


def stack(bounds: Sequence[Tuple[Array, Array]]) -> Tuple[Array, Array, Sequence[slice]]:
    """Bounds of all parts one after the other, and where each part's are."""
    if not bounds:
        return np.zeros(0), np.zeros(0), ()
    ends = np.cumsum([len(low) for low, _ in bounds])
    slices = [slice(int(end) - len(low), int(end)) for end, (low, _) in zip(ends, bounds)]
    return np.concatenate([low for low, _ in bounds]), np.concatenate([high for _, high in bounds]), slices
