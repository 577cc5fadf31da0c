"""What stepping in this process costs: in_process.py FOLDER [--quick]. `scripts/bench python` starts it.

* physics steps a second of an arm of seven joints, 1 to 8 worlds, beside pybullet with the same file: worlds here are stepped on threads of
  one process, those of pybullet in a process each;
* steps a second of the environment of the reach task, 1 to 8 worlds, and over ROS;
* what `ros_stepping.py` measures.

The lanes of a table take turns in short rounds; medians of the rounds are told. Writes FOLDER/python.md (what is between the markers) and
figures; with --quick it measures a third as long and writes nothing.
"""

from __future__ import annotations

import argparse
import math
import os
import platform
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any, Callable

import ambf
import numpy as np
import ros_stepping
from ambf_gym import InProcessVectorEnv, SimulatorEnv
from ambf_gym.scene import resources
from ambf_gym.tasks import make_reach, reach

WORLDS = (1, 2, 4, 8)
STEPS = (1, 10)
PROFILES = ("accurate", "legacy")
ROUND_S = 0.25
MODEL = "models/hanging_arm.urdf"
MARKS = ("<!-- measured: begin -->\n", "<!-- measured: end -->\n")

# A lane does so many calls and says how long they took, s.
Lane = Callable[[int], float]


def arms(profile: str, worlds: int, steps: int) -> Lane:
    """Calls as pybullet_peer.py describes them, in all worlds at once; a call counts once a world."""
    sims = [ambf.Simulation(resources() / MODEL, profile=profile) for _ in range(worlds)]
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
            if worlds == 1:
                sims[0].step(steps)
            else:
                ambf.step_all(sims, steps)
            for body, end in zip(bodies, ends):
                _ = body.joint_positions, body.joint_velocities, end.pose.copy(), end.twist.copy()
        return time.perf_counter() - begin

    return run


class Peers:
    """Programs with an arm in pybullet each."""

    def __init__(self, python: str) -> None:
        command = [python, str(Path(__file__).with_name("pybullet_peer.py")), str(resources() / MODEL)]
        self._programs = [
            subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
            )
            for _ in range(WORLDS[-1])
        ]
        joints = {self._answer(program) for program in self._programs}
        if joints != {7.0}:
            raise RuntimeError(f"pybullet found {joints} joints instead of 7")

    @staticmethod
    def _answer(program: Any) -> float:
        return float(program.stdout.readline())

    def lane(self, worlds: int, steps: int) -> Lane:
        """So many of them at once."""

        def run(calls: int) -> float:
            begin = time.perf_counter()
            for program in self._programs[:worlds]:
                program.stdin.write(f"{calls} {steps}\n")
                program.stdin.flush()
            for program in self._programs[:worlds]:
                self._answer(program)
            return time.perf_counter() - begin

        return run

    def close(self) -> None:
        """Ends them."""
        for program in self._programs:
            program.communicate()


def environments(worlds: int) -> tuple[Lane, Callable[[], None]]:
    """Steps of the reach task with random actions, resets among them."""
    env = InProcessVectorEnv(reach.SCENE, reach.TASK, worlds)
    env.reset(seed=0)
    env.action_space.seed(0)

    def run(calls: int) -> float:
        actions = [env.action_space.sample() for _ in range(calls)]
        begin = time.perf_counter()
        for action in actions:
            env.step(action)
        return time.perf_counter() - begin

    return run, env.close


def environment(env: SimulatorEnv) -> tuple[Lane, Callable[[], None]]:
    """The same in an environment without a vector."""
    env.reset(seed=0)
    env.action_space.seed(0)

    def run(calls: int) -> float:
        actions = [env.action_space.sample() for _ in range(calls)]
        begin = time.perf_counter()
        for action in actions:
            if env.step(action)[3]:
                env.reset()
        return time.perf_counter() - begin

    return run, env.close


def measure(lanes: dict[Any, tuple[Lane, int]], rounds: int) -> dict[Any, Any]:
    """Percentiles 10, 50 and 90 of each lane's rate: calls a second times its factor."""
    calls, found = {}, {key: [] for key in lanes}
    for key, (lane, _) in lanes.items():
        # The first calls warm up.
        lane(20)
        calls[key] = max(math.ceil(ROUND_S / lane(20) * 20), 20)
    for _ in range(rounds):
        for key, (lane, factor) in lanes.items():
            found[key].append(calls[key] * factor / lane(calls[key]))
    return {key: np.percentile(values, (10, 50, 90)) for key, values in found.items()}


def rate(value: Any) -> str:
    """Median and spread, in three digits."""

    def digits(number: float) -> str:
        return f"{float(f'{number:.3g}'):,.0f}".replace(",", " ")

    return f"{digits(value[1])} ({digits(value[0])}–{digits(value[2])})"


def physics(rounds: int) -> tuple[list[str], dict[Any, Any], list[str]]:
    """Table of the arm."""
    python = os.environ.get("AMBF_PEERS_PYTHON")
    peers = Peers(python) if python else None
    names = [f"`{profile}`" for profile in PROFILES] + (["pybullet"] if peers else [])
    lines = [
        f"| worlds | steps a call | {' | '.join(names)} |" + (" accurate/pybullet |" if peers else ""),
        "|" + "---|" * (2 + len(names) + bool(peers)),
    ]
    found: dict[Any, Any] = {}
    for steps in STEPS:
        for worlds in WORLDS:
            lanes = {(name, steps, worlds): (arms(name, worlds, steps), worlds * steps) for name in PROFILES}
            if peers:
                lanes["pybullet", steps, worlds] = (peers.lane(worlds, steps), worlds * steps)
            row = measure(lanes, rounds)
            found.update(row)
            cells = [rate(value) for value in row.values()]
            if peers:
                cells.append(f"{row['accurate', steps, worlds][1] / row['pybullet', steps, worlds][1]:.2f}")
            lines.append(f"| {worlds} | {steps} | {' | '.join(cells)} |")
            print(lines[-1], flush=True)
    if peers:
        peers.close()
    return lines, found, [*PROFILES, *(["pybullet"] if peers else [])]


def reaching(rounds: int) -> list[str]:
    """Table of the environment."""
    made = {f"{worlds} world(s), vector": (environments(worlds), worlds) for worlds in WORLDS}
    made["1 world, alone"] = (environment(make_reach(in_process=True)), 1)
    made["1 world over ROS"] = (environment(make_reach()), 1)
    found = measure({name: (lane, factor) for name, ((lane, _), factor) in made.items()}, rounds)
    for (_, close), _ in made.values():
        close()
    iterations = reach.TASK.n_skip_steps
    lines = ["| | environment steps/s | physics steps/s |", "|---|---|---|"]
    lines += [f"| {name} | {rate(value)} | {rate(value * iterations)} |" for name, value in found.items()]
    print("\n".join(lines), flush=True)
    return lines


def draw(folder: Path, found: dict[Any, Any], names: list[str]) -> None:
    """Physics steps a second against worlds."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, panes = pyplot.subplots(1, len(STEPS), figsize=(8.0, 3.2), sharey=True)
    for axes, steps in zip(panes, STEPS):
        for name, colour in zip(names, ("#33658a", "#86bbd8", "#f26419")):
            low, middle, high = np.transpose([found[name, steps, worlds] for worlds in WORLDS]) / 1000.0
            axes.fill_between(WORLDS, low, high, color=colour, alpha=0.25, linewidth=0)
            axes.plot(WORLDS, middle, color=colour, marker="o", label=name)
        axes.set_xscale("log", base=2)
        axes.set_xticks(WORLDS, [str(worlds) for worlds in WORLDS])
        axes.set_title(f"{steps} step(s) a call", fontsize=10)
        axes.set_xlabel("worlds")
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    panes[0].set_ylabel("1000 physics steps/s")
    panes[0].legend(frameon=False)
    figure.tight_layout()
    figure.savefig(folder / "python.svg")


def over_ros(folder: Path, seconds: float) -> list[str]:
    """Lines about stepping over ROS."""
    found = ros_stepping.measure(folder, seconds)
    lines = ["| stepping over ROS | round trips/s | median, µs | 99th percentile, µs |", "|---|---|---|---|"]
    labels = {
        "service_1": "service, 1 iteration",
        "service_10": "service, 10 iterations",
        "topics_1": "topics, 1 iteration",
    }
    for key, label in labels.items():
        value = found[key]
        lines.append(
            f"| {label} | {value['round_trips_hz']:.0f} | {value['us']['p50']:.0f} | {value['us']['p99']:.0f} |"
        )
    ages, stamps = found["topics_1"]["age_ms"], found["topics_1"]["between_stamps_ms"]
    lines += [
        "",
        f"Age of a state at its arrival, ms: median {ages['p50']:.3f}, 99th percentile {ages['p99']:.3f}; time between stamps, ms: median "
        f"{stamps['p50']:.3f}, 99th percentile {stamps['p99']:.3f}.",
        "",
        "| one of 200 bodies that are published at 2 kHz | states/s | longest gap, ms |",
        "|---|---|---|",
    ]
    topics = found["rates"]["topics"]
    lines += [f"| {name} | {topic['hz']:.0f} | {topic['period_ms']['max']:.2f} |" for name, topic in topics.items()]
    return lines


def machine() -> str:
    """What the numbers were measured on."""
    model = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                model = line.split(":", 1)[1].strip()
    except OSError:
        pass
    load = " ".join(f"{value:.2f}" for value in os.getloadavg())
    return (
        f"Machine: {model}, {os.cpu_count()} cores, {platform.system()} {platform.release()}; Python {platform.python_version()}; "
        f"load average before: {load}. Seeds: 0."
    )


def main() -> None:
    """Measures and records."""
    parser = argparse.ArgumentParser(description="What stepping in this process costs.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--quick", action="store_true")
    chosen = parser.parse_args()
    page = chosen.folder / "python.md"
    head, rest = page.read_text().split(MARKS[0])
    tail = rest.split(MARKS[1])[1]
    parts = [machine(), ""]
    rounds = 4 if chosen.quick else 12
    table, found, names = physics(rounds)
    with tempfile.TemporaryDirectory() as folder:
        figures = Path(folder) if chosen.quick else chosen.folder
        parts += ["### Physics steps a second, arm of seven joints", "", *table, ""]
        draw(figures, found, names)
        parts += ["![physics steps a second against worlds](python.svg)", ""]
        parts += [f"### The reach task, {reach.TASK.n_skip_steps} iterations a step", "", *reaching(rounds), ""]
        parts += ["### Over ROS", "", *over_ros(figures, 2.0 if chosen.quick else 5.0), ""]
    if not chosen.quick:
        page.write_text(head + MARKS[0] + "\n".join(parts) + "\n" + MARKS[1] + tail)


if __name__ == "__main__":
    main()
