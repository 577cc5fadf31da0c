"""Where things stand on the boards of resources/peg_transfer, as the scene has them. Lengths in m, world axes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Dict, Tuple

Place = Tuple[float, float]


@dataclass(frozen=True)
class Board:
    """A board as it stands in the scene. One that is moved carries its pegs along."""

    body: str
    """Name of its body."""
    position: Tuple[float, float, float]
    """Of that body's frame."""
    rotation: Tuple[float, float, float, float]
    """Quaternion x, y, z, w."""
    top: float
    """Height of its surface."""
    middle: float
    """x of the line between both sides: +x is the left of the picture."""
    pegs: Dict[str, Place] = field(repr=False)
    """Where their axes are."""
    blocks: Tuple[str, ...]
    """Names of the blocks."""

    def side(self, peg: str) -> int:
        """1: left in the picture, -1: right."""
        return 1 if self.pegs[peg][0] > self.middle else -1


_COLUMNS = (-0.06073, -0.04073, -0.02073, 0.05927, 0.07927, 0.09927)
_ROWS = (0.20199, 0.23199, 0.26199)
_UPRIGHT = (0.0, 0.7071067811865476, 0.7071067811865476, 0.0)
"""Roll pi/2 about x, then yaw -pi about z."""


def _symmetric() -> Dict[str, Place]:
    # As scripts/make_peg_transfer numbers them; a test compares both.
    places = [(x, y) for x in reversed(_COLUMNS[3:]) for y in _ROWS[::-1]]
    far = [(x, y) for x in _COLUMNS[:3] for y in _ROWS]
    order = [places[i] for i in (0, 2, 3, 1, 4, 5, 6, 7, 8)] + [far[i] for i in (1, 0, 2, 3, 4, 5, 6, 7, 8)]
    return {f"peg{i + 1}_s": place for i, place in enumerate(order)}


def _asymmetric() -> Dict[str, Place]:
    left = [(x, y) for y in _ROWS for x in _COLUMNS[3:5]]
    right = [
        (-0.06073, 0.19699),
        (-0.03073, 0.19699),
        (-0.04573, 0.21699),
        (-0.06073, 0.23699),
        (-0.03073, 0.23699),
        (-0.04573, 0.25699),
        (-0.01073, 0.22699),
    ]
    numbers = [*range(1, 8), *range(9, 15)]
    return {f"peg{number}": place for number, place in zip(numbers, left + right)}


SYMMETRIC = Board(
    body="peg_board_s",
    position=(0.01927, 0.23199, 0.70891),
    rotation=_UPRIGHT,
    top=0.72391,
    middle=0.01937,
    pegs=_symmetric(),
    blocks=("block1", "block2"),
)
"""Three by three pegs on each side of a wall, two blocks: resources/peg_transfer/board.yaml."""

ASYMMETRIC = Board(
    body="peg_board",
    position=SYMMETRIC.position,
    rotation=_UPRIGHT,
    top=0.72391,
    middle=0.01937,
    pegs=_asymmetric(),
    blocks=tuple(f"block{i}" for i in range(1, 7)),
)
"""Thirteen pegs, six blocks, no wall: resources/peg_transfer/board_asymmetric.yaml."""
