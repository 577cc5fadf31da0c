"""Says how a ring on the wire fares: how far it has come, and how often it has touched the wire.

It knows poses only, so that it judges alike in a process, in an environment and over ROS.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Dict, Optional

import numpy as np
from ambf_peg_transfer.arms import Array, matrix_of
from numpy.typing import ArrayLike

from . import wire

TIME_LIMIT = 120.0
"""s."""


@dataclass(frozen=True)
class Rules:
    """Numbers by which a judge decides."""

    time_limit: float = TIME_LIMIT
    end: float = wire.LENGTH - wire.GOAL - 0.001
    """A ring that has come so far along the wire is there, m."""
    touch: float = 0.0001
    """Surfaces that are nearer than this touch, m; a touch ends at twice that."""
    lost: float = 0.01
    """A ring whose middle is further from the tool's yaw link than it is when it is held, by this, was dropped, m."""


@dataclass
class Score:
    """How a run stands."""

    time: float = 0.0
    """Since the start, s."""
    along: float = 0.0
    """Where the ring is, along the wire from the left foot, m."""
    progress: float = 0.0
    """The farthest share of the way from start to end, 0 to 1."""
    touches: int = 0
    touch_time: float = 0.0
    """For how long it has touched, s."""
    drops: int = 0
    is_there: bool = False
    is_over: bool = False
    reason: str = ""
    """Why it is over."""

    def as_dict(self) -> Dict[str, Any]:
        """For JSON and for `info`."""
        return asdict(self)


class Judge:
    """Judges one run after the other."""

    def __init__(self, rules: Optional[Rules] = None) -> None:
        self.rules = rules or Rules()
        self.reset()

    def reset(self) -> None:
        """A new run begins with the next update."""
        self.score = Score()
        self._begin: Optional[float] = None
        self._start = 0.0
        self._last = 0.0
        self._held: Optional[float] = None
        self._touches = self._was_dropped = False

    def update(self, time: float, ring: ArrayLike, tool: Optional[ArrayLike] = None) -> Score:
        """Looks at a state. `time`: s, of any clock that goes on; the run begins with the first one. `ring`: pose of the ring
        (7: m, quaternion x, y, z, w, world); `tool`: position of the tool's yaw link, m, for drops. A score that is over no longer
        changes.
        """
        pose = np.asarray(ring, np.float64)
        centre, axes = pose[:3], matrix_of(pose[3:])
        score, rules = self.score, self.rules
        if self._begin is None:
            self._begin = self._last = time
            self._start = wire.nearest(centre).along
        if score.is_over:
            return score
        score.time = time - self._begin
        score.along = wire.nearest(centre).along
        share = (score.along - self._start) / (rules.end - self._start)
        score.progress = max(score.progress, min(1.0, share))
        self._look_for_touches(centre, axes, time)
        if tool is not None:
            self._look_for_drops(centre, np.asarray(tool, np.float64))
        if not wire.is_threaded(centre, axes):
            score.is_over, score.reason = True, "the ring is off the wire"
        elif score.along >= rules.end:
            score.is_there = score.is_over = True
            score.reason = "there"
        elif score.time > rules.time_limit:
            score.is_over, score.reason = True, "time"
        return score

    def _look_for_touches(self, centre: Array, axes: Array, time: float) -> None:
        gap = wire.clearance(centre, axes)
        touches = gap < self.rules.touch * (2.0 if self._touches else 1.0)
        self.score.touches += touches and not self._touches
        if touches:
            self.score.touch_time += time - self._last
        self._touches, self._last = touches, time

    def _look_for_drops(self, centre: Array, tool: Array) -> None:
        distance = float(np.linalg.norm(centre - tool))
        if self._held is None:
            self._held = distance
        is_dropped = distance > self._held + self.rules.lost
        self.score.drops += is_dropped and not self._was_dropped
        self._was_dropped = is_dropped
