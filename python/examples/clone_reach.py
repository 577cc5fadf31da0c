"""A script's episodes are recorded, exported, learnt from the exported file, and what was learnt is run: clone_reach.py [FOLDER]

1. A script reaches the goals of `ambf/Reach-v0` by the arm's Jacobian; each episode is recorded (`env.unwrapped.record`).
2. The recordings are exported for robomimic, by the mapping `reach`.
3. A network of two layers learns from `data.hdf5` alone which way the set points go (behaviour cloning).
4. Script, network and random actions play the same further episodes; the share of successes of each is printed as JSON.

Needs `ambf`, `ambf_gym`, `gymnasium`, `h5py`, `PyYAML`; NumPy does the learning. Takes some two minutes on two cores.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any, Callable

import ambf_gym  # noqa: F401  registers the task
import gymnasium
import h5py
import numpy as np
from ambf import export
from ambf.mapping import MappingOf
from numpy.typing import NDArray

Array = NDArray[np.float64]
Policy = Callable[[Array], Array]
"""An action for an observation: 7 positions and 7 velocities of joints, 3 of the flange, 3 of the goal."""

FIRST_TEST = 10_000
"""Seed of the first episode that nothing was learnt from."""
GAIN, DAMPING = 0.1, 0.1
"""The script goes this share of the way in each step; damping of its least squares, m/rad (Nakamura and Hanafusa, 1986)."""
INCREMENT = 0.08
"""An action of 1 moves the set point of a joint so far, rad."""


def script(env: Any) -> Policy:
    """Moves the flange straight to the goal."""
    simulation = env.unwrapped._backend.simulation

    def act(observation: Array) -> Array:
        tree = simulation.tree("arm7/flange")
        jacobian = tree.jacobian("arm7/flange")[:3]
        way = GAIN * (observation[17:20] - observation[14:17])
        turn = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + DAMPING**2 * np.eye(3), way)
        return np.clip(turn / INCREMENT, -1.0, 1.0)

    return act


def play(env: Any, policy_of: Callable[[Any], Policy], seed: int, file: Path | None = None) -> dict[str, Any]:
    """An episode; what its last step says of it."""
    if file is not None:
        env.unwrapped.record(file)
    observation, _ = env.reset(seed=seed)
    policy, is_over, info = policy_of(env), False, {}
    while not is_over:
        action = policy(np.asarray(observation, np.float64))
        observation, _, terminated, truncated, info = env.step(action.astype(np.float32))
        is_over = terminated or truncated
    env.unwrapped.stop_recording()
    return info


class Network:
    """Two layers of rectified linear units, trained by Adam (Kingma and Ba, 2015) on mean squared errors."""

    def __init__(self, inputs: Array, outputs: Array, rng: np.random.Generator, width: int = 128, rounds: int = 4000):
        self._mean, self._std = inputs.mean(0), inputs.std(0) + 1e-6
        self._scale = outputs.std(0) + 1e-6
        sizes = [inputs.shape[1], width, width, outputs.shape[1]]
        self._parts = [rng.normal(0.0, np.sqrt(2.0 / a), (a, b)) for a, b in zip(sizes, sizes[1:])]
        self._parts += [np.zeros(b) for b in sizes[1:]]
        x, y = (inputs - self._mean) / self._std, outputs / self._scale
        first, second = ([np.zeros_like(part) for part in self._parts] for _ in range(2))
        for count in range(1, rounds + 1):
            rows = rng.integers(len(x), size=256)
            rate = 2e-3 * (1.0 - count / rounds)
            for i, slope in enumerate(self._slopes(x[rows], y[rows])):
                first[i] += 0.1 * (slope - first[i])
                second[i] += 0.001 * (slope**2 - second[i])
                mean, square = first[i] / (1.0 - 0.9**count), second[i] / (1.0 - 0.999**count)
                self._parts[i] -= rate * mean / (np.sqrt(square) + 1e-8)

    def _layers(self, x: Array) -> list[Array]:
        layers = [x]
        for i in range(3):
            x = x @ self._parts[i] + self._parts[3 + i]
            layers.append(np.maximum(x, 0.0) if i < 2 else x)
            x = layers[-1]
        return layers

    def _slopes(self, x: Array, y: Array) -> list[Array]:
        layers = self._layers(x)
        back = 2.0 * (layers[3] - y) / y.size
        slopes: list[Array] = [np.empty(0)] * 6
        for i in (2, 1, 0):
            slopes[i], slopes[3 + i] = layers[i].T @ back, back.sum(0)
            back = (back @ self._parts[i].T) * (layers[i] > 0.0)
        return slopes

    def __call__(self, inputs: Array) -> Array:
        result: Array = self._layers((inputs - self._mean) / self._std)[3] * self._scale
        return result


def inputs_of(joints: Array, flange: Array, goal: Array) -> Array:
    """What the network sees: joints, and the way to the goal."""
    return np.concatenate([joints, goal - flange, flange], axis=-1)


def learn(file: Path, rng: np.random.Generator) -> Network:
    """From the exported file alone: by how much each step moves the set points."""
    inputs, outputs = [], []
    with h5py.File(file) as read:
        for name in sorted(read["data"]):
            demo = read["data"][name]
            joints, flange, goal = (np.asarray(demo[f"obs/{part}"]) for part in ("state", "flange", "goal"))
            targets = np.asarray(demo["actions"])
            # At first the set points are where the joints are.
            before = np.concatenate([joints[:1], targets[:-1]])
            inputs.append(inputs_of(joints, flange, goal))
            outputs.append(targets - before)
    return Network(np.concatenate(inputs), np.concatenate(outputs), rng)


def clone(network: Network) -> Callable[[Any], Policy]:
    """The network as a policy."""
    return lambda _: lambda o: np.clip(network(inputs_of(o[:7], o[14:17], o[17:20])) / INCREMENT, -1.0, 1.0)


def evaluate(env: Any, policy_of: Callable[[Any], Policy], episodes: int) -> dict[str, float]:
    """Share of successes, and the mean distance at the end, m."""
    ends = [play(env, policy_of, FIRST_TEST + episode) for episode in range(episodes)]
    return {
        "success": float(np.mean([end["is_success"] for end in ends])),
        "distance": round(float(np.mean([end["distance"] for end in ends])), 4),
    }


def main() -> None:
    """All four steps."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "folder", type=Path, nargs="?", help="for recordings and data set; must not be there [a temporary one]"
    )
    parser.add_argument("--episodes", type=int, default=10, help="recorded ones [10]")
    parser.add_argument("--tests", type=int, default=50, help="episodes of each policy in the end [50]")
    parser.add_argument("--seed", type=int, default=1, help="of the network and of random actions [1]")
    chosen = parser.parse_args()
    folder = chosen.folder or Path(tempfile.mkdtemp(prefix="ambf-clone-")) / "reach"
    folder.mkdir(parents=True)
    env = gymnasium.make("ambf/Reach-v0", in_process=True)

    files = [folder / f"{episode}.mcap" for episode in range(chosen.episodes)]
    for seed, file in enumerate(files):
        play(env, script, seed, file)
    export.export([str(file) for file in files], "robomimic", folder / "data", mapping=MappingOf.load("reach"))

    rng = np.random.default_rng(chosen.seed)
    network = learn(folder / "data/data.hdf5", rng)
    policies: dict[str, Callable[[Any], Policy]] = {
        "script": script,
        "clone": clone(network),
        "random": lambda _: lambda _: rng.uniform(-1.0, 1.0, 7),
    }
    result = {name: evaluate(env, policy, chosen.tests) for name, policy in policies.items()}
    env.close()
    print(json.dumps({"recorded": chosen.episodes, "tests": chosen.tests, **result}))


if __name__ == "__main__":
    main()
