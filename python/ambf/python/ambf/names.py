"""Finds things by their names."""

from __future__ import annotations

import difflib
from typing import Callable, Sequence, Tuple, Union

from .errors import NotFoundError


def find(name: Union[str, int], names: Sequence[str], what: str) -> int:
    """The index of what has that name, else of the only one whose name ends with it after a slash, else contains it.

    Raises NotFoundError.
    """
    if not isinstance(name, str):
        if not 0 <= name < len(names):
            listed = f"{len(names)} (0 to {len(names) - 1})" if names else "none"
            raise NotFoundError(f"there is no number {name} of the {what}: there are {listed}")
        return int(name)
    if not names:
        raise NotFoundError(f'"{name}" is not there: there are no {what}')
    end = name if name.startswith("/") else f"/{name}"
    fits: Tuple[Callable[[str], bool], ...] = (
        name.__eq__,
        lambda other: other.endswith(end),
        lambda other: name in other,
    )
    for is_meant in fits:
        found = [index for index, other in enumerate(names) if is_meant(other)]
        if len(found) == 1:
            return found[0]
        if found:
            raise NotFoundError(
                f'"{name}" is the name or part of the name of several {what}: {", ".join(names[i] for i in found)}'
            )
    near = difflib.get_close_matches(name, [other.rsplit("/", 1)[-1] for other in names], 3)
    hint = f"; near it: {', '.join(near)}" if near else ""
    raise NotFoundError(f'"{name}" is the name or part of the name of none of the {what}{hint}')


def place(name: str, names: Sequence[str], what: str) -> int:
    """The index of what has exactly that name. Raises NotFoundError."""
    if name not in names:
        raise NotFoundError(f'"{name}" is not there any more: it is none of the {what}')
    return names.index(name)
