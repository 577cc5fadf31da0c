"""How well jaws hold a block, by the bound of their motors, beside other simulators: grips.py PAGE [--only SIMULATOR]….

Jaws, block and masses are those of resources/peg_transfer, in the words of `conformance/scene.py`, so that every simulator has the same
geometry. The jaws close on a block that stands on the ground, lift it by 35 mm within 0.7 s and hold it for 10 s. Measured are

* slip: by how much the block has moved in the jaws when the lift is over, mm;
* creep: by how much it moves in the 10 s after, um a minute;
* speed: the largest speed of the block against the jaws, m/s.

Writes what is between the markers of PAGE; with --only it prints the table and writes nothing. `scripts/bench grips` starts it.
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, Iterator, Optional

HERE = Path(__file__).parent / "conformance"
MARKS = ("<!-- grips: begin -->\n", "<!-- grips: end -->\n")
sys.path.insert(0, str(HERE))
from scene import Body, Joint, Scene, Shape, Simulator, Unsupported, box, box_inertia, turned  # noqa: E402

BOUNDS = (0.2, 20.0, 2e3, 2e5, 5e5)
"""Of each finger's motor, N m. The two last are 200 and 500 N m s in a sub-step of 1 ms."""
STEPS = (0.001, 0.005)
OPEN = 0.14
PAD = (0.0008, 0.0022, 0.005)
PAD_AT = (0.0009, -0.0068)
WALL = (0.00105, 0.010, 0.015)
FOOT = (0.012, 0.012, 0.002)
MASS = 0.1
FRICTION = 0.25
RISE, TIME = 0.035, 0.7
SIMULATORS = {
    "accurate": ("ambf_adapter", "Accurate"),
    "legacy": ("ambf_adapter", "Legacy"),
    "pybullet": ("pybullet_adapter", "PyBullet"),
    "MuJoCo": ("mujoco_adapter", "MuJoCo"),
}


def grip(bound: float) -> Scene:
    """Jaws around a wall with a foot, which stands on the ground."""
    hinge = FOOT[2] + WALL[2] + 0.0045
    floor = box("floor", (0.2, 0.2, 0.02), position=(0.0, 0.0, -0.01))
    hand = Body("hand", 5.0, (0.02, 0.02, 0.02), [], (0.0, 0.0, hinge))
    bodies, joints = (
        [floor, hand],
        [Joint("lift", "prismatic", "floor", "hand", (0.0, 0.0, hinge), (0.0, 0.0, 1.0), (-0.01, 0.1), effort=1e4)],
    )
    for side, sign in (("left", -1.0), ("right", 1.0)):
        pad = Shape("box", PAD, (sign * PAD_AT[0], 0.0, PAD_AT[1]))
        finger = Body(side, 1.0, (4e-4, 4e-4, 4e-4), [pad], (0.0, 0.0, hinge), turned((0.0, 1.0, 0.0), -sign * OPEN))
        bodies.append(finger)
        joints.append(
            Joint(f"{side} jaw", "revolute", "hand", side, (0.0, 0.0, hinge), (0.0, -sign, 0.0), effort=bound)
        )
    wall, foot = Shape("box", WALL, (0.0, 0.0, FOOT[2] / 2)), Shape("box", FOOT, (0.0, 0.0, -WALL[2] / 2))
    whole = (FOOT[0], FOOT[1], WALL[2] + FOOT[2])
    bodies.append(Body("block", MASS, box_inertia(MASS, whole), [wall, foot], (0.0, 0.0, whole[2] / 2)))
    for body in bodies:
        body.friction = FRICTION
    return Scene(bodies, joints)


def measure(make: Any, bound: float, step: float) -> Dict[str, Optional[float]]:
    """Slip, mm, creep, um/min, and speed, m/s; None: it is lost."""
    simulator: Simulator = make(grip(bound), step)
    fastest = 0.0

    def run(seconds: float) -> None:
        nonlocal fastest
        for _ in range(round(seconds / 0.01)):
            simulator.run(round(0.01 / step))
            away = simulator.velocity("block")[:3] - simulator.velocity("hand")[:3]
            fastest = max(fastest, math.sqrt(float(away @ away)))

    def held() -> Any:
        return simulator.position("block") - simulator.position("hand")

    simulator.drive("lift", 0.0)
    for side in ("left", "right"):
        simulator.servo(f"{side} jaw", -OPEN)
    run(0.7)
    before = held()
    simulator.drive("lift", RISE / TIME)
    run(TIME)
    simulator.drive("lift", 0.0)
    run(0.3)
    lifted = held()
    run(10.0)
    after = held()
    is_lost = not (math.isfinite(fastest) and abs(after[2] - before[2]) < 0.5 * RISE)
    slip = float(((lifted - before) ** 2).sum() ** 0.5)
    creep = float(((after - lifted) ** 2).sum() ** 0.5)
    if is_lost:
        return {"slip": None, "creep": None, "speed": fastest if math.isfinite(fastest) else None}
    return {"slip": 1e3 * slip, "creep": 1e6 * creep * 6.0, "speed": fastest}


def child(module: str, name: str) -> Iterator[Dict[str, Any]]:
    """Results of one simulator."""
    make = getattr(importlib.import_module(module), name)
    if hasattr(make, "rate_gain"):
        # The motor of the lift carries 7 kg; with this gain they sink by 0.07 mm/s.
        make.rate_gain = 1e6
    for step in STEPS:
        for bound in BOUNDS:
            try:
                yield {"step": step, "bound": bound, **measure(make, bound, step)}
            except Unsupported as reason:
                yield {"step": step, "bound": bound, "unsupported": str(reason)}


def cell(row: Optional[Dict[str, Any]]) -> str:
    """Three numbers."""
    if row is None:
        return "did not end"
    if "unsupported" in row:
        return "not possible"
    speed = "not finite" if row["speed"] is None else f"{row['speed']:.2g}"
    if row["slip"] is None:
        return f"lost; {speed}"
    return f"{row['slip']:.3f}; {row['creep']:.2g}; {speed}"


def main() -> None:
    """See above."""
    if sys.argv[1] == "--child":
        for row in child(*sys.argv[2:]):
            print(json.dumps(row), flush=True)
        return
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", type=Path)
    parser.add_argument("--only", action="append", default=[], choices=list(SIMULATORS))
    options = parser.parse_args()
    here, peers = sys.executable, os.environ.get("AMBF_PEERS_PYTHON")
    results: Dict[str, Dict[Any, Dict[str, Any]]] = {}
    for name, (module, simulator) in SIMULATORS.items():
        python = here if module == "ambf_adapter" else peers
        if python is None or (options.only and name not in options.only):
            continue
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(HERE), os.environ.get("PYTHONPATH", "")))}
        command = [python, __file__, "--child", module, simulator]
        done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=False, text=True)
        # pybullet says things of its own, also before them in a line.
        rows = [json.loads(line[line.index("{") :]) for line in done.stdout.splitlines() if "{" in line]
        results[name] = {(row["step"], row["bound"]): row for row in rows}
    lines = [f"| h, ms | bound, N m | {' | '.join(results)} |", "|--:|--:" + "|---" * len(results) + "|"]
    for step in STEPS:
        for bound in BOUNDS:
            cells = " | ".join(cell(rows.get((step, bound))) for rows in results.values())
            lines.append(f"| {1e3 * step:.3g} | {bound:.3g} | {cells} |")
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    text = "\n".join([f"Slip, mm; creep, um/min; speed, m/s. Machine: {machine}.\n", *lines, ""])
    if options.only:
        print(text)
        return
    page = options.page.read_text()
    before, _, rest = page.partition(MARKS[0])
    options.page.write_text(before + MARKS[0] + text + MARKS[1] + rest.partition(MARKS[1])[2])


if __name__ == "__main__":
    main()
