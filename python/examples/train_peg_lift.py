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
RECENT = 200
FIRST_SEED = 10_000
FIRST_DEMONSTRATION = 20_000
MARKS = ("<!-- peg lift: begin -->\n", "<!-- peg lift: end -->\n")
COLUMNS = ("steps", "seconds", "exploring", "success", "return", "length")


class Curve(BaseCallback):
    """Counts successes in each roll-out, evaluates the policy between some of them, and writes what is known."""

    def __init__(self, chosen: argparse.Namespace, env: VecNormalize) -> None:
        super().__init__()
        self._chosen, self._env = chosen, env
        self._tests = VecEnv(peg_lift.SCENE, peg_lift.TASK, EPISODES)
        self._begin = time.monotonic()
        self._evaluating = 0.0
        self.rows: list[tuple[Any, ...]] = []
        self._recent: list[bool] = []
        self._returns: list[float] = []
        self._next = 0

    def _on_step(self) -> bool:
        for done, info in zip(self.locals["dones"], self.locals["infos"]):
            if done:
                self._recent.append(bool(info["is_success"]))
                self._returns.append(float(info["episode"]["r"]))
        return self._chosen.seconds is None or self._spent() < self._chosen.seconds

    def _on_rollout_start(self) -> None:
        self.look(self.num_timesteps >= self._next)

    def _spent(self) -> float:
        """Time of the training alone, s."""
        return time.monotonic() - self._begin - self._evaluating

    def look(self, evaluates: bool) -> None:
        """Adds a row, and writes where it evaluates."""
        spent, begin = self._spent(), time.monotonic()
        exploring = round(float(np.mean(self._recent[-RECENT:])), 3) if self._recent else 0.0
        found: tuple[Any, ...] = ("", "", "")
        if evaluates:
            self._next = self.num_timesteps + self._chosen.every
            found = self._evaluate(self._tests)
        self.rows.append((self.num_timesteps, round(spent, 1), exploring, *found))
        print(
            dict(zip(COLUMNS, self.rows[-1])), "exploring return", np.mean(self._returns[-RECENT:] or [0]), flush=True
        )
        if evaluates:
            self._write()
            if self._chosen.model is not None:
                self.model.save(self._chosen.model)
                self._env.save(f"{self._chosen.model}.normalised")
        self._evaluating += time.monotonic() - begin

    def finish(self) -> None:
        """Evaluates what was learnt, with `--fine` also with the sub-steps of the peg transfer."""
        self.look(True)
        if not self._chosen.fine:
            return
        tests = VecEnv(peg_lift.FINE, peg_lift.TASK, EPISODES)
        self._fine = self._evaluate(tests)
        tests.close()
        print("with sub-steps of 1 ms:", self._fine, flush=True)
        self._write()

    _fine: tuple[float, float, float] | None = None

    def _evaluate(self, tests: VecEnv) -> tuple[float, float, float]:
        """Share of successes, mean return and mean length of the first episode of each world, the same ones each time."""
        tests.seed(FIRST_SEED)
        observations = tests.reset()
        returns, lengths = np.zeros(EPISODES), np.zeros(EPISODES)
        running, success = np.ones(EPISODES, bool), np.zeros(EPISODES, bool)
        while running.any():
            actions, _ = self.model.predict(self._env.normalize_obs(observations), deterministic=True)
            observations, rewards, done, infos = tests.step(actions)
            returns[running] += rewards[running]
            lengths[running] += 1
            for world in np.flatnonzero(running & done):
                success[world] = infos[world]["is_success"]
            running &= ~done
        return float(success.mean()), round(float(returns.mean()), 3), round(float(lengths.mean()), 1)

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

    def _evaluated(self) -> list[tuple[Any, ...]]:
        return [row for row in self.rows if row[3] != ""]

    def _plot(self, file: Path) -> None:
        _, axes = pyplot.subplots(figsize=(7.0, 3.6))
        steps, _, exploring, *_ = zip(*self.rows)
        axes.plot(steps, exploring, color="#9ab", label=f"last {RECENT} episodes of the training, exploring")
        steps, _, _, success, *_ = zip(*self._evaluated())
        label = f"{EPISODES} episodes of other seeds, without exploring"
        axes.plot(steps, success, ".-", color="#d1495b", label=label)
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
        steps, rate = f"{last[0]:,.0f}".replace(",", " "), last[0] / max(last[1], 1e-9)
        lines = [
            f"Machine: {processor()}, {len(os.sched_getaffinity(0))} cores, one thread of PyTorch, Linux "
            f"{platform.release()}; Python {platform.python_version()}, stable-baselines3 "
            f"{stable_baselines3.__version__}, PyTorch {torch.__version__}. Load average at the end: "
            f"{os.getloadavg()[0]:.1f}. Seed {chosen.seed}, {chosen.worlds} worlds, "
            f"{chosen.demonstrations} demonstrations. Training alone: {last[1]:.0f} s for "
            f"{steps} steps, {rate:.0f} a second, the learner's work included.",
            "",
            f"| steps | training, s | successes of {EPISODES} | exploring, of the last {RECENT} | mean return | mean length, steps |",
            "|--:|--:|--:|--:|--:|--:|",
        ]
        for row in self._evaluated():
            count, seconds, exploring, success, mean, length = row
            lines.append(f"| {count} | {seconds:.0f} | {success:.0%} | {exploring:.0%} | {mean:.2f} | {length:.0f} |")
        if self._fine is not None:
            success, mean, length = self._fine
            lines += [
                "",
                f"The last policy in the scene with sub-steps of 1 ms: successes {success:.0%}, mean return {mean:.2f}, mean "
                f"length {length:.0f} steps.",
            ]
        return "\n".join(lines) + "\n"


def processor() -> str:
    """Name of the processor."""
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.machine()


def demonstrated(worlds: int) -> tuple[Any, Any]:
    """Observations and actions of the scripted solution, of an episode in each of so many worlds, as long as they last."""
    tests = VecEnv(peg_lift.SCENE, peg_lift.TASK, worlds)
    tests.seed(FIRST_DEMONSTRATION)
    observations = tests.reset()
    players = [peg_lift.Player() for _ in range(worlds)]
    running = np.ones(worlds, bool)
    seen, done_so = [], []
    while running.any():
        states = tests.worlds.states
        # Those that have ended begin again, and are not looked at.
        actions = np.stack([player.action(states[i]) for i, player in enumerate(players)])
        seen.append(observations[running])
        done_so.append(actions[running])
        observations, _, done, _ = tests.step(actions)
        running &= ~done
    tests.close()
    return np.concatenate(seen), np.concatenate(done_so)


def imitate(model: PPO, env: VecNormalize, worlds: int, epochs: int = 60) -> None:
    """Fits the policy's mean to demonstrations (behaviour cloning), by mean squared error."""
    seen, actions = demonstrated(worlds)
    env.obs_rms.update(seen)
    inputs = torch.as_tensor(env.normalize_obs(seen), dtype=torch.float32)
    wanted = torch.as_tensor(actions, dtype=torch.float32)
    optimiser = torch.optim.Adam(model.policy.parameters(), lr=1e-3)
    for _ in range(epochs):
        loss = torch.zeros(())
        for chosen in torch.randperm(len(inputs)).split(256):
            loss = ((model.policy.get_distribution(inputs[chosen]).distribution.mean - wanted[chosen]) ** 2).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    print(f"{len(inputs)} steps of demonstrations, mean squared error {loss.item():.4f}", flush=True)


def learner(env: Any, seed: int) -> PPO:
    """PPO with roll-outs of 64 steps in each world."""
    return PPO(
        "MlpPolicy",
        env,
        n_steps=64,
        batch_size=256,
        n_epochs=10,
        gamma=0.98,
        gae_lambda=0.95,
        target_kl=0.03,
        learning_rate=1e-4,
        policy_kwargs={"log_std_init": -2.0, "net_arch": [128, 128]},
        seed=seed,
        device="cpu",
    )


def main() -> None:
    """Trains and records."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="with learning.md, which has the markers of the table")
    parser.add_argument("--steps", type=int, default=2_000_000, help="of the environment, all worlds together")
    parser.add_argument("--seconds", type=float, help="the training ends after this time, too")
    parser.add_argument("--every", type=int, default=100_000, help="steps between evaluations")
    parser.add_argument("--worlds", type=int, default=32)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--model", type=Path, help="file into which the policy is saved after each evaluation")
    parser.add_argument("--demonstrations", type=int, default=64, help="of the scripted solution, before PPO; 0: none")
    parser.add_argument("--fine", action="store_true", help="evaluate what was learnt with sub-steps of 1 ms, too")
    chosen = parser.parse_args()
    torch.set_num_threads(1)

    env = VecNormalize(VecMonitor(VecEnv(peg_lift.SCENE, peg_lift.TASK, chosen.worlds)), norm_reward=False)
    curve = Curve(chosen, env)
    model = learner(env, chosen.seed)
    if chosen.demonstrations:
        imitate(model, env, chosen.demonstrations)
    model.learn(chosen.steps, callback=curve)
    curve.finish()
    env.close()


if __name__ == "__main__":
    main()
