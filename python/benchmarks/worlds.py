"""What many worlds cost under one condition; in_process.py starts it.

worlds.py [--cores N] [--busy N] [--worlds N]… [--many N]… [--rounds N] [--all]

* physics steps a second of an arm of seven joints: worlds of ours stepped at once and one after the other, those of pybullet in a process
  each;
* steps a second of a vectorised reach task: ours, and the same task in pybullet and MuJoCo, as Gymnasium's vector environments in one
  process and in a process a world (reach_peers.py).

Ours is measured with its default integrator, rk4, and with euler, which is what pybullet and MuJoCo step with here. Lanes are named with
it.

`--many`: numbers of worlds of which only the task is measured. `--cores`: only so many of the machine are used, by all; `--busy`: as many
endless loops run beside it; `--all`: profile legacy, too. Lanes take turns in short rounds. Prints one object of JSON: percentiles 10, 50
and 90 of the rounds of each lane.
"""

from __future__ import annotations

import argparse
import atexit
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Callable

import ambf
import numpy as np
from ambf_gym import InProcessVectorEnv, Worlds
from ambf_gym.scene import Scene, resources
from ambf_gym.tasks import reach

STEPS = (1, 10)
# The default of ours, and what the others step with.
INTEGRATORS = ("rk4", "euler")
ROUND_S = 0.25
MODEL = "models/hanging_arm.urdf"
HERE = Path(__file__).parent

# A lane does so many calls and says how long they took, s.
Lane = Callable[[int], float]


def arms(profile: str, worlds: int, steps: int, *, integrator: str | None = None, in_turn: bool = False) -> Lane:
    """Calls as pybullet_peer.py describes them, in all worlds at once or in turn; a call counts once a world."""
    sims = [ambf.Simulation(resources() / MODEL, profile=profile, integrator=integrator) for _ in range(worlds)]
    bodies = [sim.body("hanging_arm/base") for sim in sims]
    ends = [sim.body("flange") for sim in sims]
    places = np.arange(len(bodies[0].joints))
    for body in bodies:
        body.joint_kinds[:] = ambf.POSITION
    done = 0

    def run(calls: int) -> float:
        nonlocal done
        begin = time.perf_counter()
        for _ in range(calls):
            done += 1
            for body in bodies:
                body.joint_commands[:] = 0.3 * np.sin(0.01 * done + places)
            if in_turn:
                for sim in sims:
                    sim.step(steps)
            else:
                ambf.step_all(sims, steps)
            for body, end in zip(bodies, ends):
                _ = body.joint_positions, body.joint_velocities, end.pose.copy(), end.twist.copy()
        return time.perf_counter() - begin

    return run


class Peer:
    """A program that answers each line with the seconds that it took."""

    def __init__(self, python: str, name: str, *arguments: object, **environment: str) -> None:
        command = [python, str(HERE / name), *map(str, arguments)]
        self._program = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env={**os.environ, **environment},
        )
        self.first = self.answer()

    def ask(self, *words: int) -> None:
        """Tells it to begin."""
        self._program.stdin.write(" ".join(map(str, words)) + "\n")  # type: ignore[union-attr]
        self._program.stdin.flush()  # type: ignore[union-attr]

    def answer(self) -> float:
        """Waits for it."""
        line = self._program.stdout.readline()  # type: ignore[union-attr]
        if not line:
            raise RuntimeError(f"{self._program.args}: ended")
        return float(line)

    def close(self) -> None:
        """Ends it."""
        self._program.communicate()


def of_peers(peers: list[Peer], *words: int) -> Lane:
    """All of them at once."""

    def run(calls: int) -> float:
        begin = time.perf_counter()
        for peer in peers:
            peer.ask(calls, *words)
        for peer in peers:
            peer.answer()
        return time.perf_counter() - begin

    return run


def same_arm() -> Scene:
    """The scene of the reach task with the arm that the others have, under the names that the task knows."""
    path = Path(tempfile.gettempdir()) / f"arm7-{os.getpid()}.urdf"
    path.write_text((resources() / MODEL).read_text().replace('<robot name="hanging_arm">', '<robot name="arm7">'))
    atexit.register(path.unlink, missing_ok=True)
    return Scene((str(path),), options=reach.SCENE.options)


def environments(worlds: int, integrator: str) -> tuple[Lane, Callable[[], None]]:
    """Steps of the reach task with random actions, resets among them."""
    env = InProcessVectorEnv(same_arm(), reach.TASK, worlds, integrator=integrator)
    env.reset(seed=0)
    env.action_space.seed(0)

    def run(calls: int) -> float:
        actions = [env.action_space.sample() for _ in range(calls)]
        begin = time.perf_counter()
        for action in actions:
            env.step(action)
        return time.perf_counter() - begin

    return run, env.close


def batch(worlds: int, integrator: str) -> tuple[Lane, Callable[[], None]]:
    """The same in one `ambf.Batch`."""
    env = Worlds(same_arm(), reach.TASK, worlds, integrator=integrator)
    env.reset(seeds=range(worlds))
    rng = np.random.default_rng(0)
    low, high = env.action_space.low, env.action_space.high

    def run(calls: int) -> float:
        actions = rng.uniform(low, high, (calls, worlds, len(low)))
        begin = time.perf_counter()
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            ended = terminated | truncated
            if ended.any():
                env.reset(ended)
        return time.perf_counter() - begin

    return run, env.close


def measure(lanes: dict[str, tuple[Lane, int]], rounds: int) -> dict[str, list[float]]:
    """Percentiles 10, 50 and 90 of each lane's rate: calls a second times its factor."""
    calls: dict[str, int] = {}
    found: dict[str, list[float]] = {key: [] for key in lanes}
    for key, (lane, _) in lanes.items():
        # The first calls warm up; those of step_all learn whether threads pay.
        begin = time.perf_counter()
        while time.perf_counter() - begin < ROUND_S:
            took = lane(20)
        calls[key] = max(math.ceil(ROUND_S / took * 20), 20)
    for _ in range(rounds):
        for key, (lane, factor) in lanes.items():
            found[key].append(calls[key] * factor / lane(calls[key]))
    return {key: [float(value) for value in np.percentile(values, (10, 50, 90))] for key, values in found.items()}


def physics(worlds: int, rounds: int, profiles: tuple[str, ...]) -> dict[int, Any]:
    """Rates of the arm, by steps a call."""
    python = os.environ.get("AMBF_PEERS_PYTHON")
    peers = [Peer(python, "pybullet_peer.py", resources() / MODEL) for _ in range(worlds if python else 0)]
    if any(peer.first != 7.0 for peer in peers):
        raise RuntimeError("pybullet found other than 7 joints")
    found = {}
    for steps in STEPS:
        factor = worlds * steps
        lanes = {name: (arms(name, worlds, steps), factor) for name in profiles}
        lanes["euler"] = (arms("accurate", worlds, steps, integrator="euler"), factor)
        lanes["in turn"] = (arms("accurate", worlds, steps, in_turn=True), factor)
        if peers:
            lanes["pybullet"] = (of_peers(peers, steps), factor)
        found[steps] = measure(lanes, rounds)
    for peer in peers:
        peer.close()
    return found


def reaching(worlds: int, rounds: int) -> dict[str, Any]:
    """Rates of the environment; of more than 8 worlds only ours in a batch and the fastest other one."""
    python = os.environ.get("AMBF_PEERS_PYTHON")
    few = worlds <= 8
    own = {f"ambf batch, {integrator}": batch(worlds, integrator) for integrator in INTEGRATORS}
    own.update({f"ambf, {integrator}": environments(worlds, integrator) for integrator in INTEGRATORS if few})
    lanes: dict[str, tuple[Lane, int]] = {name: (lane, worlds) for name, (lane, _) in own.items()}
    peers: list[Peer] = []
    for library in (("pybullet", "mujoco") if few else ("mujoco",)) if python else ():
        # The last version 3 of MuJoCo, see scripts/peers.
        older = {"PYTHONPATH": os.environ.get("AMBF_PEERS_MUJOCO3", "")} if library == "mujoco" else {}
        for way in ("sync", "async") if few else ("sync",):
            peers.append(Peer(str(python), "reach_peers.py", library, way, worlds, resources() / MODEL, **older))
            lanes[f"{library} {way}, Euler"] = (of_peers(peers[-1:]), worlds)
    found = measure(lanes, rounds)
    for _, close in own.values():
        close()
    for peer in peers:
        peer.close()
    return found


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description="What many worlds cost under one condition.")
    parser.add_argument("--cores", type=int)
    parser.add_argument("--busy", type=int, default=0)
    parser.add_argument("--worlds", type=int, nargs="+", default=[2, 8])
    parser.add_argument("--many", type=int, nargs="*", default=[])
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("--all", action="store_true")
    chosen = parser.parse_args()
    if chosen.cores:
        # Inherited by all threads and processes that begin after this.
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: chosen.cores])
    load = os.getloadavg()[0]
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(chosen.busy)]
    try:
        profiles = ("accurate", "legacy") if chosen.all else ("accurate",)
        found: dict[str, Any] = {"cores": len(os.sched_getaffinity(0)), "busy": chosen.busy, "load": load}
        found["physics"] = {worlds: physics(worlds, chosen.rounds, profiles) for worlds in chosen.worlds}
        found["reach"] = {worlds: reaching(worlds, chosen.rounds) for worlds in (*chosen.worlds, *chosen.many)}
        print(json.dumps(found))
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


if __name__ == "__main__":
    main()
