"""Arrays of states and commands as attributes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .parameters import PARAMETERS

NONE, FORCE, POSITION, VELOCITY = -1, 0, 1, 2
"""Kinds of commands."""
EFFORT = FORCE
"""What a force is called where a joint is driven."""
KINDS = "NONE (-1), FORCE or EFFORT (0), POSITION (1) or VELOCITY (2)"


class Arrays:
    """What has arrays as attributes: assigning to one writes into it, as the simulator goes on to use the array itself."""

    def __setattr__(self, name: str, value: Any) -> None:
        array = self.__dict__.get(name)
        if not isinstance(array, np.ndarray):
            super().__setattr__(name, value)
        elif not array.flags.writeable:
            advice = "set_parameters changes it" if name in PARAMETERS else "it can't be assigned"
            raise AttributeError(f"{name} is what there is in the simulation; {advice}")
        elif value is not array:
            write(name, array, value)


def write(name: str, array: NDArray[Any], values: Any) -> None:
    """Writes `values` into an array of commands, or nothing if they are of another shape or can't be commands."""
    numbers = np.asarray(values)
    try:
        numbers = np.broadcast_to(numbers, array.shape)
    except ValueError:
        raise ValueError(f"{name}: expected {array.shape} numbers, not {numbers.shape}") from None
    if array.dtype == np.int8:
        wrong = numbers[(numbers != NONE) & (numbers != FORCE) & (numbers != POSITION) & (numbers != VELOCITY)]
        if wrong.size:
            raise ValueError(f"{name}: {wrong.flat[0]} is no kind of command; expected {KINDS}")
    elif not np.isfinite(numbers).all():
        raise ValueError(f"{name}: a command is not finite")
    elif "pose" in name and not numbers[..., 3:].any(axis=-1).all():
        raise ValueError(f"{name}: a quaternion (x, y, z, w) is zero, which is no orientation")
    array[...] = numbers
