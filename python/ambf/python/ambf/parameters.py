"""What scenes are made of, as arrays: masses, surfaces, limits, gains."""

from __future__ import annotations

from typing import Any, Dict, Mapping, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from .names import find

Array = NDArray[np.float64]

_OF_BODIES: Dict[str, Tuple[int, ...]] = {
    "masses": (),
    "inertias": (3,),
    "frictions": (),
    "restitutions": (),
    "dampings": (2,),
    "gravities": (3,),
    "body_gains": (4,),
}
_OF_JOINTS: Dict[str, Tuple[int, ...]] = {
    "joint_limits": (2,),
    "joint_dampings": (),
    "joint_frictions": (),
    "joint_gains": (3,),
}
PARAMETERS = (*_OF_BODIES, *_OF_JOINTS, "gravity")
"""Names of those that can be seen."""
_SHAPES = {**_OF_BODIES, **_OF_JOINTS, "colors": (4,)}
"""Shape of each of a body or joint."""


def split_parameters(bodies: Array, joints: Array, gravity: Array, worlds: Tuple[int, ...] = ()) -> Dict[str, Array]:
    """The arrays by name; `worlds`: shape before that of the bodies and joints."""
    found = {"gravity": gravity.reshape(*worlds, 3).copy()}
    for shapes, numbers in ((_OF_BODIES, bodies), (_OF_JOINTS, joints)):
        width = sum(_size(shape) for shape in shapes.values())
        table = numbers.reshape(*worlds, -1, width)
        begin = 0
        for name, shape in shapes.items():
            part = table[..., begin : begin + _size(shape)]
            begin += _size(shape)
            found[name] = part.reshape(*part.shape[:-1], *shape).copy()
    return found


def parameter_array(name: str, values: Any, names: Sequence[str], worlds: Tuple[int, ...] = ()) -> Array:
    """Values of a parameter as an array, NaN where there are none. Values of a dict are those of all worlds, or one row a world.

    Raises ValueError, NotFoundError.
    """
    if name == "gravity":
        return _broadcast(name, values, (*worlds, 3))
    shape = _SHAPES[name]
    if not isinstance(values, Mapping):
        return _broadcast(name, values, (*worlds, len(names), *shape))
    array = np.full((*worlds, len(names), *shape), np.nan)
    what = "joints" if name.startswith("joint_") else "bodies"
    for key, value in values.items():
        place = find(key, names, what)
        # The world, if there are many, comes first.
        whole: Tuple[Any, ...] = tuple(slice(None) for _ in worlds)
        array[whole + (place,)] = _broadcast(f"{name} of {key}", value, (*worlds, *shape))  # noqa: RUF005  Python 3.10
    return array


def _broadcast(what: str, values: Any, shape: Tuple[int, ...]) -> Array:
    numbers = np.asarray(values, dtype=np.float64)
    try:
        return np.array(np.broadcast_to(numbers, shape))
    except ValueError:
        raise ValueError(f"{what}: expected {shape or 'one'} numbers, not {numbers.shape}") from None


def _size(shape: Tuple[int, ...]) -> int:
    return int(np.prod(shape, dtype=int))
