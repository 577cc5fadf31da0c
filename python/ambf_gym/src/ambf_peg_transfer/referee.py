"""Counts the points of a peg transfer by the rules of the ICRA 2026 competition.

* All blocks go to the other side; when all are there, all go back, and so on. A point for each block that comes to rest on a peg of
  the side to which it is to go. Moves out of order don't count, a block counts once a way.
* Three minutes. Of two runs with the same points the better one is that whose last counted block stopped moving earlier.
* Drops and hand-offs are counted and cost nothing. A block at rest that no arm can reach ends the run.

The referee knows poses only, so that it judges alike in a process, in an environment and over ROS.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any, Dict, Mapping, NamedTuple, Optional, Set, Tuple

from .board import SYMMETRIC, Board

Vector = Tuple[float, float, float]

TIME_LIMIT = 180.0
"""s."""

REACH = 0.2998
"""Greatest distance of an instrument's control point (the axis of its wrist's yaw) from its base, m."""

TIP = (0.0, -0.009, 0.0)
"""Tips of the closed jaws in the frame of the tool's yaw link, m."""


class Pose(NamedTuple):
    """A body's frame in the world."""

    position: Tuple[float, float, float]
    """m."""
    rotation: Tuple[float, float, float, float]
    """Quaternion x, y, z, w."""


@dataclass(frozen=True)
class Rules:
    """Numbers by which a referee decides."""

    time_limit: float = TIME_LIMIT
    on_peg: float = 0.0032
    """A block is on a peg when the peg's axis is so near its own, m: 2.7 mm is the play towards its corners."""
    upright: float = math.radians(10.0)
    """Largest tilt of a block on a peg, rad."""
    low: float = 0.002
    """Largest height of a block's foot above the board, m. It rests at 0.2 mm."""
    lifted: float = 0.005
    """A foot that was higher was lifted, m."""
    still: float = 0.0003
    """A block that has not moved further than this, m, for `pause` is at rest."""
    still_angle: float = math.radians(1.0)
    """The same of its rotation, rad."""
    pause: float = 0.25
    """s."""
    held_radius: float = 0.0105
    """A lifted block is held by the arm whose tips are within this distance of its axis, m, and between its feet and its top."""
    held_height: float = 0.018
    reach: float = REACH
    block_height: float = 0.015
    """The jaws hold a block up to so far above its feet, m."""


@dataclass
class Score:
    """How a run stands."""

    time: float = 0.0
    """Since the start, s."""
    points: int = 0
    last_point: float = math.inf
    """When the last counted block stopped moving, s since the start; infinite without points."""
    way: int = 0
    """0: there, 1: back, 2: there again, …"""
    counted: Set[str] = field(default_factory=set)
    """Blocks that have their point of this way."""
    on_peg: Dict[str, Optional[str]] = field(default_factory=dict)
    """By block: the peg on which it rests; None: on none, or it moves."""
    holders: Dict[str, Optional[str]] = field(default_factory=dict)
    """By block: the arm that holds it, where it is one alone."""
    drops: int = 0
    hand_offs: int = 0
    is_over: bool = False
    reason: str = ""
    """Why it is over."""

    def rank(self) -> Tuple[int, float]:
        """Smaller is better."""
        return -self.points, self.last_point

    def as_dict(self) -> Dict[str, Any]:
        """For JSON and for `info`: an infinite time is None."""
        values = asdict(self)
        values["counted"] = sorted(self.counted)
        values["last_point"] = None if math.isinf(self.last_point) else self.last_point
        return values


@dataclass
class _Watched:
    """A block."""

    anchor: Pose
    since: float
    """When it was at the anchor first."""
    side: int = 0
    """The side on which it was at rest first; 0: on none yet."""
    was_lifted: bool = False
    last_holder: Optional[str] = None


class Referee:
    """Judges one run after the other."""

    def __init__(self, board: Board = SYMMETRIC, rules: Optional[Rules] = None) -> None:
        """Rules: those of the competition."""
        self.board = board
        self.rules = rules or Rules()
        self.score = Score()
        self._begin: Optional[float] = None
        self._blocks: Dict[str, _Watched] = {}

    def reset(self) -> None:
        """A new run begins with the next update."""
        self.score = Score()
        self._begin = None
        self._blocks = {}

    def update(
        self,
        time: float,
        blocks: Mapping[str, Pose],
        tools: Optional[Mapping[str, Pose]] = None,
        bases: Optional[Mapping[str, Pose]] = None,
        board: Optional[Pose] = None,
    ) -> Score:
        """Looks at a state. `time`: s, of any clock that goes on; the run begins with the first one. `tools`: by arm, its tool's yaw
        link, for hand-offs; `bases`: by arm, its base, for blocks out of reach; `board`: where the board is, if it was moved.

        Raises KeyError if a block is missing. A score that is over no longer changes, but for its time.
        """
        if self._begin is None:
            self._begin = time
        now = time - self._begin
        score = self.score
        if score.is_over:
            return score
        score.time = now
        poses = {name: self._on_board(blocks[name], board) for name in self.board.blocks}
        resting = {name: self._look(name, pose, now) for name, pose in poses.items()}
        for name, pose in poses.items():
            self._hold(name, blocks[name], pose, resting[name], tools or {})
        if now > self.rules.time_limit:
            score.is_over, score.reason = True, "time"
            return score
        self._count(resting)
        if bases:
            self._check_reach(blocks, poses, bases, now)
        return score

    # --- a block ------------------------------------------------------------------------------------------------------------------

    def _on_board(self, pose: Pose, moved: Optional[Pose]) -> Pose:
        """Where it would be if the board stood where the scene has it."""
        if moved is None:
            return pose
        home = Pose(self.board.position, self.board.rotation)
        turn = _times(home.rotation, _conjugate(moved.rotation))
        apart = _rotate(turn, _minus(pose.position, moved.position))
        return Pose(_plus(home.position, apart), _times(turn, pose.rotation))

    def _look(self, name: str, pose: Pose, now: float) -> Optional[str]:
        """The peg on which it rests."""
        rules = self.rules
        seen = self._blocks.get(name)
        if seen is None:
            seen = self._blocks[name] = _Watched(pose, now)
        moved = math.dist(seen.anchor.position, pose.position)
        if moved > rules.still or _angle(seen.anchor.rotation, pose.rotation) > rules.still_angle:
            seen.anchor, seen.since = pose, now
        if self._height(pose) > rules.lifted:
            seen.was_lifted = True
        is_still = now - seen.since >= rules.pause
        peg = self._peg(pose) if is_still else None
        if is_still and seen.was_lifted and self._height(pose) < rules.lifted:
            seen.was_lifted = False
            self.score.drops += peg is None
        if is_still and seen.side == 0:
            seen.side = 1 if pose.position[0] > self.board.middle else -1
        self.score.on_peg[name] = peg
        return peg

    def _height(self, pose: Pose) -> float:
        return pose.position[2] - self.board.top

    def _peg(self, pose: Pose) -> Optional[str]:
        rules = self.rules
        up = _rotate(pose.rotation, (0.0, 0.0, 1.0))
        if up[2] < math.cos(rules.upright) or not -rules.low < self._height(pose) < rules.low:
            return None
        x, y, _ = pose.position
        near = {peg: math.hypot(x - at[0], y - at[1]) for peg, at in self.board.pegs.items()}
        peg = min(near, key=lambda name: near[name])
        return peg if near[peg] < rules.on_peg else None

    def _hold(self, name: str, pose: Pose, on_board: Pose, peg: Optional[str], tools: Mapping[str, Pose]) -> None:
        """Who holds it; a hand-off is another holder before it is put down."""
        rules, seen = self.rules, self._blocks[name]
        near = set()
        if self._height(on_board) > rules.lifted:
            for arm, tool in tools.items():
                tip = _plus(tool.position, _rotate(tool.rotation, TIP))
                x, y, z = _rotate(_conjugate(pose.rotation), _minus(tip, pose.position))
                if math.hypot(x, y) < rules.held_radius and -0.003 < z < rules.held_height:
                    near.add(arm)
        holder = next(iter(near)) if len(near) == 1 else None
        self.score.holders[name] = holder
        if peg is not None or (not near and self._height(on_board) < rules.lifted):
            seen.last_holder = None
        elif holder is not None:
            self.score.hand_offs += seen.last_holder not in (None, holder)
            seen.last_holder = holder

    # --- the run ------------------------------------------------------------------------------------------------------------------

    def _count(self, resting: Mapping[str, Optional[str]]) -> None:
        score = self.score
        there = set()
        for name, peg in resting.items():
            seen = self._blocks[name]
            target = -seen.side if score.way % 2 == 0 else seen.side
            if peg is None or seen.side == 0 or self.board.side(peg) != target:
                continue
            there.add(name)
            if name not in score.counted:
                score.counted.add(name)
                score.points += 1
                score.last_point = seen.since
        if there == set(self.board.blocks):
            score.way += 1
            score.counted = set()

    def _check_reach(
        self, blocks: Mapping[str, Pose], on_board: Mapping[str, Pose], bases: Mapping[str, Pose], now: float
    ) -> None:
        """Jaws that point at it from above hold a block somewhere between its feet and its top: its top is what counts."""
        for name in on_board:
            pose, seen = blocks[name], self._blocks[name]
            top = _plus(pose.position, _rotate(pose.rotation, (0.0, 0.0, self.rules.block_height)))
            # The control point stays behind the tips.
            far = min(math.dist(base.position, top) for base in bases.values()) + TIP[1]
            if now - seen.since >= self.rules.pause and far > self.rules.reach:
                self.score.is_over, self.score.reason = True, f"{name} is out of reach"


# --- rotations, quaternions x, y, z, w --------------------------------------------------------------------------------------------

Quaternion = Tuple[float, float, float, float]


def _plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _conjugate(q: Quaternion) -> Quaternion:
    return -q[0], -q[1], -q[2], q[3]


def _times(a: Quaternion, b: Quaternion) -> Quaternion:
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def _rotate(q: Quaternion, v: Vector) -> Vector:
    x, y, z, _ = _times(_times(q, (v[0], v[1], v[2], 0.0)), _conjugate(q))
    return x, y, z


def _angle(a: Quaternion, b: Quaternion) -> float:
    dot = abs(sum(p * q for p, q in zip(a, b)))
    return 2.0 * math.acos(min(1.0, dot))
