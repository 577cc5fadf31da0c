"""A player that brings the blocks over and back by a script, in this process: no ROS, no pictures.

It is told where blocks and tools are, exactly, as a program is that subscribes to their States; joints have no errors. So its points say
what the scene, the grips and the time allow, not what a program can do that sees the board through the cameras.

It needs NumPy and the package `ambf`.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import contextlib
import functools
import itertools
import json
import math
import multiprocessing
from pathlib import Path
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple

import ambf
import numpy as np

from .arms import LOWER, UPPER, Array, about, forward, inverse, matrix_of, unlimited
from .board import SYMMETRIC, Board
from .referee import Pose, Referee, Score
from .seeds import draw

WALL = 0.004675
"""From the axis of a block to the middle of a wall, m."""
WALLS = (-math.pi / 2, math.pi / 6, 5 * math.pi / 6)
"""Directions of the walls in the frame of a block, rad."""
TOP = 0.01485
"""Of a block, above the origin of its frame, m."""
ABOVE = 0.0045
"""The fingers' hinge is so far above the top of the block that they hold, m."""
OPEN, CLOSED = 0.11, 0.0
"""Angles of a finger, rad: 0.7 mm from the wall that they are to take; inside the block there is room for 0.15 beside a peg."""
ROOM = -0.0006
"""A block that stands off its peg's axis by less than this, towards the wall, leaves room for a finger between wall and peg, m."""
APART = 0.0065
"""Hinges of both arms' fingers are so far apart across the board where a block changes hands, m."""
SLIPPED = 0.004
"""A block that has moved in the jaws by more was lost, m."""
HELD = 0.03
"""A block whose origin is nearer to the tool's is between its jaws, m."""
ALIGNED = (0.0004, 0.02)
"""So near to where it is to be is near enough before a block goes down, m and rad."""
LIFT = 0.035
"""A block is carried so far above the board, m: pegs are 20 mm high."""
MEETING = np.array([0.0194, 0.306, 0.775])
"""Where blocks change hands: in front of the wall."""
ASIDE = 0.045
"""Tools and blocks go round the near end of the wall, so far from its plane, m."""
TURNS = (0.0, 0.3, -0.3, 0.6, -0.6, 1.0, -1.0)
"""By how much a block may be turned on a way, rad."""
SPEED, TURN = 0.05, 1.2
"""m/s, rad/s."""
SLOW = 0.01
"""Joints that are slower stand still, rad/s and m/s."""
MARKS = ("<!-- player: begin -->\n", "<!-- player: end -->\n")
"""Between these a page has the table of runs."""
TICK = 0.01
"""Set points follow each other in such intervals, s."""


class Failed(Exception):
    """Error when there is no way to do what is wanted."""


class Place(NamedTuple):
    """A frame in the world."""

    position: Array
    axes: Array

    def times(self, other: Place) -> Place:
        """`other`, seen from this one, in the world."""
        return Place(self.position + self.axes @ other.position, self.axes @ other.axes)

    def inverse(self) -> Place:
        """The world, seen from it."""
        return Place(-self.axes.T @ self.position, self.axes.T)


def place_of(pose: Array) -> Place:
    """Of an array of positions and a quaternion."""
    return Place(np.array(pose[:3]), matrix_of(pose[3:]))


def upright(position: Array, turn: float) -> Place:
    """A block that stands."""
    return Place(np.array(position, np.float64), about(2, turn))


class Grip(NamedTuple):
    """How jaws hold a block: which wall, and which of both ways round."""

    wall: int
    turned: bool

    def tool(self, block: Place) -> Place:
        """The tool's yaw link, for a block at `block`: fingers down, on both sides of the wall."""
        angle = WALLS[self.wall]
        out = np.array([math.cos(angle), math.sin(angle), 0.0])
        x = -out if self.turned else out
        up = np.array([0.0, 0.0, 1.0])
        axes = np.column_stack((x, up, np.cross(x, up)))
        return block.times(Place(WALL * out + (TOP + ABOVE) * up, axes))


GRIPS = [Grip(wall, turned) for wall in range(3) for turned in (False, True)]


class Arm:
    """One arm through its CRTK topics: what it is told, and where it is.

    Errors of its first joints are seen by the tool's State, as a camera would see them, and taken off what it is told.
    """

    def __init__(self, simulation: ambf.Simulation, name: str) -> None:
        self.name = name
        self._client = simulation.arm(name)
        self._base = simulation.body(f"{name}/baselink")
        self._tool = simulation.body(f"{name}/toolyawlink")
        self.base = place_of(self._base.pose)
        self._world = self.base.inverse()
        self.goal: Array = np.zeros(6)
        self.errors: Array = np.zeros(6)
        self.jaw = OPEN
        self.send()

    def send(self) -> None:
        """Publishes the set points."""
        self._client.send("servo_jp", self.goal - self.errors)
        self._client.send("jaw/servo_jp", [self.jaw])

    def look(self) -> None:
        """Compares what the joints say with where the tool is, while they are slow: States are an iteration older."""
        joints = self._client.joints("measured_js")
        if np.abs(joints.velocity).max() > SLOW:
            return
        seen = self._world.times(self.tool)
        q = unlimited(seen.position, seen.axes)
        if q is not None:
            self.errors[:3] = (q - joints.position)[:3]

    @property
    def measured(self) -> Array:
        """What the joints say, rad and m."""
        return self._client.joints("measured_js").position

    def solve(self, tool: Place) -> Optional[Array]:
        """Joints for a place of the tool; None: out of reach, or beyond limits."""
        seen = self._world.times(tool)
        return inverse(seen.position, seen.axes)

    def margin(self, tool: Place) -> float:
        """How far the joints are from their limits there, as a share of their ranges; negative: it can't go there."""
        q = self.solve(tool)
        return -1.0 if q is None else float(np.min(np.minimum(UPPER - q, q - LOWER) / (UPPER - LOWER)))

    @property
    def commanded(self) -> Place:
        """Where the tool is to be."""
        return self.base.times(Place(*forward(self.goal)))

    @property
    def tool(self) -> Place:
        """Where it is."""
        return place_of(self._tool.pose)

    @property
    def lag(self) -> float:
        """How far the worst of the joints is from its set point, rad or m."""
        return float(np.abs(self.measured + self.errors - self.goal).max())


class Player:
    """Plays in a simulation of the peg-transfer scene, and lets a referee watch."""

    def __init__(self, simulation: ambf.Simulation, step: float, board: Board = SYMMETRIC) -> None:
        """`step`: interval of an iteration of the simulation, s."""
        self.simulation = simulation
        self.board = board
        self.referee = Referee(board)
        self._steps = max(1, round(TICK / step))
        self.arms = {1: Arm(simulation, "psm1"), -1: Arm(simulation, "psm2")}
        """By the side on which each works: 1 left, -1 right."""
        self._blocks = {name: simulation.body(name) for name in board.blocks}
        self.holder: Optional[Tuple[Arm, str]] = None
        """Which arm holds which block, as far as the player knows."""
        self.refused: Set[Tuple[str, Grip]] = set()
        """Grips by which a block was not taken: others are tried."""

    # --- time ---------------------------------------------------------------------------------------------------------------------

    def tick(self) -> Score:
        """Lets a tick pass."""
        for arm in self.arms.values():
            arm.send()
        self.simulation.step(self._steps)
        for arm in self.arms.values():
            arm.look()

        def pose(array: Array) -> Pose:
            values = array.tolist()
            return Pose(tuple(values[:3]), tuple(values[3:]))

        blocks = {name: pose(body.pose) for name, body in self._blocks.items()}
        tools = {arm.name: pose(arm._tool.pose) for arm in self.arms.values()}
        bases = {arm.name: pose(arm._base.pose) for arm in self.arms.values()}
        return self.referee.update(self.simulation.sim_time, blocks, tools, bases)

    def wait(self, seconds: float) -> None:
        """Lets time pass."""
        for _ in range(round(seconds / TICK)):
            self.tick()

    def settle(self, arm: Arm, within: float = 5e-4, most: float = 1.5) -> None:
        """Waits until an arm is where it is to be, `most` s at most."""
        for _ in range(round(most / TICK)):
            if arm.lag < within:
                return
            self.tick()

    # --- motion -------------------------------------------------------------------------------------------------------------------

    def line(self, arm: Arm, goal: Place) -> None:
        """Moves a tool on a straight line, smoothly. Raises Failed."""
        begin = arm.commanded
        turn = _rotation_vector(goal.axes @ begin.axes.T)
        way = goal.position - begin.position
        seconds = 1.5 * max(float(np.linalg.norm(way)) / SPEED, float(np.linalg.norm(turn)) / TURN, TICK)
        count = math.ceil(seconds / TICK)
        for i in range(1, count + 1):
            share = i / count
            share = share * share * (3.0 - 2.0 * share)
            q = arm.solve(Place(begin.position + share * way, _rotated(share * turn) @ begin.axes))
            if q is None:
                raise Failed(f"{arm.name}: out of reach on the way")
            arm.goal = q
            self.tick()
        self.settle(arm)

    def joints(self, arm: Arm, goal: Array) -> None:
        """Moves all joints at once, smoothly, roll the shorter way."""
        begin = arm.goal
        seconds = 1.5 * max(
            float(np.abs(goal - begin)[[0, 1, 3, 4, 5]].max()) / TURN, abs(goal[2] - begin[2]) / SPEED, TICK
        )
        count = math.ceil(seconds / TICK)
        for i in range(1, count + 1):
            share = i / count
            share = share * share * (3.0 - 2.0 * share)
            arm.goal = begin + share * (goal - begin)
            self.tick()
        self.settle(arm)

    def set_jaw(self, arm: Arm, angle: float) -> None:
        """Opens or closes at 0.5 rad/s."""
        begin = arm.jaw
        if angle == begin:
            return
        count = max(1, math.ceil(abs(angle - begin) / 0.5 / TICK))
        for i in range(1, count + 1):
            arm.jaw = begin + (angle - begin) * i / count
            self.tick()
        self.wait(0.3)

    # --- a transfer ---------------------------------------------------------------------------------------------------------------

    def block(self, name: str) -> Place:
        """Where a block is."""
        return place_of(self._blocks[name].pose)

    def transfer(self, name: str, peg: str) -> None:
        """Brings a block to a peg of the other side. Raises Failed; whoever has the block then holds it, as `holder` says."""
        block = self.block(name)
        side = self.side_of(name)
        giver, taker = self.arms[side], self.arms[-side]
        grips = self._plan(block, side, peg, name)
        if grips is None:
            raise Failed(f"no way to bring {name} to {peg}")
        give, take, turn, target = grips
        up = np.array([0.0, 0.0, LIFT])
        # Fetch it.
        self._fetch(giver, name, give)
        # To the meeting, round the near end of the wall.
        meeting = upright(MEETING, turn)
        for goal in self._way(block, side, meeting)[2:]:
            self._carry(giver, name, goal)
        self._align(giver, name, meeting)
        # Both hold it, then the other one alone.
        grip = take.tool(self.block(name))
        over = Place(grip.position + 0.8 * up, grip.axes)
        self.set_jaw(taker, OPEN)
        self._approach(taker, over)
        self.line(taker, grip)
        self.set_jaw(taker, CLOSED)
        self.set_jaw(giver, OPEN)
        self.holder = (taker, name)
        away = giver.commanded
        self.line(giver, Place(away.position + 0.8 * up, away.axes))
        self.line(giver, Place(away.position + 0.8 * up + np.array([side * ASIDE, 0.0, 0.0]), away.axes))
        # To the peg.
        way = self._way(target, -side, meeting)
        for goal in way[-2:0:-1]:
            self._carry(taker, name, goal)
        self._put(taker, name, target)

    def _fetch(self, arm: Arm, name: str, how: Grip) -> None:
        """Takes a block that stands, and lifts it."""
        block = self.block(name)
        grip, up = how.tool(block), np.array([0.0, 0.0, LIFT])
        self.set_jaw(arm, OPEN)
        self._approach(arm, Place(grip.position + up, grip.axes))
        self.line(arm, grip)
        self.set_jaw(arm, CLOSED)
        self.holder = (arm, name)
        self.line(arm, Place(grip.position + up, grip.axes))
        if self.block(name).position[2] < block.position[2] + 0.5 * LIFT:
            self.refused.add((name, how))
            raise Failed(f"{arm.name} has not got {name}")

    def _carry(self, arm: Arm, name: str, goal: Place) -> None:
        """Moves a block that an arm holds on a straight line: the jaws have it as they have it now."""
        held = self.block(name).inverse().times(arm.tool)
        self.line(arm, goal.times(held))
        now = self.block(name).inverse().times(arm.tool)
        if float(np.linalg.norm(now.position - held.position)) > SLIPPED:
            self.holder = None
            raise Failed(f"{arm.name} has lost {name}")

    def _align(self, arm: Arm, name: str, goal: Place) -> None:
        """Brings a held block to where it is to be, whatever it has slipped on its way."""
        for _ in range(3):
            block = self.block(name)
            away = float(np.linalg.norm(block.position - goal.position))
            turned = float(np.linalg.norm(_rotation_vector(goal.axes @ block.axes.T)))
            if away < ALIGNED[0] and turned < ALIGNED[1]:
                return
            self._carry(arm, name, goal)

    def _put(self, arm: Arm, name: str, target: Place) -> None:
        """Puts a held block that is above a peg onto it, and goes up."""
        self._align(arm, name, _moved(target, z=LIFT))
        self._carry(arm, name, target)
        self.set_jaw(arm, OPEN)
        self.holder = None
        away = arm.commanded
        self.line(arm, Place(away.position + np.array([0.0, 0.0, LIFT]), away.axes))
        self.wait(0.3)

    def _put_back(self) -> None:
        """Puts a block that is still held after a failure onto a peg of the arm's own side. Raises Failed."""
        if self.holder is None:
            return
        arm, name = self.holder
        side = 1 if arm is self.arms[1] else -1
        block = self.block(name)
        held = block.inverse().times(arm.tool)
        if float(np.linalg.norm(arm.tool.position - block.position)) > HELD or block.axes[2, 2] < 0.9:
            self.holder = None
            return
        yaw = math.atan2(block.axes[1, 0], block.axes[0, 0])
        for peg, turn in itertools.product(self.free_pegs(side), TURNS):
            target = upright(np.array([*self.board.pegs[peg], self.board.top + 0.001]), yaw + turn)
            way = self._way(target, side, Place(block.position, target.axes))
            if all(arm.margin(goal.times(held)) > 0.0 for goal in way):
                for goal in way[-2:0:-1]:
                    self._carry(arm, name, goal)
                self._put(arm, name, target)
                return
        raise Failed(f"{arm.name} can't put {name} back")

    def side_of(self, name: str) -> int:
        """The side on which a block is: 1 left, -1 right."""
        return 1 if self.block(name).position[0] > self.board.middle else -1

    def _way(self, peg: Place, side: int, meeting: Place) -> List[Place]:
        """Places of a block on its way from where it stands to the meeting: up, aside, turned there, and in front of the wall."""
        over = peg.position + np.array([0.0, 0.0, LIFT])
        aside = np.array([self.board.middle + side * ASIDE, meeting.position[1], over[2]])
        return [peg, Place(over, peg.axes), Place(aside, peg.axes), Place(aside, meeting.axes), meeting]

    def _approach(self, arm: Arm, goal: Place) -> None:
        """Comes from its own side and from above."""
        q = arm.solve(goal)
        if q is None:
            raise Failed(f"{arm.name}: out of reach")
        here = arm.commanded
        side = 1 if arm is self.arms[1] else -1
        if abs(goal.position[0] - self.board.middle) < ASIDE:
            # To the meeting: from aside.
            aside = Place(goal.position + np.array([side * ASIDE, 0.0, 0.0]), goal.axes)
            begin = arm.solve(aside)
            if begin is None:
                raise Failed(f"{arm.name}: out of reach")
            self.joints(arm, begin)
            self.line(arm, goal)
            return
        high = np.array([0.0, 0.0, max(0.0, goal.position[2] - here.position[2])])
        raised = arm.solve(Place(here.position + high, here.axes))
        if raised is not None:
            self.line(arm, Place(here.position + high, here.axes))
        self.joints(arm, q)

    def _plan(self, block: Place, side: int, peg: str, name: str = "") -> Optional[Tuple[Grip, Grip, float, Place]]:
        """How the giver and the taker hold it, how it is turned at the meeting, and where and how it is to stand: those by which the
        joints stay furthest from their limits, and the block turns little while it is held.
        """
        giver, taker = self.arms[side], self.arms[-side]
        height = self.board.top + 0.001  # 0.8 mm above where it comes to rest
        stand = np.array([*self.board.pegs[peg], height])
        best: Tuple[float, Any] = (-0.2, None)
        yaw = math.atan2(block.axes[1, 0], block.axes[0, 0])

        @functools.cache
        def put(grip: Grip, turn: float) -> float:
            target = upright(stand, turn)
            return min(taker.margin(grip.tool(place)) for place in (target, _moved(target, z=LIFT)))

        # A grip that did not take it, or without room beside the peg, comes last.
        def doubt(grip: Grip) -> float:
            angle = WALLS[grip.wall]
            out = block.axes @ np.array([math.cos(angle), math.sin(angle), 0.0])
            near = min(self.board.pegs.values(), key=lambda at: math.dist(at, block.position[:2]))
            room = float(out[:2] @ (block.position[:2] - near))
            return 0.1 * ((name, grip) in self.refused) + 0.1 * (room < ROOM)

        fetch = {
            grip: min(giver.margin(grip.tool(place)) for place in (block, _moved(block, z=LIFT))) - doubt(grip)
            for grip in GRIPS
        }
        for turned, (give, take) in itertools.product(TURNS, itertools.permutations(GRIPS, 2)):
            meeting = upright(MEETING, yaw + turned)
            mine, other = give.tool(meeting), take.tool(meeting)
            if give.wall == take.wall or (mine.position[0] - other.position[0]) * side < APART:
                continue
            here = min(
                fetch[give],
                giver.margin(mine),
                taker.margin(other),
                giver.margin(_moved(mine, x=side * ASIDE)),
                taker.margin(_moved(other, x=-side * ASIDE, z=0.8 * LIFT)),
            )
            for again in TURNS:
                value = min(here, put(take, yaw + turned + again)) - 0.05 * (abs(turned) + abs(again))
                if value <= best[0]:
                    continue
                target = upright(stand, yaw + turned + again)
                there, away = self._way(block, side, meeting), self._way(target, -side, meeting)
                least = min(_margin(giver, give, there), _margin(taker, take, away))
                if least > 0.02:
                    best = (value, (give, take, yaw + turned, target))
        return best[1]  # type: ignore[no-any-return]

    # --- a run --------------------------------------------------------------------------------------------------------------------

    def free_pegs(self, side: int) -> Iterator[str]:
        """Pegs of a side on which nothing stands, those near the cameras and the wall first: they are easiest to reach."""
        taken = [self.block(name).position[:2] for name in self._blocks]
        pegs = [peg for peg in self.board.pegs if self.board.side(peg) == side]
        near = lambda peg: abs(self.board.pegs[peg][0] - self.board.middle) - self.board.pegs[peg][1]  # noqa: E731
        for peg in sorted(pegs, key=near):
            if all(math.dist(self.board.pegs[peg], place) > 0.015 for place in taken):
                yield peg

    def _bring(self, name: str) -> None:
        """Brings a block over to the first peg to which there is a way. Raises Failed."""
        side = self.side_of(name)
        for peg in self.free_pegs(-side):
            if self._plan(self.block(name), side, peg, name) is not None:
                self.transfer(name, peg)
                return
        raise Failed(f"{name} can't be brought over")

    def _recover(self, verbose: bool) -> None:
        """After a failure: what is held is put back, and the arms go out of the way."""
        try:
            self._put_back()
        except Failed as error:
            if verbose:
                print(f"{self.referee.score.time:6.1f} s: {error}")
        self.holder = None
        for side, arm in self.arms.items():
            self.set_jaw(arm, OPEN)
            here = arm.commanded
            for away in ((0.0, LIFT), (side * ASIDE, LIFT)):
                goal = Place(here.position + np.array([away[0], 0.0, away[1]]), here.axes)
                if arm.solve(goal) is not None:
                    with contextlib.suppress(Failed):
                        self.line(arm, goal)

    def play(self, ways: int = 2, verbose: bool = False) -> Score:
        """All blocks over and back, `ways` ways, or until the run is over."""
        self.wait(1.0)
        score = self.referee.score
        while not score.is_over and score.way < ways:
            self.tick()
            # Those without their point; then those that have been moved away again.
            waiting = [name for name in self._blocks if name not in score.counted]
            for name in waiting or [name for name in self._blocks if score.on_peg.get(name) is None]:
                try:
                    self._bring(name)
                except Failed as error:
                    if verbose:
                        print(f"{score.time:6.1f} s: {error}")
                    self._recover(verbose)
                if verbose:
                    print(f"{score.time:6.1f} s: {name}: {score.points} points, {score.on_peg}")
        return score


def _moved(place: Place, x: float = 0.0, z: float = 0.0) -> Place:
    """Along axes of the world, m."""
    return Place(place.position + np.array([x, 0.0, z]), place.axes)


def _margin(arm: Arm, grip: Grip, places: Sequence[Place]) -> float:
    """The least margin of an arm that carries a block from place to place."""
    least = 1.0
    for begin, end in zip(places, places[1:]):
        turn = _rotation_vector(end.axes @ begin.axes.T)
        for share in (0.2, 0.4, 0.6, 0.8, 1.0):
            place = Place(begin.position + share * (end.position - begin.position), _rotated(share * turn) @ begin.axes)
            least = min(least, arm.margin(grip.tool(place)))
    return least


def _rotation_vector(matrix: Array) -> Array:
    """Axis times angle, rad."""
    cosine = max(-1.0, min(1.0, (float(np.trace(matrix)) - 1.0) / 2.0))
    angle = math.acos(cosine)
    twice = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    if angle > 3.0:
        # Near half a turn the axis is in the symmetric part.
        values, vectors = np.linalg.eigh((matrix + matrix.T) / 2.0)
        axis: Array = vectors[:, int(np.argmax(values))]
        return axis * (angle if axis @ twice >= 0.0 else -angle)
    vector: Array = twice / 2.0 if angle < 1e-9 else twice * angle / (2.0 * math.sin(angle))
    return vector


def _rotated(vector: Array) -> Array:
    """The rotation by a vector of axis times angle, rad (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix: Array = np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
    return matrix


def scene(
    resources: Path,
    seed: Optional[int],
    profile: str = "accurate",
    step: float = 0.005,
    ghosts: bool = False,
    errors: bool = False,
) -> ambf.Simulation:
    """The scene, with its arms for CRTK clients and the blocks where the seed puts them. Without `ghosts`, which take the weight of
    what is between jaws, friction alone holds the blocks. `errors`: joints have the errors of the seed, too.
    """
    folder = resources / "peg_transfer"
    models = [0, 1, 2, 3, 4, 5] if ghosts else [0, 1, 2, 4]
    simulation = ambf.Simulation(
        launch_file=folder / "launch.yaml",
        indexes=models,
        profile=profile,
        step=step,
        crtk=[folder / "crtk.yaml"],
        seed=seed if errors else None,
    )
    if seed is not None and not errors:
        place_blocks(simulation, seed)
    return simulation


def place_blocks(simulation: ambf.Simulation, seed: int, board: Board = SYMMETRIC) -> None:
    """Puts the blocks where the seed puts them; they were where the file has them."""
    poses: Dict[Any, Any] = {}
    for name, (peg, turn) in draw(seed, board).blocks.items():
        body = simulation.body(name)
        z, start = float(body.pose[2]), np.array(body.pose[3:])
        half = turn / 2.0
        s, c = math.sin(half), math.cos(half)
        x0, y0, z0, w0 = start
        # A turn about the world's z before what the file says.
        rotated = (c * x0 - s * y0, c * y0 + s * x0, c * z0 + s * w0, c * w0 - s * z0)
        poses[body.name] = (*board.pegs[peg], z, *rotated)
    simulation.set_state(poses=poses)


def run(seed: int, options: argparse.Namespace) -> Score:
    """A run with a seed."""
    from ambf_gym.scene import resources

    simulation = scene(resources(), seed, options.profile, options.step, options.ghosts, options.errors)
    score = Player(simulation, options.step).play(options.ways, options.verbose)
    simulation.close()
    return score


def table(rows: Dict[str, List[Score]], most: int) -> str:
    """Runs with many seeds; a row for each kind of them. `most`: points that there are."""
    points = range(most, -1, -1)
    head = (
        f"| | runs | {' | '.join(f'{count} points' for count in points)} | last point, median, s | drops | hand-offs |"
    )
    lines = [head, "|---|--:" + "|--:" * (most + 4) + "|"]
    for name, scores in rows.items():
        counts = [sum(score.points == count for score in scores) for count in points]
        times = [score.last_point for score in scores if score.points == most]
        last = f"{np.median(times):.0f}" if times else "–"
        sums = sum(score.drops for score in scores), sum(score.hand_offs for score in scores)
        lines.append(f"| {name} | {len(scores)} | {' | '.join(map(str, counts))} | {last} | {sums[0]} | {sums[1]} |")
    return "\n".join(lines) + "\n"


def main(arguments: Optional[Sequence[str]] = None) -> None:
    """Plays runs with several seeds; prints a line of JSON for each and, with --table, how many have which points."""
    parser = argparse.ArgumentParser(description="Plays the peg transfer by a script through CRTK, in this process.")
    parser.add_argument("--seeds", type=int, default=10, help="how many runs, with the seeds 0, 1, … [10]")
    parser.add_argument("--first", type=int, default=0, help="the first seed [0]")
    parser.add_argument("--ways", type=int, default=2, help="ways over and back [2]")
    parser.add_argument("--profile", default="accurate")
    parser.add_argument("--step", type=float, default=0.005, help="interval of an iteration, s [0.005]")
    parser.add_argument("--ghosts", action="store_true", help="load the ghosts of the fingers, too")
    parser.add_argument("--errors", action="store_true", help="joints have the errors of the seed")
    parser.add_argument("--verbose", action="store_true", help="say how it goes")
    parser.add_argument("--table", action="store_true", help="in the end a table: how many runs have how many points")
    parser.add_argument(
        "--page", type=Path, help="write the table, of runs without and with errors, between the markers of this file"
    )
    parser.add_argument("--jobs", type=int, default=1, help="runs at once, in processes [1]")
    options = parser.parse_args(arguments)
    seeds = range(options.first, options.first + options.seeds)
    kinds = [False, True] if options.page else [options.errors]
    rows: Dict[str, List[Score]] = {}
    with concurrent.futures.ProcessPoolExecutor(options.jobs, multiprocessing.get_context("spawn")) as pool:
        for errors in kinds:
            own = argparse.Namespace(**{**vars(options), "errors": errors})
            scores = pool.map(run, seeds, itertools.repeat(own)) if options.jobs > 1 else (run(s, own) for s in seeds)
            name = "joints with errors" if errors else "joints without errors"
            rows[name] = []
            for seed, score in zip(seeds, scores):
                print(json.dumps({"seed": seed, "errors": errors, **score.as_dict()}), flush=True)
                rows[name].append(score)
    text = table(rows, 2 * options.ways)
    if options.table or options.page:
        print(text)
    if options.page:
        page = options.page.read_text()
        before, _, rest = page.partition(MARKS[0])
        options.page.write_text(before + MARKS[0] + text + MARKS[1] + rest.partition(MARKS[1])[2])


if __name__ == "__main__":
    main()
