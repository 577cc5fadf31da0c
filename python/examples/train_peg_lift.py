"""Trains the first stage of the peg transfer with PPO of stable-baselines3 and records how often it succeeds: train_peg_lift.py FOLDER.

Worlds are those of `ambf_gym.sb3.VecEnv`, in this process. Writes FOLDER/peg_lift.csv (the curve), FOLDER/peg_lift.svg and, between its
markers, the table of FOLDER/learning.md; all of them anew after each evaluation, so that a training that is stopped leaves what it has
reached. `scripts/train peg_lift` runs it in a virtual environment that has what it needs.
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import time
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import stable_baselines3
import torch
from ambf_gym.sb3 import VecEnv
from ambf_gym.tasks import peg_lift
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

matplotlib.use("Agg")
from matplotlib import pyplot

EPISODES = 100
FIRST_SEED = 10_000
MARKS = ("<!-- peg lift: begin -->\n", "<!-- peg lift: end -->\n")
COLUMNS = ("steps", "seconds", "success", "exploring", "return", "length")


class Curve(BaseCallback):
    """Evaluates the policy between roll-outs, and writes what is known."""

    def __init__(self, chosen: argparse.Namespace, env: VecNormalize) -> None:
        super().__init__()
        self._chosen, self._env = chosen, env
        self._tests = VecEnv(peg_lift.SCENE, peg_lift.TASK, EPISODES)
        self._begin = time.monotonic()
        self._evaluating = 0.0
        self.rows: list[tuple[float, ...]] = []
        self._recent: list[bool] = []

    def _on_step(self) -> bool:
        for done, info in zip(self.locals["dones"], self.locals["infos"]):
            if done:
                self._recent.append(bool(info["is_success"]))
        return self._chosen.seconds is None or self._spent() < self._chosen.seconds

    def _on_rollout_start(self) -> None:
        if self.num_timesteps >= len(self.rows) * self._chosen.every:
            self.look()

    def _spent(self) -> float:
        """Time of the training alone, s."""
        return time.monotonic() - self._begin - self._evaluating

    def look(self) -> None:
        """Evaluates, and writes."""
        spent, begin = self._spent(), time.monotonic()
        success, mean, length = self._evaluate()
        recent = self._recent[-500:]
        exploring = float(np.mean(recent)) if recent else 0.0
        self.rows.append((self.num_timesteps, round(spent, 1), success, round(exploring, 3), round(mean, 3), length))
        print(dict(zip(COLUMNS, self.rows[-1])), flush=True)
        self._write()
        if self._chosen.model is not None:
            self.model.save(self._chosen.model)
            self._env.save(f"{self._chosen.model}.normalised")
        self._evaluating += time.monotonic() - begin

    def _evaluate(self) -> tuple[float, float, float]:
        """Share of successes, mean return and mean length of the first episode of each world, the same ones each time."""
        self._tests.seed(FIRST_SEED)
        observations = self._tests.reset()
        returns, lengths = np.zeros(EPISODES), np.zeros(EPISODES)
        running, success = np.ones(EPISODES, bool), np.zeros(EPISODES, bool)
        while running.any():
            actions, _ = self.model.predict(self._env.normalize_obs(observations), deterministic=True)
            observations, rewards, done, infos = self._tests.step(actions)
            returns[running] += rewards[running]
            lengths[running] += 1
            for world in np.flatnonzero(running & done):
                success[world] = infos[world]["is_success"]
            running &= ~done
        return float(success.mean()), float(returns.mean()), round(float(lengths.mean()), 1)

    def _write(self) -> None:
        folder = self._chosen.folder
        with open(folder / "peg_lift.csv", "w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(COLUMNS)
            writer.writerows(self.rows)
        self._plot(folder / "peg_lift.svg")
        page = folder / "learning.md"
        before, _, rest = page.read_text().partition(MARKS[0])
        page.write_text(before + MARKS[0] + self._table() + MARKS[1] + rest.partition(MARKS[1])[2])

    def _plot(self, file: Path) -> None:
        steps, _, success, exploring, *_ = zip(*self.rows)
        _, axes = pyplot.subplots(figsize=(7.0, 3.6))
        axes.plot(steps, exploring, color="#9ab", label="last 500 episodes of the training, exploring")
        axes.plot(steps, success, ".-", color="#d1495b", label=f"{EPISODES} episodes of other seeds, without exploring")
        axes.set_xlabel("steps of the environment")
        axes.set_ylabel("share of successes")
        axes.set_ylim(-0.02, 1.02)
        axes.legend(loc="best", fontsize=8)
        axes.grid(alpha=0.3)
        pyplot.tight_layout()
        pyplot.savefig(file)
        pyplot.close()

    def _table(self) -> str:
        chosen, last = self._chosen, self.rows[-1]
        best = max(range(len(self.rows)), key=lambda i: self.rows[i][2])
        shown = sorted({0, best, *np.linspace(0, len(self.rows) - 1, min(len(self.rows), 10)).astype(int).tolist()})
        steps, rate = f"{last[0]:,.0f}".replace(",", " "), last[0] / max(last[1], 1e-9)
        lines = [
            f"Machine: {processor()}, {len(os.sched_getaffinity(0))} cores, one thread of PyTorch, Linux "
            f"{platform.release()}; Python {platform.python_version()}, stable-baselines3 "
            f"{stable_baselines3.__version__}, PyTorch {torch.__version__}. Load average at the end: "
            f"{os.getloadavg()[0]:.1f}. Seed {chosen.seed}, {chosen.worlds} worlds. Training alone: {last[1]:.0f} s for "
            f"{steps} steps, {rate:.0f} a second, the learner's work included.",
            "",
            f"| steps | training, s | successes of {EPISODES} | exploring, of the last 500 | mean return | mean length, steps |",
            "|--:|--:|--:|--:|--:|--:|",
        ]
        for i in shown:
            steps, seconds, success, exploring, mean, length = self.rows[i]
            lines.append(
                f"| {steps:.0f} | {seconds:.0f} | {success:.0%} | {exploring:.0%} | {mean:.2f} | {length:.0f} |"
            )
        return "\n".join(lines) + "\n"


def processor() -> str:
    """Name of the processor."""
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.machine()


def learner(env: Any, seed: int) -> PPO:
    """PPO with roll-outs of 128 steps in each world."""
    return PPO(
        "MlpPolicy",
        env,
        n_steps=128,
        batch_size=512,
        n_epochs=8,
        gamma=0.98,
        gae_lambda=0.95,
        learning_rate=3e-4,
        policy_kwargs={"log_std_init": -0.7, "net_arch": [128, 128]},
        seed=seed,
        device="cpu",
    )


def main() -> None:
    """Trains and records."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="with learning.md, which has the markers of the table")
    parser.add_argument("--steps", type=int, default=2_000_000, help="of the environment, all worlds together")
    parser.add_argument("--seconds", type=float, help="the training ends after this time, too")
    parser.add_argument("--every", type=int, default=50_000, help="steps between evaluations")
    parser.add_argument("--worlds", type=int, default=32)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--model", type=Path, help="file into which the policy is saved after each evaluation")
    chosen = parser.parse_args()
    torch.set_num_threads(1)

    env = VecNormalize(VecMonitor(VecEnv(peg_lift.SCENE, peg_lift.TASK, chosen.worlds)), norm_reward=False)
    curve = Curve(chosen, env)
    learner(env, chosen.seed).learn(chosen.steps, callback=curve)
    curve.look()
    env.close()


if __name__ == "__main__":
    main()
