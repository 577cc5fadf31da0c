"""How an arm holds the ring, and how it turns it on its way along the wire, so that it reaches all of it and touches nothing.

The ring may turn about the wire: by that angle a way is chosen. NumPy alone is needed.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import List, NamedTuple, Optional

import numpy as np
from ambf_peg_transfer.arms import GAP, LOWER, UPPER, Array, base, inverse
from ambf_peg_transfer.seeds import uniform
from numpy.typing import NDArray

from . import wire

HUB = wire.RING + 0.008
"""From the ring's axis to the fingers' hinge, m: the tube is 8 mm from the hinge, within the pads of the jaws."""
FINGERS = (0.0376, 0.0)
"""Angles of the left and the right finger that just touch the ring, rad. Both press alike, so that one of them is at its limit."""
SHIFT = wire.TUBE - 0.0005
"""How far the ring is then from the middle of the closed jaws, m: the pad of the right finger is 0.5 mm from that."""
STATIONS, TURNS = 60, 72
"""Of the way along the wire, and of the ring's turn about it, among which a way is sought."""
MOST_TURNS = 2
"""Between two stations the ring turns by so many of the steps at most."""
APART = ((0.010, 0.0035), (HUB, 0.0035))
"""Points of the fingers, from the ring's axis, and how far the wire has to be from them, m."""
SHAFT = 0.0065
"""How far the wire has to be from the axis of the instrument's shaft, m: its radius is 4.25 mm."""


class Frame(NamedTuple):
    """A frame in the world."""

    position: Array
    axes: Array


def ring_at(along: float, turn: float) -> Frame:
    """The ring around the wire: its z is along the wire, its x is where it is held."""
    point, tangent = wire.at(along)
    reference = np.array([0.0, 1.0, 0.0])
    first = reference - (reference @ tangent) * tangent
    first /= np.linalg.norm(first)
    second = np.cross(tangent, first)
    out = math.cos(turn) * first + math.sin(turn) * second
    return Frame(point, np.column_stack((out, np.cross(tangent, out), tangent)))


def tool_of(ring: Frame) -> Frame:
    """The tool's yaw link that holds the ring at its x, the fingers pointing at its middle, their pads on its flat sides."""
    out, axis = ring.axes[:, 0], -ring.axes[:, 2]
    return Frame(ring.position + HUB * out - SHIFT * axis, np.column_stack((axis, out, np.cross(axis, out))))


def joints(arm: str, tool: Frame) -> Optional[Array]:
    """Joints for a place of the tool; None: out of reach, or beyond limits."""
    position, axes = base(arm)
    return inverse(axes.T @ (tool.position - position), axes.T @ tool.axes)


def _value(arm: str, along: float, turn: float) -> float:
    """How far the joints are from their limits, as a share of their ranges; 0: it can't go there."""
    ring = ring_at(along, turn)
    tool = tool_of(ring)
    q = joints(arm, tool)
    if q is None:
        return 0.0
    near = [ring.position + far * ring.axes[:, 0] for far, _ in APART]
    stand, _ = base(arm)
    hinge = tool.axes[:, 2]
    level = tool.position - stand
    level = level - (level @ hinge) * hinge
    wrist = tool.position - GAP * level / np.linalg.norm(level)
    back = (stand - wrist) / np.linalg.norm(stand - wrist)
    shaft = [wrist + far * back for far in np.arange(0.0, 0.07, 0.004)]
    needs = [*(need for _, need in APART), *([SHAFT] * len(shaft))]
    if (wire.distances(np.array([*near, *shaft])) < needs).any():
        return 0.0
    return float(np.min(np.minimum(UPPER - q, q - LOWER) / (UPPER - LOWER)))


@dataclass(frozen=True)
class Ways:
    """All ways to the end, from each place of the grid."""

    alongs: Array
    """(stations) m."""
    turns: Array
    """(turns) rad."""
    costs: Array
    """(stations x turns) to the end; infinite: there is no way."""
    following: NDArray[np.intp]
    """(stations x turns) index of the turn at the next station."""

    def starts(self, most: float = math.inf) -> List[int]:
        """Turns at the first station from which there is a way that costs at most so much."""
        return [int(j) for j in np.nonzero(np.isfinite(self.costs[0]) & (self.costs[0] <= most))[0]]

    def way(self, start: int) -> Array:
        """(stations) turns, rad, that follow each other without a jump by a whole turn."""
        index, turns = start, [float(self.turns[start])]
        for station in range(len(self.alongs) - 1):
            following = int(self.following[station, index])
            step = (following - index + TURNS // 2) % TURNS - TURNS // 2
            turns.append(turns[-1] + step * 2.0 * math.pi / TURNS)
            index = following
        return np.array(turns)


@functools.cache
def ways(arm: str = "psm1") -> Ways:
    """By dynamic programming from the end: little turning, far from the joints' limits."""
    alongs = np.linspace(wire.START, wire.LENGTH - wire.GOAL, STATIONS)
    turns = 2.0 * math.pi * np.arange(TURNS) / TURNS
    values = np.array([[_value(arm, along, turn) for turn in turns] for along in alongs])
    with np.errstate(divide="ignore"):
        own = np.where(values > 0.01, 0.05 / values, np.inf)
    costs, following = own.copy(), np.zeros((STATIONS, TURNS), np.intp)
    for station in range(STATIONS - 2, -1, -1):
        steps = range(-MOST_TURNS, MOST_TURNS + 1)
        onward = np.array([np.roll(costs[station + 1], -step) + 0.1 * step * step for step in steps])
        best = np.argmin(onward, axis=0)
        following[station] = (np.arange(TURNS) + best - MOST_TURNS) % TURNS
        costs[station] = own[station] + onward[best, np.arange(TURNS)]
    return Ways(alongs, turns, costs, following)


def draw(seed: int, arm: str = "psm1") -> int:
    """How the ring is held at the start, by a seed: a turn about the wire, index into `Ways.turns`, from which there is a way."""
    starts = ways(arm).starts()
    return starts[int(next(uniform(seed)) * len(starts))]
