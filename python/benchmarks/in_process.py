"""What stepping in this process costs: in_process.py FOLDER [--quick]. `scripts/bench python` starts it.

* what `worlds.py` measures, with all cores and with one, with nothing beside it and with endless loops on all of them: physics steps of an
  arm, and the vectorised reach task, beside pybullet and MuJoCo;
* the environment of the reach task without a vector, and over ROS;
* what `many_worlds.py` measures: memory and load time of 256 worlds;
* what `ros_stepping.py` measures.

The lanes of a table take turns in short rounds; medians of the rounds are told. Writes FOLDER/python.md (what is between the markers) and
figures; with --quick it measures a third as long and writes nothing.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Callable

import numpy as np
import ros_stepping
from ambf_gym import SimulatorEnv
from ambf_gym.scene import resources
from ambf_gym.tasks import make_reach, reach

WORLDS = (1, 2, 4, 8)
INTEGRATORS = ("rk4", "euler")
STEPS = (1, 10)
# Worlds of the task alone.
MANY = (64, 256)
ROUND_S = 0.25
# Processes that take all cores, a core.
BUSY = 4
HERE = Path(__file__).parent
MARKS = ("<!-- measured: begin -->\n", "<!-- measured: end -->\n")

# A lane does so many calls and says how long they took, s.
Lane = Callable[[int], float]


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


def under(cores: int, busy: int, worlds: tuple[int, ...], rounds: int, *extra: str) -> Any:
    """What worlds.py finds under a condition."""
    words = ["--cores", cores, "--busy", busy, "--rounds", rounds, *extra, "--worlds", *worlds]
    command = [sys.executable, str(HERE / "worlds.py"), *map(str, words)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def conditions(rounds: int) -> list[Any]:
    """All that are measured; the first is all cores with nothing beside them."""
    cores = len(os.sched_getaffinity(0))
    found = [under(cores, 0, WORLDS, rounds, "--all", "--many", *map(str, MANY))]
    for count in sorted({cores, 1}, reverse=True):
        for busy in (0, BUSY * count):
            if (count, busy) != (cores, 0):
                many = () if busy else ("--many", *MANY)
                found.append(under(count, busy, (2, WORLDS[-1]), rounds, *map(str, many)))
    return found


def name_of(condition: Any) -> str:
    """Cores, and what runs beside."""
    beside = f", {condition['busy']} endless loops" if condition["busy"] else ""
    return f"{condition['cores']} core{'s' if condition['cores'] > 1 else ''}{beside}"


def ratio(one: Any, other: Any) -> str:
    """Of two medians."""
    return f"{one[1] / other[1]:.2f}"


def physics(found: list[Any]) -> list[str]:
    """Tables of the arm."""
    has_peers = "pybullet" in found[0]["physics"][str(WORLDS[0])][str(STEPS[0])]
    names = ["`accurate`, rk4", "in turn, rk4", "at once/in turn", "`accurate`, euler"]
    names += ["pybullet, Euler", "rk4/pybullet", "euler/pybullet"] if has_peers else []
    lines = [
        f"| | load | worlds | steps a call | {' | '.join(names)} | `legacy`, euler |",
        "|" + "---|" * (5 + len(names)),
    ]
    for condition in found:
        for steps in STEPS:
            for worlds, rates in condition["physics"].items():
                row = rates[str(steps)]
                cells = [rate(row["accurate"]), rate(row["in turn"]), ratio(row["accurate"], row["in turn"])]
                cells.append(rate(row["euler"]))
                if has_peers:
                    cells += [rate(row["pybullet"]), ratio(row["accurate"], row["pybullet"])]
                    cells.append(ratio(row["euler"], row["pybullet"]))
                cells.append(rate(row["legacy"]) if "legacy" in row else "")
                load = f"{condition['load']:.1f}"
                lines.append(f"| {name_of(condition)} | {load} | {worlds} | {steps} | {' | '.join(cells)} |")
    print("\n".join(lines), flush=True)
    return lines


def reaching(found: list[Any], rounds: int) -> list[str]:
    """Tables of the environment."""
    lanes = list(found[0]["reach"][str(WORLDS[0])])
    heads = [*lanes, "best of ours, rk4/best other", "best of ours, euler/best other"]
    lines = [f"| | worlds | {' | '.join(heads)} |", "|" + "---|" * (2 + len(heads))]
    for condition in found:
        for worlds, row in condition["reach"].items():
            cells = [rate(row[name]) if name in row else "" for name in lanes]
            for integrator in INTEGRATORS:
                own = [value for name, value in row.items() if name.startswith("ambf") and name.endswith(integrator)]
                others = [value for name, value in row.items() if not name.startswith("ambf")]
                best = [max(values, key=lambda value: value[1]) for values in (own, others) if values]
                cells.append(ratio(*best) if len(best) == 2 else "")
            lines.append(f"| {name_of(condition)} | {worlds} | {' | '.join(cells)} |")
    made = {
        f"{name}, {integrator}": (environment(make_reach(backend, integrator=integrator)), 1)
        for name, backend in (("alone", "process"), ("over ROS", "ros"))
        for integrator in INTEGRATORS
    }
    single = measure({name: (lane, factor) for name, ((lane, _), factor) in made.items()}, rounds)
    for (_, close), _ in made.values():
        close()
    lines += ["", "| 1 world, no vector | environment steps/s |", "|---|---|"]
    lines += [f"| {name} | {rate(value)} |" for name, value in single.items()]
    print("\n".join(lines), flush=True)
    return lines


def many(worlds: int) -> list[str]:
    """Table of memory and load time."""
    lines = [
        "| scene | first world, ms | last worlds, ms | first/last | first, MB | each further, kB | all, MB | again alone, ms |",
        "|" + "---|" * 8,
    ]
    scenes = {
        "`hanging_arm.urdf`": str(resources() / "models/hanging_arm.urdf"),
        "arm, hulls of 8 meshes": "hulls",
        "arm, 8 concave meshes of 20 000 triangles": "fine",
    }
    root = os.environ.get("AMBF_ROOT_PATH")
    if root:
        raven = Path(root) / "ambf_models/descriptions/multi-bodies/robots/blender-raven2.yaml"
        scenes.update({"`blender-raven2.yaml`": str(raven)} if raven.exists() else {})
    for name, scene in scenes.items():
        command = [sys.executable, str(HERE / "many_worlds.py"), scene, "--worlds", str(worlds)]
        found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1])
        first, last = 1e3 * found["first_s"], 1e3 * found["last_s"]
        each = (found["all_kb"] - found["first_kb"]) / (worlds - 1)
        megabytes = [(found[key] - found["before_kb"]) / 1000 for key in ("first_kb", "all_kb")]
        lines.append(
            f"| {name} | {first:.1f} | {last:.2f} | {first / last:.1f} | {megabytes[0]:.1f} | {each:.0f} | {megabytes[1]:.0f} "
            f"| {1e3 * found['alone_s']:.1f} |"
        )
    print("\n".join(lines), flush=True)
    return lines


def draw(folder: Path, found: Any) -> None:
    """Physics steps a second against worlds."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    colours = {
        "accurate": "#33658a",
        "euler": "#55286f",
        "legacy": "#86bbd8",
        "in turn": "#758e4f",
        "pybullet": "#f26419",
    }
    labels = {"accurate": "accurate, rk4", "euler": "accurate, euler", "legacy": "legacy, euler"}
    labels.update({"in turn": "accurate in turn, rk4", "pybullet": "pybullet, Euler"})
    figure, panes = pyplot.subplots(1, len(STEPS), figsize=(8.0, 3.2), sharey=True)
    for axes, steps in zip(panes, STEPS):
        rows = [found["physics"][str(worlds)][str(steps)] for worlds in WORLDS]
        for name in (name for name in colours if name in rows[0]):
            low, middle, high = np.transpose([row[name] for row in rows]) / 1000.0
            axes.fill_between(WORLDS, low, high, color=colours[name], alpha=0.25, linewidth=0)
            axes.plot(WORLDS, middle, color=colours[name], marker="o", label=labels[name])
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
    rounds = 2 if chosen.quick else 6
    found = conditions(rounds)
    with tempfile.TemporaryDirectory() as folder:
        figures = Path(folder) if chosen.quick else chosen.folder
        parts += ["### Physics steps a second, arm of seven joints", "", *physics(found), ""]
        draw(figures, found[0])
        parts += ["![physics steps a second against worlds](python.svg)", ""]
        title = f"### Environment steps a second, the reach task, {reach.TASK.n_skip_steps} physics steps each"
        parts += [title, "", *reaching(found, rounds), ""]
        worlds = 32 if chosen.quick else 256
        parts += [f"### Memory and load time of {worlds} worlds", "", *many(worlds), ""]
        parts += ["### Over ROS", "", *over_ros(figures, 2.0 if chosen.quick else 5.0), ""]
    if not chosen.quick:
        page.write_text(head + MARKS[0] + "\n".join(parts) + "\n" + MARKS[1] + tail)


if __name__ == "__main__":
    main()
