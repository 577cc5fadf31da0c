"""What all worked tasks have in common: the options with which their environments are made."""

from __future__ import annotations

import importlib.util
from typing import Any, Callable, Dict, Optional, Sequence, SupportsFloat, Tuple, Union

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv

from ..backend import Array, Backend, Pixels
from ..env import Info, SimulatorEnv, Task
from ..errors import InvalidDescription
from ..scene import Scene

PROCESS, ROS = "process", "ros"

OPTIONS = """

`backend`: "process", in this process with the package `ambf`; "ros", over ROS in a simulator of its own; or a `Backend`. None: in this
process if the package `ambf` is installed, else over ROS. `in_process`: True is "process", False "ros". `render_mode`, `camera`, `width`,
`height`, `pixels`, `max_episode_steps`: as those of `SimulatorEnv`. `integrator`: one of `ambf_gym.scene.INTEGRATORS`; None: the scene's.
Others are options of `RosBackend`.
"""


def makers(
    name: str, scene: Scene, task: Task
) -> Tuple[Callable[..., SimulatorEnv], Callable[..., VectorEnv[Any, Any, Any]]]:
    """The functions that make an environment of the task `ambf/NAME-v0`, and many of them at once; both have the same options."""

    def make(
        backend: Union[Backend, str, None] = None,
        render_mode: Optional[str] = None,
        *,
        in_process: Optional[bool] = None,
        camera: Optional[str] = None,
        width: Optional[int] = None,
        height: Optional[int] = None,
        pixels: Union[Pixels, Sequence[Pixels]] = (),
        max_episode_steps: Optional[int] = None,
        integrator: Optional[str] = None,
        **ros: Any,
    ) -> SimulatorEnv:
        chosen = make_backend(scene, which(backend, in_process), ros, integrator)
        view: Dict[str, Any] = {"camera": camera, "width": width, "height": height}
        view["max_episode_steps"] = max_episode_steps
        return SimulatorEnv(chosen, task, render_mode, pixels=pixels, **view)

    def make_vec(
        num_envs: int = 1,
        backend: Union[Backend, str, None] = None,
        render_mode: Optional[str] = None,
        *,
        in_process: Optional[bool] = None,
        autoreset_mode: Union[str, AutoresetMode] = AutoresetMode.NEXT_STEP,
        **options: Any,
    ) -> VectorEnv[Any, Any, Any]:
        chosen = which(backend, in_process)
        if chosen == PROCESS:
            from ..vector import InProcessVectorEnv

            return InProcessVectorEnv(scene, task, num_envs, autoreset_mode, render_mode=render_mode, **options)
        if not isinstance(chosen, str):
            raise InvalidDescription('a backend is one world; for several give backend="process" or "ros"')
        return SyncVectorEnv(
            [lambda: make(ROS, render_mode, **options) for _ in range(num_envs)], autoreset_mode=autoreset_mode
        )

    make.__doc__ = f"The environment `ambf/{name}-v0`. {OPTIONS}"
    make_vec.__doc__ = (
        f"`num_envs` environments `ambf/{name}-v0`: in this process on threads, as `InProcessVectorEnv`; over ROS one after the other. "
        f"`autoreset_mode`: as of Gymnasium's vector environments. {OPTIONS}"
    )
    for function, ending in ((make, ""), (make_vec, "_vec")):
        function.__name__ = function.__qualname__ = f"make_{name.lower()}{ending}"
    return make, make_vec


def which(backend: Union[Backend, str, None], in_process: Optional[bool]) -> Union[Backend, str]:
    """What `backend` and `in_process` ask for: a backend, "process" or "ros". Raises InvalidDescription."""
    if in_process is not None:
        asked = PROCESS if in_process else ROS
        if backend not in (None, asked):
            raise InvalidDescription(f"in_process={in_process} and backend={backend!r} contradict each other")
        return asked
    if backend is None:
        return PROCESS if importlib.util.find_spec("ambf") else ROS
    if isinstance(backend, str) and backend not in (PROCESS, ROS):
        raise InvalidDescription(f'backend={backend!r}: expected "{PROCESS}", "{ROS}" or a backend')
    return backend


def make_backend(
    scene: Scene, chosen: Union[Backend, str], ros: Dict[str, Any], integrator: Optional[str] = None
) -> Backend:
    """The backend for `scene`. What it needs, ROS or the package `ambf`, is imported here. Raises InvalidDescription."""
    if integrator is not None and (not isinstance(chosen, str) or ros.get("attach") is not None):
        raise InvalidDescription(f"integrator={integrator!r}: the simulator has one already; start it with this one")
    scene = scene.integrated_by(integrator)
    if chosen == ROS:
        from ..ros_backend import RosBackend

        return RosBackend(scene, **ros)
    if ros:
        raise InvalidDescription(f'{", ".join(sorted(ros))}: these are options of the backend "ros" only')
    if not isinstance(chosen, str):
        return chosen
    from ..in_process import InProcessBackend

    return InProcessBackend(scene)


def is_shaped(reward: str) -> bool:
    """Whether nearness has a reward, too. Raises InvalidDescription."""
    if reward not in ("sparse", "shaped"):
        raise InvalidDescription(f'reward={reward!r}: expected "sparse" or "shaped"')
    return reward == "shaped"


class GoalForm(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A body is to be at the goal that the task draws, a position: observations are dicts with `observation`, `achieved_goal` and
    `desired_goal`, as hindsight experience replay needs them (Andrychowicz et al. 2017).
    """

    def __init__(self, env: SimulatorEnv, body: str, near: float) -> None:
        """`near`: distance that counts as there, m. Raises InvalidDescription where pictures are observed."""
        super().__init__(env)
        self._body, self._near = body, near
        box = env.observation_space
        if not isinstance(box, gymnasium.spaces.Box):
            raise InvalidDescription("the goal form has no pictures")
        goal = gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float64)
        state = gymnasium.spaces.Box(box.low[:-3], box.high[:-3])
        self.observation_space = gymnasium.spaces.Dict(
            {"observation": state, "achieved_goal": goal, "desired_goal": goal}
        )
        self._simulator = env

    def reset(self, *, seed: Optional[int] = None, options: Optional[Dict[str, Any]] = None) -> Tuple[Any, Info]:
        """See `SimulatorEnv.reset`."""
        observation, info = self._simulator.reset(seed=seed, options=options)
        return self._with_goals(observation), info

    def step(self, action: Any) -> Tuple[Any, SupportsFloat, bool, bool, Info]:
        """The reward is that of `compute_reward`; the episode ends when the body is there."""
        observation, _, terminated, truncated, info = self._simulator.step(action)
        goals = self._with_goals(observation)
        reward = float(self.compute_reward(goals["achieved_goal"], goals["desired_goal"], info))
        info["is_success"] = reward == 0.0
        return goals, reward, terminated or info["is_success"], truncated and not info["is_success"], info

    def compute_reward(self, achieved_goal: Array, desired_goal: Array, info: Any) -> Array:
        """0 where the body is at its place, -1 elsewhere; (..., 3) m each."""
        del info
        away = np.linalg.norm(np.asarray(achieved_goal) - np.asarray(desired_goal), axis=-1)
        reward: Array = -(away > self._near).astype(np.float64)
        return reward

    def _with_goals(self, observation: Any) -> Dict[str, Any]:
        states = self._simulator.states
        assert states is not None
        achieved = states.bodies[self._body].position.copy()
        return {
            "observation": observation[:-3],
            "achieved_goal": achieved,
            "desired_goal": observation[-3:].astype(np.float64),
        }
