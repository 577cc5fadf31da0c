"""Tasks for stable-baselines3: many worlds of one `ambf.Batch`."""

from __future__ import annotations

from typing import Any, Dict, List, Optional, Sequence, Tuple, Type

import gymnasium
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv as BaseVecEnv

from .env import Task
from .scene import Scene
from .worlds import Worlds

Observations = NDArray[np.float32]


class VecEnv(BaseVecEnv):  # type: ignore[misc]
    """`num_envs` worlds of a task as a vector environment of stable-baselines3.

    A world whose episode has ended begins the next one at once: its observation is the first of that one, and the last one of the
    episode is `info["terminal_observation"]`; `info["TimeLimit.truncated"]` says whether it was truncated. `seed(s)` seeds world i
    with s + i at the next `reset`. Tasks are those of `Worlds`.
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
        """Loads the worlds, as `Worlds` does. Raises InvalidDescription, ambf.LoadError, ValueError."""
        self.worlds = Worlds(scene, task, num_envs, max_episode_steps=max_episode_steps, integrator=integrator)
        self.render_mode = None
        self._actions: Any = None
        super().__init__(num_envs, self.worlds.observation_space, self.worlds.action_space)

    def reset(self) -> Observations:
        """Begins an episode in every world."""
        observations = self.worlds.reset(seeds=self._seeds)
        self.reset_infos: List[Dict[str, Any]] = [{} for _ in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: Any) -> None:
        """Takes the actions of the next `step_wait`."""
        self._actions = actions

    def step_wait(self) -> Tuple[Observations, NDArray[np.float32], NDArray[np.bool_], List[Dict[str, Any]]]:
        """Steps all worlds."""
        observations, rewards, terminated, truncated, told = self.worlds.step(self._actions)
        done, infos = terminated | truncated, list(told)
        for i in np.flatnonzero(done):
            infos[i]["terminal_observation"] = observations[i].copy()
        for info, is_truncated in zip(infos, truncated):
            info["TimeLimit.truncated"] = bool(is_truncated)
        if done.any():
            observations = self.worlds.reset(done)
        return observations, rewards.astype(np.float32), done, infos

    def close(self) -> None:
        """Frees the worlds."""
        self.worlds.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> List[Any]:
        """An attribute of this object, once a world."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Sets an attribute of this object, which all worlds have in common."""
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise ValueError("the worlds of a batch have their attributes in common: set them for all")
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *arguments: Any, indices: Any = None, **options: Any) -> List[Any]:
        """Not possible: no world has an object of its own. Raises AttributeError."""
        raise AttributeError(f"{method_name}: the worlds of a batch are no objects; see VecEnv.worlds")

    def env_is_wrapped(
        self, wrapper_class: Type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: Any = None
    ) -> List[bool]:
        """No world is."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[Optional[NDArray[np.uint8]]]:
        """None: a batch draws no pictures."""
        return [None] * self.num_envs
