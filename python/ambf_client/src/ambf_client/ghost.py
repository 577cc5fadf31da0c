"""Ghost objects: of this simulator only."""

from __future__ import annotations

from typing import List

from .legacy_object import Object


class GhostObject(Object):
    """A ghost object: where it is, what is inside it. Poses are commanded in the frame of its parent.

    It speaks with the messages of `Object`; of those commands, only the pose has an effect.
    """

    def __init__(self, a_name: str, time_out: float = 0.1) -> None:
        super().__init__(a_name, time_out)
        self.object_type = "GHOST_OBJECT"
        self.body_type = "KINEMATIC"

    def get_bodies_inside(self) -> List[str]:
        """Names of the bodies that are inside."""
        return list(self._state.children_names)
