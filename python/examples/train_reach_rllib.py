"""Trains the reach task with PPO of Ray RLlib, on one machine or many: train_reach_rllib.py [--steps N] [--runners N] [--address A].

The environments run in actors of Ray, the runners, in the runner's process or over ROS in a simulator of the runner's own. Without
--address a local Ray is started and ended with this program. `scripts/train-rllib` runs it in a virtual environment that has what it needs.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import socket
import time
from pathlib import Path
from typing import Any

import gymnasium
import ray
import torch
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig

# The part before the colon is imported by each runner: it registers the task.
TASK = "ambf_gym:ambf/Reach-v0"
BATCH = 2000
EPISODES = 40


def open_now(*, env: Any, **_: Any) -> None:
    """Starts the simulator at once: one that can't be started is then an error of the runner, and nothing that RLlib retries for ever."""
    env.reset()


def count_steps(*, metrics_logger: Any, samples: list, **_: Any) -> None:
    """Which process made how many steps of the environment; RLlib calls it in the runner after each of its samples."""
    runner = f"{socket.gethostname()}:{os.getpid()}"
    metrics_logger.log_value(("runners", runner), sum(map(len, samples)), reduce="sum")


def note_success(*, episode: Any, metrics_logger: Any, **_: Any) -> None:
    """Whether the flange was at the goal at the end of an episode, and how far away; RLlib calls it in the runner."""
    last = episode.get_infos(-1)
    metrics_logger.log_value("success", float(last["is_success"]), window=EPISODES)
    metrics_logger.log_value("distance_m", last["distance"], window=EPISODES)


def configure(runners: int, envs: int, backend: str, seed: int) -> PPOConfig:
    """`runners`: actors that step environments; `envs`: environments in each of them; `backend`: how they reach the simulator."""
    # In the process, all worlds of a runner are one environment, which steps them at once on threads.
    vectorized = gymnasium.VectorizeMode.VECTOR_ENTRY_POINT if backend == "in-process" else gymnasium.VectorizeMode.SYNC
    return (
        PPOConfig()
        .environment(TASK)
        .env_runners(num_env_runners=runners, num_envs_per_env_runner=envs, gym_env_vectorize_mode=vectorized)
        .callbacks(on_environment_created=open_now, on_sample_end=count_steps, on_episode_end=note_success)
        # A simulator that ended is started anew by its runner; a runner that ended, or whose machine did, by Ray.
        .fault_tolerance(restart_failed_sub_environments=True, restart_failed_env_runners=True)
        .training(
            train_batch_size_per_learner=BATCH,
            minibatch_size=250,
            num_epochs=8,
            gamma=0.97,
            lambda_=0.95,
            lr=5e-4,
            clip_param=0.2,
            use_kl_loss=False,
            vf_clip_param=float("inf"),
            vf_loss_coeff=0.5,
            grad_clip=0.5,
        )
        .rl_module(
            model_config=DefaultModelConfig(fcnet_hiddens=[64, 64], vf_share_layers=False, free_log_std=True),
        )
        .reporting(metrics_num_episodes_for_smoothing=EPISODES)
        .debugging(seed=seed)
    )


def train(algorithm: Any, steps: int) -> list[dict[str, Any]]:
    """Trains until `steps` steps of the environment are sampled; numbers of each iteration."""
    iterations: list[dict[str, Any]] = []
    begin = time.monotonic()
    while not iterations or iterations[-1]["steps"] < steps:
        found = algorithm.train().get("env_runners", {})
        if "runners" not in found:
            raise SystemExit("no runner has delivered anything; their errors are above")
        iterations.append(
            {
                "steps": int(found["num_env_steps_sampled_lifetime"]),
                "wall_s": round(time.monotonic() - begin, 2),
                "return": round(float(found["episode_return_mean"]), 3),
                "success": round(float(found["success"]), 3),
                "distance_m": round(float(found["distance_m"]), 4),
                "runners": {name: int(count) for name, count in found["runners"].items() if count > 0},
            }
        )
        print(json.dumps(iterations[-1]), flush=True)
    return iterations


def main() -> None:
    """Trains and records."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=100_000, help="of the environment, over all runners")
    parser.add_argument("--runners", type=int, default=2)
    parser.add_argument("--envs", type=int, default=1, help="environments in each runner")
    parser.add_argument("--backend", choices=("in-process", "ros"), default="in-process")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--address", help="of a cluster that runs, such as `auto` or HOST:6379")
    parser.add_argument("--record", type=Path, metavar="FILE", help="writes numbers there, as JSON")
    chosen = parser.parse_args()
    torch.set_num_threads(1)

    if chosen.address:
        ray.init(address=chosen.address)
    else:
        # A runner asks for a whole core; on a smaller machine they share.
        ray.init(num_cpus=max(os.cpu_count() or 1, chosen.runners), include_dashboard=False)
    try:
        try:
            algorithm = configure(chosen.runners, chosen.envs, chosen.backend, chosen.seed).build_algo()
        except IndexError as error:  # RLlib's, when it asks the runners for the spaces
            raise RuntimeError("no runner could be started; their errors are above") from error
        try:
            iterations = train(algorithm, chosen.steps)
        finally:
            algorithm.stop()
    finally:
        ray.shutdown()

    result = {
        "steps_per_s": round(iterations[-1]["steps"] / iterations[-1]["wall_s"], 1),
        "runners": chosen.runners,
        "envs": chosen.envs,
        "backend": chosen.backend,
        "seed": chosen.seed,
        "ray": ray.__version__,
        "torch": torch.__version__,
        "python": platform.python_version(),
        "iterations": iterations,
    }
    print(json.dumps({name: value for name, value in result.items() if name != "iterations"}))
    if chosen.record:
        chosen.record.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
