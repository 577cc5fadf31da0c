"""Trains the reach task with PPO of stable-baselines3, and records how the return grows: train_reach.py FOLDER [--steps N] [--seed N].

Writes FOLDER/reach.csv (return of each episode), FOLDER/reach.svg (curve) and FOLDER/reach.json (before and after). `scripts/train-reach`
runs it in a virtual environment that has what it needs.
"""

from __future__ import annotations

import argparse
import csv
import json
import platform
import time
from pathlib import Path

import ambf_gym  # noqa: F401  registers the task
import gymnasium
import matplotlib
import numpy as np
import stable_baselines3
import torch
from gymnasium.wrappers import RescaleAction
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor

matplotlib.use("Agg")
from matplotlib import pyplot

EPISODES = 20


def evaluate(model: PPO, env: gymnasium.Env) -> dict[str, float]:
    """Mean return, share of successes and last distance over the same episodes each time."""
    returns, successes, distances = [], [], []
    for episode in range(EPISODES):
        observation, _ = env.reset(seed=10_000 + episode)
        total, done, info = 0.0, False, {}
        while not done:
            action, _ = model.predict(observation, deterministic=True)
            observation, reward, terminated, truncated, info = env.step(action)
            total += float(reward)
            done = terminated or truncated
        returns.append(total)
        successes.append(info["is_success"])
        distances.append(info["distance"])
    return {
        "return": float(np.mean(returns)),
        "success": float(np.mean(successes)),
        "distance_m": float(np.mean(distances)),
    }


def plot(returns: list[float], steps: list[int], before: float, after: float, file: Path) -> None:
    """Return of each episode, and the mean of the last fifty."""
    window = min(50, len(returns))
    mean = np.convolve(returns, np.ones(window) / window, mode="valid")
    _, axes = pyplot.subplots(figsize=(7.0, 3.6))
    axes.plot(steps, returns, ".", markersize=1.5, color="#9ab", rasterized=True, label="episode, while exploring")
    axes.plot(steps[window - 1 :], mean, color="#d1495b", label=f"mean of {window} episodes")
    axes.axhline(before, color="#666", linestyle=":", label=f"policy before: {before:.1f}")
    axes.axhline(after, color="#666", linestyle="--", label=f"policy after: {after:.1f}")
    axes.set_xlabel("steps of the environment")
    axes.set_ylabel("return")
    axes.legend(loc="lower right", fontsize=8)
    axes.grid(alpha=0.3)
    pyplot.tight_layout()
    pyplot.savefig(file, dpi=120)


def main() -> None:
    """Trains and records."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)

    env = Monitor(RescaleAction(gymnasium.make("ambf/Reach-v0"), -1.0, 1.0))
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=2000,
        batch_size=250,
        n_epochs=8,
        gamma=0.97,
        learning_rate=5e-4,
        policy_kwargs={"log_std_init": -0.7},
        seed=chosen.seed,
        device="cpu",
    )
    before = evaluate(model, env)
    print("before", before, flush=True)
    first = len(env.get_episode_rewards())
    begin = time.monotonic()
    model.learn(chosen.steps)
    wall_s = time.monotonic() - begin
    returns, lengths = env.get_episode_rewards()[first:], env.get_episode_lengths()[first:]
    after = evaluate(model, env)
    print("after", after, flush=True)
    env.close()

    steps = np.cumsum(lengths).tolist()
    with open(chosen.folder / "reach.csv", "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("steps", "return"))
        writer.writerows((step, f"{value:.3f}") for step, value in zip(steps, returns))
    plot(returns, steps, before["return"], after["return"], chosen.folder / "reach.svg")
    summary = {
        "before": before,
        "after": after,
        "steps": chosen.steps,
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
