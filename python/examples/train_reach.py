"""Trains the reach task with SAC or PPO of stable-baselines3 and records how the return grows: train_reach.py FOLDER [options].

Worlds are those of `ambf_gym.sb3.VecEnv`, in this process. Writes FOLDER/reach.csv (return of each episode), FOLDER/reach.svg (curve) and
FOLDER/reach.json (before and after). `scripts/train reach` runs it in a virtual environment that has what it needs.
"""

from __future__ import annotations

import argparse
import csv
import json
import platform
import time
from pathlib import Path

import matplotlib
import numpy as np
import stable_baselines3
import torch
from ambf_gym.sb3 import VecEnv
from ambf_gym.tasks import reach
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecMonitor

matplotlib.use("Agg")
from matplotlib import pyplot

EPISODES = 100
FIRST_SEED = 10_000


class Episodes(BaseCallback):
    """Return of each episode, and the environment steps of all worlds at its end."""

    def __init__(self) -> None:
        super().__init__()
        self.returns: list[float] = []
        self.steps: list[int] = []

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "episode" in info:
                self.returns.append(float(info["episode"]["r"]))
                self.steps.append(self.num_timesteps)
        return True


def evaluate(model: BaseAlgorithm) -> dict[str, float]:
    """Mean return, share of successes at the end, and last distance, of the same episodes each time."""
    env = VecEnv(reach.SCENE, reach.TASK, EPISODES)
    env.seed(FIRST_SEED)
    observations = env.reset()
    returns = np.zeros(EPISODES)
    while True:
        actions, _ = model.predict(observations, deterministic=True)
        observations, rewards, done, infos = env.step(actions)
        returns += rewards
        # All begin together and last equally long.
        if done.all():
            break
    env.close()
    return {
        "return": float(returns.mean()),
        "success": float(np.mean([info["is_success"] for info in infos])),
        "distance_m": float(np.mean([info["distance"] for info in infos])),
    }


def plot(episodes: Episodes, before: float, after: float, file: Path) -> None:
    """Return of each episode, and the mean of the last fifty."""
    window = min(50, len(episodes.returns))
    mean = np.convolve(episodes.returns, np.ones(window) / window, mode="valid")
    _, axes = pyplot.subplots(figsize=(7.0, 3.6))
    axes.plot(
        episodes.steps, episodes.returns, ".", markersize=1.5, color="#9ab", rasterized=True, label="episode, exploring"
    )
    axes.plot(episodes.steps[window - 1 :], mean, color="#d1495b", label=f"mean of {window} episodes")
    axes.axhline(before, color="#666", linestyle=":", label=f"policy before: {before:.1f}")
    axes.axhline(after, color="#666", linestyle="--", label=f"policy after: {after:.1f}")
    axes.set_xlabel("steps of the environment")
    axes.set_ylabel("return")
    axes.legend(loc="lower right", fontsize=8)
    axes.grid(alpha=0.3)
    pyplot.tight_layout()
    pyplot.savefig(file, dpi=120)


def learner(name: str, env: VecMonitor, seed: int) -> BaseAlgorithm:
    """SAC: a gradient step for each transition; PPO: batches of 2000 steps."""
    if name == "sac":
        return SAC(
            "MlpPolicy",
            env,
            learning_rate=1e-3,
            learning_starts=1000,
            batch_size=256,
            gamma=0.95,
            train_freq=1,
            gradient_steps=env.num_envs,
            seed=seed,
            device="cpu",
        )
    return PPO(
        "MlpPolicy",
        env,
        n_steps=2000 // env.num_envs,
        batch_size=250,
        n_epochs=8,
        gamma=0.97,
        learning_rate=5e-4,
        policy_kwargs={"log_std_init": -0.7},
        seed=seed,
        device="cpu",
    )


def main() -> None:
    """Trains and records."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--algorithm", choices=("sac", "ppo"), default="sac")
    parser.add_argument("--steps", type=int, default=60_000, help="of the environment, all worlds together")
    parser.add_argument("--worlds", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)

    env = VecMonitor(VecEnv(reach.SCENE, reach.TASK, chosen.worlds))
    model = learner(chosen.algorithm, env, chosen.seed)
    before = evaluate(model)
    print("before", before, flush=True)
    episodes = Episodes()
    begin = time.monotonic()
    model.learn(chosen.steps, callback=episodes)
    wall_s = time.monotonic() - begin
    after = evaluate(model)
    print("after", after, flush=True)
    env.close()

    with open(chosen.folder / "reach.csv", "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("steps", "return"))
        writer.writerows((step, f"{value:.3f}") for step, value in zip(episodes.steps, episodes.returns))
    plot(episodes, before["return"], after["return"], chosen.folder / "reach.svg")
    summary = {
        "algorithm": chosen.algorithm,
        "before": before,
        "after": after,
        "steps": chosen.steps,
        "worlds": chosen.worlds,
        "seed": chosen.seed,
        "wall_s": round(wall_s, 1),
        "stable_baselines3": stable_baselines3.__version__,
        "torch": torch.__version__,
        "python": platform.python_version(),
    }
    (chosen.folder / "reach.json").write_text(json.dumps(summary, indent=1) + "\n")
    if after["return"] <= before["return"]:
        raise SystemExit("the return has not grown")


if __name__ == "__main__":
    main()
