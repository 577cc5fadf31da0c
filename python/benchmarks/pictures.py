"""What pictures cost: pictures.py FOLDER [--quick]. `scripts/bench pictures` starts it.

Frames of 200 boxes, of an arm with meshes and of a cloth, by this project, MuJoCo and both renderers of pybullet. The engines are programs
of their own that take turns (`pictures_engine.py`); medians of all frames are told. Before anything is timed the depth of the scene as it
starts is compared, so that nobody wins by drawing less. Writes what is between the markers of FOLDER/pictures.md; with --quick
it measures a third as long and prints only.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ENGINES = {"ours": "ours", "mujoco": "MuJoCo", "tiny": "pybullet TINY", "egl": "pybullet EGL"}
SIZES = [(128, 128), (640, 480), (1280, 720)]
KINDS = {"color": "colour", "depth": "+ depth", "ids": "+ ids", "stereo": "stereo colour + depth"}
MARKS = ("<!-- measured: begin -->\n", "<!-- measured: end -->\n")
ENGINE = str(Path(__file__).with_name("pictures_engine.py"))


class Engine:
    """A program that draws one scene; `why` says why it does not."""

    def __init__(self, engine: str, scene: str, size: tuple[int, int], shadow: bool) -> None:
        peers = os.environ.get("AMBF_PEERS_PYTHON", "")
        python = sys.executable if engine == "ours" else peers
        self.why, self.program = "", None
        if not python:
            self.why = "not installed"
            return
        command = [python, ENGINE, engine, scene, *map(str, size), str(int(shadow))]
        self.program = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        words = self.program.stdout.readline().split()
        if not words:
            lines = self.program.stderr.read().strip().splitlines()
            self.why = lines[-1] if lines else "ended"
            self.program = None
            return
        self.start, self.memory = float(words[1]), int(words[2])

    def ask(self, line: str) -> str:
        """The answer to a line."""
        self.program.stdin.write(line + "\n")
        self.program.stdin.flush()
        return self.program.stdout.readline()

    def close(self) -> None:
        """Ends the program."""
        if self.program:
            self.program.stdin.close()
            self.program.wait()


def agreement(engines: dict[str, Engine]) -> dict[str, str]:
    """Of each engine: part of the pixels whose depth is ours within 1 %."""
    depths = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, engine in engines.items():
            file = f"{folder}/{name}.npy"
            engine.ask(f"check {file}")
            depths[name] = np.load(file)
    ours = depths.get("ours")
    if ours is None:
        return {}
    return {
        name: f"{100 * np.mean(np.abs(np.minimum(depth, 19) - np.minimum(ours, 19)) <= 0.01 * ours):.1f} %"
        for name, depth in depths.items()
        if name != "ours"
    }


def measure(scene: str, size: tuple[int, int], shadow: bool, rounds: int, frames: int) -> tuple[list[str], dict]:
    """Lines of a table, and the medians in ms by kind and engine."""
    engines = {name: Engine(name, scene, size, shadow) for name in ENGINES}
    ready = {name: engine for name, engine in engines.items() if engine.program}
    alike = agreement(ready)
    times: dict[tuple[str, str], list[float]] = {}
    for kind in KINDS:
        for _ in range(rounds):
            for name, engine in ready.items():
                # TINY takes seconds for large pictures.
                count = 1 if name == "tiny" else frames
                times.setdefault((kind, name), []).extend(map(float, engine.ask(f"{kind} {count}").split()))
    for engine in engines.values():
        engine.close()
    medians = {key: statistics.median(values) for key, values in times.items() if values}
    lines = []
    for kind, title in KINDS.items():
        cells = []
        for name in ENGINES:
            median = medians.get((kind, name))
            ratio = "" if name == "ours" or not median else f" ({median / medians[kind, 'ours']:.1f})"
            cells.append(f"{median:.1f}{ratio}" if median else "–")
        lines.append(
            f"| {scene} | {size[0]}×{size[1]} | {'yes' if shadow else 'no'} | {title} | " + " | ".join(cells) + " |"
        )
    notes = [
        f"{scene} {size[0]}×{size[1]}: depth within 1 % of ours: "
        + ", ".join(f"{ENGINES[n]} {v}" for n, v in alike.items())
    ]
    notes += [f"{scene}: {ENGINES[name]}: {engine.why}" for name, engine in engines.items() if engine.why]
    notes += [
        f"{scene} {size[0]}×{size[1]}: first picture after "
        + ", ".join(f"{ENGINES[n]} {e.start:.2f} s" for n, e in ready.items())
        + "; memory "
        + ", ".join(f"{ENGINES[n]} {e.memory} MiB" for n, e in ready.items())
    ]
    return lines, {"lines": lines, "medians": medians, "notes": notes}


def draw(file: Path, found: dict) -> None:
    """Milliseconds of colour + depth at 640 x 480 by scene and engine; `found` holds medians by (scene, shadow)."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = [name for name in ENGINES if name != "tiny"]
    groups = list(found)
    figure, axes = pyplot.subplots(figsize=(8.0, 3.2))
    for place, name in enumerate(names):
        heights = [found[group].get(("depth", name), 0.0) for group in groups]
        at = [group + (place - 1) * 0.27 for group in range(len(groups))]
        axes.bar_label(axes.bar(at, heights, 0.25, label=ENGINES[name]), fmt="%.1f", fontsize=7)
    labels = [f"{scene}\n{'with shadow' if shadow else 'no shadow'}" for scene, shadow in groups]
    axes.set_xticks(range(len(groups)), labels, fontsize=8)
    axes.set_ylabel("ms a frame")
    axes.set_title("Colour and depth, 640 × 480", fontsize=10)
    axes.legend(fontsize=8, frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    figure.savefig(file)


def main() -> None:
    """Measures, prints and writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    rounds, frames = (2, 3) if arguments.quick else (5, 6)
    load = " ".join(f"{x:.2f}" for x in os.getloadavg())
    text = [
        f"Machine: {platform.machine()}, {os.cpu_count()} cores, {platform.system()} {platform.release()}; load average before: {load}.\n",
        "Median milliseconds a frame (in brackets: times ours).\n",
        "| scene | size | shadow | picture | " + " | ".join(ENGINES.values()) + " |",
        "|---|---|---|---|" + "---|" * len(ENGINES),
    ]
    notes: list[str] = []
    plotted = {}
    for scene in ("boxes", "arm", "cloth"):
        for size in SIZES:
            for shadow in (False, True):
                lines, result = measure(scene, size, shadow, rounds, frames)
                print("\n".join(lines), flush=True)
                text += lines
                if size == (640, 480):
                    plotted[scene, shadow] = result["medians"]
                if shadow:
                    notes += [note for note in result["notes"] if note not in notes]
    text += ["", *(f"* {note}" for note in dict.fromkeys(notes))]
    if arguments.quick:
        print("\n".join(f"* {note}" for note in dict.fromkeys(notes)))
        return
    draw(arguments.folder / "pictures.svg", plotted)
    text[1:1] = ["![colour and depth at 640 x 480](pictures.svg)\n"]
    page = arguments.folder / "pictures.md"
    before, rest = page.read_text().split(MARKS[0])
    _, after = rest.split(MARKS[1])
    page.write_text(before + MARKS[0] + "\n".join(text) + "\n" + MARKS[1] + after)


if __name__ == "__main__":
    main()
