"""A player that brings the ring along the wire by a script, in this process: its arm is driven through CRTK topics, and it is told where
ring and tool are, as a program is that subscribes to their States.

It needs NumPy and the package `ambf`. `python -m ambf_ring_on_wire.player` plays runs with many seeds and prints a table.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import List, Optional, Sequence

import ambf
import numpy as np
from ambf_peg_transfer.arms import quaternion_of
from ambf_peg_transfer.player import TICK, Arm, Failed, Place, _rotated, _rotation_vector, place_of

from . import plan, wire
from .judge import Judge, Score

SPEED, TURN = 0.01, 0.8
"""Greatest of the ring's set point, m/s and rad/s: a step of the set points throws the ring out of the jaws."""
FOLLOW = 1.0
"""Time in which the player follows what the ring slips in the jaws, s."""
PAUSE = 1.0
"""At the start, while the jaws close, s."""


def scene(
    resources: Path, seed: Optional[int], profile: str = "accurate", step: float = 0.005, errors: bool = False
) -> ambf.Simulation:
    """The scene, with its arm for CRTK clients and the ring in its jaws as the seed puts it. `errors`: the arm's joints have those
    of the seed.
    """
    folder = resources / "ring_on_wire"
    simulation = ambf.Simulation(
        launch_file=folder / "launch.yaml",
        indexes=[0, 1, 2],
        profile=profile,
        step=step,
        crtk=[folder / "crtk.yaml"],
        seed=seed if errors else None,
    )
    place(simulation, plan.ways().turns[plan.draw(seed or 0)])
    return simulation


def place(simulation: ambf.Simulation, turn: float) -> None:
    """Puts ring and arm where a run starts, the ring turned about the wire."""
    ring = plan.ring_at(wire.START, turn)
    q = plan.joints("psm1", plan.tool_of(ring))
    if q is None:
        raise Failed("the arm can't hold the ring there")
    body = simulation.body("ring_visual")
    arm, base = simulation.arm("psm1"), simulation.body("psm1/baselink")
    # Where joints are and what they say differ by their errors. Set points first: those of the scene would throw the ring away.
    simulation.step(2)
    errors = base.joint_positions[:6] - arm.joints("measured_js").position
    arm.send("servo_jp", q - errors)
    arm.send("jaw/servo_jp", [0.0])
    simulation.set_state(
        poses={body.name: (*ring.position, *quaternion_of(ring.axes))},
        twists={body.name: np.zeros(6)},
        joint_positions=dict(zip(base.joints, (*q, *plan.FINGERS))),
    )
    # The first iteration shows what was set, the next one measures it.
    simulation.step(2)


def between(here: Place, there: Place, share: float) -> Place:
    """So far on the way from `here` (0) to `there` (1)."""
    turn = _rotation_vector(there.axes @ here.axes.T)
    return Place(here.position + share * (there.position - here.position), _rotated(share * turn) @ here.axes)


def toward(here: Place, there: Place) -> Place:
    """What is at `here` a tick later, on its way to `there`."""
    far = float(np.linalg.norm(there.position - here.position))
    angle = float(np.linalg.norm(_rotation_vector(there.axes @ here.axes.T)))
    return between(here, there, 1.0 / max(1.0, far / (SPEED * TICK), angle / (TURN * TICK)))


class Player:
    """Plays in a simulation of the scene, and lets a judge watch."""

    def __init__(self, simulation: ambf.Simulation, step: float) -> None:
        """`step`: interval of an iteration of the simulation, s. Raises Failed if the tool is where no set point brings it."""
        self.simulation = simulation
        self.judge = Judge()
        self.arm = Arm(simulation, "psm1")
        self._ring = simulation.body("ring_visual")
        self._steps = max(1, round(TICK / step))
        # It stays where it is.
        self.arm.look()
        goal = self.arm.solve(self.arm.tool)
        if goal is None:
            raise Failed("the arm is beyond its limits")
        self.arm.goal, self.arm.jaw = goal, 0.0

    def tick(self) -> Score:
        """Lets a tick pass."""
        self.arm.send()
        self.simulation.step(self._steps)
        self.arm.look()
        return self.judge.update(self.simulation.sim_time, self._ring.pose, self.arm.tool.position)

    def play(self, start: int) -> Score:
        """Brings the ring to the end, or until it is dropped; `start`: as `plan.draw` has it."""
        way = plan.ways()
        turns = way.way(start)
        for _ in range(round(PAUSE / TICK)):
            self.tick()
        along, score = float(way.alongs[0]), self.judge.score
        wanted = place_of(self._ring.pose)
        held = wanted.inverse().times(self.arm.tool)
        while not (score.is_over or score.drops):
            along = min(along + SPEED * TICK, float(way.alongs[-1]))
            wanted = toward(wanted, Place(*plan.ring_at(along, float(np.interp(along, way.alongs, turns)))))
            # The jaws have it as they have it: both States are of one moment. What it swings is not followed, what it slips is.
            held = between(held, place_of(self._ring.pose).inverse().times(self.arm.tool), TICK / FOLLOW)
            q = self.arm.solve(wanted.times(held))
            if q is not None:
                self.arm.goal = q
            score = self.tick()
        return score


def table(rows: Sequence[Score]) -> str:
    """Runs of many seeds as a table."""
    there = [row for row in rows if row.is_there]

    def middle(values: Sequence[float]) -> str:
        return f"{np.median(values):.1f}" if len(values) else "–"

    return "\n".join(
        (
            "| runs | there | without a touch | touches, mean | time of those there, median, s | drops |",
            "|--:|--:|--:|--:|--:|--:|",
            f"| {len(rows)} | {len(there)} | {sum(row.touches == 0 for row in there)} "
            f"| {np.mean([row.touches for row in rows]):.2f} | {middle([row.time for row in there])} "
            f"| {sum(row.drops for row in rows)} |",
        )
    )


def main(arguments: Optional[Sequence[str]] = None) -> None:
    """Plays runs with several seeds, and prints a line of JSON for each and a table."""
    from ambf_gym.scene import resources

    parser = argparse.ArgumentParser(prog="python -m ambf_ring_on_wire.player", description=__doc__)
    parser.add_argument("--seeds", type=int, default=10, help="how many runs, with the seeds 0, 1, … [10]")
    parser.add_argument("--first", type=int, default=0, help="the first seed [0]")
    parser.add_argument("--profile", default="accurate")
    parser.add_argument("--step", type=float, default=0.005, help="interval of an iteration, s [0.005]")
    parser.add_argument("--errors", action="store_true", help="the arm's joints have the errors of the seed")
    parser.add_argument("--table", action="store_true", help="the table alone, without a line for each run")
    options = parser.parse_args(arguments)
    rows: List[Score] = []
    for seed in range(options.first, options.first + options.seeds):
        simulation = scene(resources(), seed, options.profile, options.step, options.errors)
        rows.append(Player(simulation, options.step).play(plan.draw(seed)))
        simulation.close()
        if not options.table:
            print(json.dumps({"seed": seed, **rows[-1].as_dict()}), flush=True)
    print(table(rows))


if __name__ == "__main__":
    main()
