"""Episodes as a data set of Minari (https://minari.farama.org), for imitation and offline learning. Needs the package `minari`."""

from __future__ import annotations

from typing import Any, Callable, Dict, List, Optional

import gymnasium
import numpy as np

from .errors import InvalidDescription

Policy = Callable[[Any], Any]
"""An action for an observation."""


def collect(
    env: gymnasium.Env[Any, Any],
    policy: Callable[[], Policy],
    episodes: int,
    dataset_id: str,
    *,
    seed: int = 0,
    only_successes: bool = False,
    **about: Any,
) -> Any:
    """Plays episodes and writes them as the data set `dataset_id`, such as `needle/scripted-v0`; returns it.

    `policy()` makes the policy of an episode; it is called with observations, or, if the policy looks at more, may keep `env` and look at
    `env.unwrapped.states`. Episode i has the seed `seed` + i. `only_successes`: episodes without `is_success` in their last info are left
    out. `about`: further arguments of `minari.create_dataset_from_buffers`, such as `algorithm_name` and `author`.

    Data sets lie in `$MINARI_DATASETS_PATH`, else in `~/.minari/datasets`. Raises InvalidDescription if no episode is left, ValueError
    for a number of episodes below 1, and what Minari raises where the data set is there already.
    """
    import minari
    from minari.data_collector import EpisodeBuffer

    if episodes < 1:
        raise ValueError(f"episodes={episodes}: expected 1 or more")
    kept: List[Any] = []
    for episode in range(episodes):
        played = _play(env, policy(), seed + episode)
        is_success = played.pop("is_success")
        if is_success or not only_successes:
            kept.append(EpisodeBuffer(id=len(kept), seed=seed + episode, **played))
    if not kept:
        raise InvalidDescription(f"none of {episodes} episodes was a success: there is nothing to write")
    return minari.create_dataset_from_buffers(dataset_id, kept, env, **about)


def _play(env: gymnasium.Env[Any, Any], policy: Policy, seed: int) -> Dict[str, Any]:
    """An episode, one list for each of its quantities; dicts of observations are dicts of lists."""
    observation, _ = env.reset(seed=seed)
    observations, actions = [observation], []
    rewards: List[float] = []
    terminations: List[bool] = []
    truncations: List[bool] = []
    last: Optional[Dict[str, Any]] = None
    while not (terminations and (terminations[-1] or truncations[-1])):
        action = np.asarray(policy(observation), dtype=env.action_space.dtype)
        observation, reward, terminated, truncated, last = env.step(action)
        observations.append(observation)
        actions.append(action)
        rewards.append(float(reward))
        terminations.append(terminated)
        truncations.append(truncated)
    return {
        "observations": _columns(observations),
        "actions": actions,
        "rewards": rewards,
        "terminations": terminations,
        "truncations": truncations,
        "is_success": bool((last or {}).get("is_success")),
    }


def _columns(rows: List[Any]) -> Any:
    if isinstance(rows[0], dict):
        return {key: _columns([row[key] for row in rows]) for key in rows[0]}
    return rows
