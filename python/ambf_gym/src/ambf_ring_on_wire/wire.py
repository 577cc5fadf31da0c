"""The wire of resources/ring_on_wire, and the ring: where they are, and what they are to each other. Lengths in m, world axes.

The scene's files are written from these numbers by scripts/make_ring_on_wire.
"""

from __future__ import annotations

from typing import NamedTuple, Tuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

CORNERS = (
    (0.085, 0.200, 0.700),
    (0.085, 0.200, 0.745),
    (0.060, 0.200, 0.765),
    (0.048, 0.212, 0.740),
    (0.030, 0.190, 0.755),
    (0.012, 0.200, 0.768),
    (0.000, 0.200, 0.745),
    (0.000, 0.200, 0.700),
)
"""Of the wire's centre line, from the board up to the left leg's top and down the right leg; +x is the left of the picture."""
BEND = 0.008
"""Radius by which corners are rounded."""
WIRE_RADIUS = 0.0008
TOP = 0.700
"""Of the board."""
INNER, OUTER = 0.0068, 0.0081
"""Of the ring, a torus about its z: its least and its greatest distance from that axis."""
RING, TUBE = 0.5 * (INNER + OUTER), 0.5 * (OUTER - INNER)
"""Its radii: of the middle circle and of the tube."""
SECTORS = 24
"""Of the ring: a capsule lies on each of so many chords of the middle circle."""
START, GOAL = 0.022, 0.022
"""A ring begins so far along the wire from its left foot, and is brought until it is so far from the right one."""


def _rounded() -> Array:
    corners = np.array(CORNERS)
    points = [corners[0]]
    for before, corner, after in zip(corners, corners[1:], corners[2:]):
        a = (before - corner) / np.linalg.norm(before - corner)
        b = (after - corner) / np.linalg.norm(after - corner)
        half = 0.5 * np.arccos(np.clip(a @ b, -1.0, 1.0))
        middle = corner + BEND / np.sin(half) * (a + b) / np.linalg.norm(a + b)
        begin = corner + BEND / np.tan(half) * a - middle
        end = corner + BEND / np.tan(half) * b - middle
        turn = np.pi - 2.0 * half
        pieces = max(2, int(np.ceil(turn / 0.25)))
        # Spherical interpolation between both radii.
        for i in range(pieces + 1):
            share = i / pieces
            points.append(middle + (np.sin((1 - share) * turn) * begin + np.sin(share * turn) * end) / np.sin(turn))
    points.append(corners[-1])
    return np.array(points)


POINTS: Array = _rounded()
"""(points x 3) of the centre line: the wire is a capsule between each two."""
_WAYS = np.diff(POINTS, axis=0)
_LENGTHS = np.linalg.norm(_WAYS, axis=1)
_ALONG = np.concatenate(([0.0], np.cumsum(_LENGTHS)))
LENGTH = float(_ALONG[-1])
_TANGENTS = _WAYS / _LENGTHS[:, None]
_ANGLES = np.linspace(0.0, 2.0 * np.pi, 192, endpoint=False)
_CIRCLE = RING * np.column_stack((np.cos(_ANGLES), np.sin(_ANGLES), np.zeros_like(_ANGLES)))


class Nearest(NamedTuple):
    """Where the wire is nearest to a point."""

    along: float
    """From the left foot along the wire."""
    point: Array
    """(3) on the centre line."""
    tangent: Array
    """(3) unit vector, towards the right foot."""
    distance: float


def at(along: float) -> Tuple[Array, Array]:
    """Point of the centre line and unit tangent, so far from the left foot; within the wire."""
    along = min(max(along, 0.0), LENGTH)
    index = min(int(np.searchsorted(_ALONG, along, side="right")) - 1, len(_WAYS) - 1)
    # Tangents of the pieces are those of their middles; in between they turn.
    point = POINTS[index] + (along - _ALONG[index]) * _TANGENTS[index]
    middles = 0.5 * (_ALONG[1:] + _ALONG[:-1])
    other = index + (1 if along > middles[index] else -1)
    tangent = _TANGENTS[index]
    if 0 <= other < len(_WAYS):
        share = abs(along - middles[index]) / abs(middles[other] - middles[index])
        tangent = (1.0 - share) * tangent + share * _TANGENTS[other]
    return point, tangent / np.linalg.norm(tangent)


def nearest(point: ArrayLike) -> Nearest:
    """The place of the wire that is nearest to a point."""
    p = np.asarray(point, np.float64)
    share = np.clip(((p - POINTS[:-1]) * _WAYS).sum(axis=1) / _LENGTHS**2, 0.0, 1.0)
    feet = POINTS[:-1] + share[:, None] * _WAYS
    distances = np.linalg.norm(feet - p, axis=1)
    index = int(np.argmin(distances))
    along = float(_ALONG[index] + share[index] * _LENGTHS[index])
    return Nearest(along, feet[index], at(along)[1], float(distances[index]))


def clearance(centre: ArrayLike, axes: Array) -> float:
    """Distance between the surfaces of wire and ring, negative where they overlap. `axes`: of the ring's frame, columns, in the
    world.
    """
    circle = np.asarray(centre, np.float64) + _CIRCLE @ axes.T
    return float(distances(circle).min()) - WIRE_RADIUS - TUBE


def distances(points: Array) -> Array:
    """(points) distance of each of (points x 3) from the centre line."""
    away = points[:, None, :] - POINTS[None, :-1, :]
    share = np.clip((away * _WAYS).sum(axis=2) / _LENGTHS**2, 0.0, 1.0)
    apart: Array = np.linalg.norm(away - share[:, :, None] * _WAYS, axis=2).min(axis=1)
    return apart


def is_threaded(centre: ArrayLike, axes: Array) -> bool:
    """Whether the wire passes through the ring: the centre line crosses the disc within its middle circle an odd number of times."""
    c = np.asarray(centre, np.float64)
    heights = (POINTS - c) @ axes[:, 2]
    crossing = np.nonzero((heights[:-1] < 0.0) != (heights[1:] < 0.0))[0]
    inside = 0
    for i in crossing:
        share = heights[i] / (heights[i] - heights[i + 1])
        hit = POINTS[i] + share * _WAYS[i] - c
        inside += float(hit @ hit) < RING**2
    return inside % 2 == 1
