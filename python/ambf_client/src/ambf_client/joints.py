"""What a body knows about the joints below it."""

from __future__ import annotations

from typing import Any, List, Optional, Sequence, Union

from .base_object import BaseObject, say

NameOrIndex = Union[str, int]


class JointStates(BaseObject):
    """Names and positions of the active joints below a body; their order is that of commands."""

    def get_num_joints(self) -> int:
        """Number of joints whose position is in the state."""
        self._wait_for_names()
        return len(self._state.joint_positions)

    def get_joint_names(self) -> List[str]:
        """Names of the joints."""
        self._wait_for_names()
        return self._state.joint_names  # type: ignore[no-any-return]

    def is_joint_idx_valid(self, joint_idx: int) -> bool:
        """Whether there is a joint `joint_idx`; says so if not."""
        there = 0 <= joint_idx < self.get_num_joints()
        if not there:
            say(f"{self._name}: there is no joint {joint_idx}, it has {self.get_num_joints()}")
        return there

    def get_joint_idx_from_name(self, joint_name: str) -> Optional[int]:
        """Index of a joint; None, and a line that says so, if there is none of that name."""
        names = self.get_joint_names()
        if joint_name in names:
            return names.index(joint_name)
        say(f'{self._name}: there is no joint "{joint_name}"; there are {", ".join(names) or "none"}')
        return None

    def get_joint_name_from_idx(self, joint_idx: int) -> Optional[str]:
        """Name of a joint; None if there is no such joint."""
        names = self.get_joint_names()
        return names[joint_idx] if self.is_joint_idx_valid(joint_idx) and joint_idx < len(names) else None

    def _index(self, name_or_idx: NameOrIndex) -> Optional[int]:
        """Index of a joint; None, and a line that says so, if there is none."""
        if isinstance(name_or_idx, str):
            return self.get_joint_idx_from_name(name_or_idx)
        index = int(name_or_idx)
        return index if self.is_joint_idx_valid(index) else None

    def _value(self, values: Sequence[float], name_or_idx: NameOrIndex) -> Optional[float]:
        index = self._index(name_or_idx)
        return float(values[index]) if index is not None and index < len(values) else None

    def get_joint_pos(self, joint_name_or_idx: NameOrIndex) -> Optional[float]:
        """Position of a joint, rad or m; None if there is no such joint."""
        return self._value(self._state.joint_positions, joint_name_or_idx)

    def get_all_joint_pos(self) -> Any:
        """Positions of all joints, rad or m."""
        return self._state.joint_positions
