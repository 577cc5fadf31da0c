"""Tasks of several arms as environments of PettingZoo (https://pettingzoo.farama.org): an agent an arm. Needs the package `pettingzoo`."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import gymnasium
import numpy as np
from pettingzoo import ParallelEnv

from .env import SimulatorEnv
from .errors import InvalidDescription

Parts = Mapping[str, Sequence[str]]


class Arms(ParallelEnv):  # type: ignore[misc]  # PettingZoo has no types
    """An environment whose actions are divided among agents, who all act at once, see the same and share one reward.

    `state` is what all see. An episode ends for all at once.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], agents: Parts) -> None:
        """`agents`: for each the names, or unique parts of them, of the bodies and actuators that it commands, such as
        `{"left": ("psm1/",), "right": ("psm2/",)}`. Each part of the action belongs to one agent.

        Raises InvalidDescription where a part of the action belongs to none or to several, or an agent has none.
        """
        inner = env.unwrapped
        if not isinstance(inner, SimulatorEnv):
            raise InvalidDescription(f"{env}: expected an environment of ambf_gym")
        self.env = env
        self._slices: Dict[str, List[slice]] = {agent: [] for agent in agents}
        for name, piece in inner.action_parts():
            owners = [agent for agent, names in agents.items() if any(part in name for part in names)]
            if len(owners) != 1:
                raise InvalidDescription(
                    f"the action on {name} belongs to {owners or 'no agent'}; expected one of {list(agents)}"
                )
            self._slices[owners[0]].append(piece)
        idle = [agent for agent, slices in self._slices.items() if not slices]
        if idle:
            raise InvalidDescription(
                f"{', '.join(idle)}: commands nothing of {[name for name, _ in inner.action_parts()]}"
            )
        space = env.action_space
        assert isinstance(space, gymnasium.spaces.Box)
        self.possible_agents = list(agents)
        self.agents: List[str] = []
        self.render_mode = env.render_mode
        self.metadata = {
            **env.metadata,
            "name": str(env.spec.id if env.spec else type(inner).__name__),
            "is_parallelizable": True,
        }
        self._observation: Any = None
        self.observation_spaces = {agent: env.observation_space for agent in agents}
        self.action_spaces = {
            agent: gymnasium.spaces.Box(
                np.concatenate([space.low[piece] for piece in slices]),
                np.concatenate([space.high[piece] for piece in slices]),
                dtype=np.float32,
            )
            for agent, slices in self._slices.items()
        }
        self.state_space = env.observation_space

    def observation_space(self, agent: str) -> gymnasium.spaces.Space[Any]:
        """That of the environment."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gymnasium.spaces.Space[Any]:
        """The parts of the action that the agent commands, one after the other."""
        return self.action_spaces[agent]

    def reset(
        self, seed: Optional[int] = None, options: Optional[Dict[str, Any]] = None
    ) -> Tuple[Dict[str, Any], Dict[str, Dict[str, Any]]]:
        """A new episode. There are no options; those of others are not looked at, since PettingZoo's own check gives some."""
        del options
        self._observation, info = self.env.reset(seed=seed)
        self.agents = list(self.possible_agents)
        return self._for_all(self._observation), {agent: dict(info) for agent in self.agents}

    def step(
        self, actions: Mapping[str, Any]
    ) -> Tuple[Dict[str, Any], Dict[str, float], Dict[str, bool], Dict[str, bool], Dict[str, Dict[str, Any]]]:
        """All act. Raises InvalidDescription if the action of one is missing, or of another shape; and what the environment raises."""
        if not self.agents:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        space = self.env.action_space
        whole = np.zeros(space.shape or (0,), dtype=np.float32)
        for agent in self.agents:
            given, expected = np.asarray(actions.get(agent)), self.action_spaces[agent].shape
            if agent not in actions or given.shape != expected:
                raise InvalidDescription(f"{agent}: an action of the shape {given.shape}; expected {expected}")
            start = 0
            for piece in self._slices[agent]:
                size = piece.stop - piece.start
                whole[piece] = given[start : start + size]
                start += size
        self._observation, reward, terminated, truncated, info = self.env.step(whole)
        all_of = self.agents
        if terminated or truncated:
            self.agents = []
        return (
            {agent: self._observation for agent in all_of},
            {agent: float(reward) for agent in all_of},
            {agent: terminated for agent in all_of},
            {agent: truncated for agent in all_of},
            {agent: dict(info) for agent in all_of},
        )

    def state(self) -> Any:
        """The last observation."""
        return self._observation

    def render(self) -> Any:
        """See `SimulatorEnv.render`."""
        return self.env.render()

    def close(self) -> None:
        """Closes the environment."""
        self.env.close()

    def _for_all(self, value: Any) -> Dict[str, Any]:
        return {agent: value for agent in self.agents}
