"""What differs from run to run, and is the same with the same seed: errors of the arms' joints, places of the blocks.

The numbers are those of `ambf_simulator --seed` with resources/peg_transfer/crtk.yaml (plugins/crtk/src/seed.rs), to the last bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, Iterator, Sequence, Tuple

from .board import SYMMETRIC, Board

ERRORS = (math.radians(5.0), math.radians(5.0), 0.005)
"""Bounds of the errors of yaw, pitch (rad) and insertion (m)."""

_MASK = 2**64 - 1


def uniform(seed: int) -> Iterator[float]:
    """Numbers of SplitMix64 (Steele, Lea and Flood 2014), uniform from 0 up to, not including, 1."""
    state = seed & _MASK
    while True:
        state = (state + 0x9E3779B97F4A7C15) & _MASK
        z = state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & _MASK
        yield ((z ^ (z >> 31)) >> 11) / 2**53


@dataclass(frozen=True)
class Draw:
    """What a seed stands for."""

    errors: Dict[str, Tuple[float, float, float]]
    """By arm: how far yaw, pitch (rad) and insertion (m) of the scene are beyond what the arm says."""
    blocks: Dict[str, Tuple[str, float]]
    """By block: the peg on which it stands, and how far it is turned about the vertical against the scene's file, rad."""


def draw(seed: int, board: Board = SYMMETRIC, arms: Sequence[str] = ("psm1", "psm2")) -> Draw:
    """All blocks stand on pegs of the left side, each on another one."""
    numbers = uniform(seed)
    errors = {arm: tuple(bound * (2.0 * next(numbers) - 1.0) for bound in ERRORS) for arm in arms}
    # Not the numbers of the errors.
    numbers = uniform(~seed)
    free = [peg for peg in board.pegs if board.side(peg) > 0]
    blocks = {}
    for block in board.blocks:
        peg = free.pop(int(next(numbers) * len(free)))
        blocks[block] = (peg, 2.0 * math.pi * next(numbers))
    return Draw(errors, blocks)  # type: ignore[arg-type]  # three bounds, three errors
