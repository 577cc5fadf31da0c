"""What vectors of worlds have in common: actions, rewards, ends and infos as arrays of worlds."""

from __future__ import annotations

from typing import Any, Dict, Iterator, List, Sequence, Tuple, Union, overload

import numpy as np
from numpy.typing import NDArray

from .backend import Array
from .env import Info, Task, Transition
from .errors import InvalidAction

Mask = NDArray[np.bool_]
Columns = Dict[str, NDArray[Any]]
"""Arrays whose first axis is that of the worlds, by key of `info`."""


class Infos(Sequence[Info]):
    """The infos of all worlds. `columns` are arrays of worlds; `infos[i]` is the dict of a world, made when it is asked for."""

    def __init__(self, columns: Columns, num_envs: int) -> None:
        self.columns = columns
        self._dicts: List[Any] = [None] * num_envs

    def __len__(self) -> int:
        return len(self._dicts)

    @overload
    def __getitem__(self, world: int) -> Info: ...

    @overload
    def __getitem__(self, world: slice) -> List[Info]: ...

    def __getitem__(self, world: Union[int, slice]) -> Any:
        if isinstance(world, slice):
            return [self[i] for i in range(*world.indices(len(self)))]
        info = self._dicts[world]
        if info is None:
            info = self._dicts[world] = {key: column[world].tolist() for key, column in self.columns.items()}
        return info

    def __iter__(self) -> Iterator[Info]:
        rows = zip(*(column.tolist() for column in self.columns.values()))
        for i, row in enumerate(rows):
            if self._dicts[i] is None:
                self._dicts[i] = dict(zip(self.columns, row))
        return iter(self._dicts)

    def __repr__(self) -> str:
        return repr(list(self))


def checked(actions: Any, num_envs: int, size: int) -> Array:
    """(worlds x size) actions as numbers. Raises InvalidAction."""
    wanted = np.asarray(actions, dtype=np.float64)
    if wanted.shape != (num_envs, size) or not np.logical_and.reduce(np.isfinite(wanted), axis=None):
        raise InvalidAction(f"actions of the shape {wanted.shape}; expected {num_envs} x {size}, finite")
    return wanted


def judge(task: Task, step: Transition, num_envs: int) -> Tuple[Array, Mask, Columns]:
    """Rewards, whether episodes have ended, and what is told about them, by the array functions of a task."""
    columns = {key: _column(values) for key, values in task.info(step).items()}
    terminated, rewards = np.empty(num_envs, dtype=np.bool_), np.empty(num_envs)
    terminated[...] = task.terminated(step)
    rewards[...] = task.reward(step)
    return rewards, terminated, columns


def _column(values: Any) -> NDArray[Any]:
    """Numbers and truth values as they are, others as objects."""
    column: NDArray[Any] = np.asarray(values)
    return column if column.dtype.kind in "biufc" else column.astype(object)
