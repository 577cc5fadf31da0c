"""A player that brings the blocks over and back by a script, without pictures: in this process, or over ROS with `--ros`.

It is told where blocks and tools are, exactly, as a program is that subscribes to their States. So its points say what the scene, the
grips and the time allow, not what a program can do that sees the board through the cameras.

It needs NumPy and, in this process, the package `ambf`; over ROS, `ambf_client`.
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
from typing import TYPE_CHECKING, Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple, Union

import numpy as np

from .arms import GAP, LOWER, UPPER, Array, about, forward, inverse, matrix_of, unlimited
from .board import SYMMETRIC, Board
from .referee import Pose, Referee, Score
from .seeds import draw

if TYPE_CHECKING:
    import ambf

    from .remote import RemoteSimulation

    Simulation = Union[ambf.Simulation, RemoteSimulation]

WALL = 0.004675
"""From the axis of a block to the middle of a wall, m."""
WALLS = (-math.pi / 2, math.pi / 6, 5 * math.pi / 6)
"""Directions of the walls in the frame of a block, rad."""
TOP = 0.01485
"""Of a block, above the origin of its frame, m."""
ABOVE = 0.003
"""The fingers' hinge is so far above the top of the block that they hold, m. Their bases, 4.3 mm below the hinge, then press on the wall's
faces. Jaws that hold a wall are a little open, so higher fingers would touch no more than the edges of its top, about which it swings.
"""
OPEN, CLOSED = 0.11, 0.0
"""Angles of a finger, rad: 0.7 mm from the wall that they are to take; inside the block there is room for 0.15 beside a peg."""
ROOM = -0.0006
"""A block that stands off its peg's axis by less than this, towards the wall, leaves room for a finger between wall and peg, m."""
APART = 0.0065
"""Hinges of both arms' fingers are so far apart across the board where a block changes hands, m."""
GRASPED = 0.0015
"""So near to where the grip has it the block is in jaws that have closed on it, m."""
LOST = 0.01
"""A block that has moved in the jaws by more was lost, m."""
LINK, PEG, PEG_TIP = 0.0026, 0.0018, 0.0182
"""Half the width of the link between wrist and fingers; radius of a peg, and height of the middle of its round tip above the board, m."""
CLEARANCE = 0.0001
"""Between link and peg, m. A link that leans to the peg's side of the wall rests on its tip before the fingers are down."""
LANDED = 0.003
"""A block that is put down is lower than this above its place, m, or has not gone over the peg."""
ALIGNED = (0.0004, 0.02)
"""So near to where it is to be is near enough before a block goes down, m and rad."""
FINGERS = 0.0095
"""Length of the fingers from their hinge, m."""
LIFT = 0.035
"""A block is carried so far above the board, m: pegs are 20 mm high."""
MEETING = np.array([0.0194, 0.306, 0.775])
"""Where blocks change hands: in front of the wall."""
ASIDE = 0.045
"""Tools and blocks go round the near end of the wall, so far from its plane, m."""
TURNS = (0.0, 0.3, -0.3, 0.6, -0.6, 1.0, -1.0)
"""By how much a block may be turned on a way, rad."""
SPEED, TURN = 0.12, 2.0
"""Greatest speeds on a way, m/s, rad/s."""
SLOWLY = 0.04
"""The same of jaws that leave a block, m/s: joints lag behind their set points, each as it can, and so faster ways are not straight."""
NEAR, THERE = 0.01, 5e-4
"""How far joints may be from their set points, rad or m, before the next leg of a way begins, and at its end."""
EMPTY = 0.004
"""Jaws that close further than this, rad, have nothing between them: a wall keeps each finger at 0.009 or more."""
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


def to_peg(base: Array, tool: Place, tip: Array) -> float:
    """How far the link above the fingers is from a peg, m. `base`: where the arm's base is; `tip`: the middle of the peg's round tip."""
    hinge = tool.axes[:, 2]
    up = base - tool.position
    up = up - (up @ hinge) * hinge
    up = up / np.linalg.norm(up)
    along = min(max(float((tip - tool.position) @ up), 0.0), GAP)
    return float(np.linalg.norm(tip - tool.position - along * up)) - LINK - PEG


class Arm:
    """One arm through its CRTK topics: what it is told, and where it is.

    Errors of its first joints are seen by the tool's State, as a camera would see them, and taken off what it is told.
    """

    def __init__(self, simulation: Simulation, name: str) -> None:
        self.name = name
        self._client = simulation.arm(name)
        self._base = simulation.body(f"{name}/baselink")
        self._tool = simulation.body(f"{name}/toolyawlink")
        self.base = place_of(self._base.pose)
        self._world = self.base.inverse()
        # Before the first step, joints are where the file has them.
        begin: Any = self._client.read("measured_js")
        self.goal: Array = np.zeros(6) if begin is None else begin.position.copy()
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

    @property
    def opening(self) -> float:
        """Angle of a finger, mean of both, rad."""
        return float(self._client.joints("jaw/measured_js").position[0])

    def solve(self, tool: Place) -> Optional[Array]:
        """Joints for a place of the tool; None: out of reach, or beyond limits."""
        seen = self._world.times(tool)
        return inverse(seen.position, seen.axes)

    def margin(self, tool: Place) -> float:
        """How far the joints are from their limits there, as a share of their ranges; negative: it can't go there."""
        q = self.solve(tool)
        return -1.0 if q is None else float(np.min(np.minimum(UPPER - q, q - LOWER) / (UPPER - LOWER)))

    def to_peg(self, tool: Place, tip: Array) -> float:
        """See the function of that name."""
        return to_peg(self.base.position, tool, tip)

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

    def __init__(self, simulation: Simulation, step: float, board: Board = SYMMETRIC) -> None:
        """`step`: interval of a step of the simulation, s."""
        self.simulation = simulation
        self.board = board
        self.referee = Referee(board)
        self._steps = max(1, round(TICK / step))
        self.arms = {1: Arm(simulation, "psm1"), -1: Arm(simulation, "psm2")}
        """By the side on which each works: 1 left, -1 right."""
        self._blocks = {name: simulation.body(name) for name in board.blocks}
        self.holder: Optional[Tuple[Arm, str, Grip]] = None
        """Which arm holds which block, and how, as far as the player knows."""
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

    def settle(self, arm: Arm, within: float = THERE, most: float = 1.5) -> None:
        """Waits until an arm is where it is to be, `most` s at most."""
        for _ in range(round(most / TICK)):
            if arm.lag < within:
                return
            self.tick()

    # --- motion -------------------------------------------------------------------------------------------------------------------

    def line(self, arm: Arm, goal: Place, within: float = THERE, speed: float = SPEED) -> None:
        """Moves a tool on a straight line, smoothly, at `speed` at most, until its joints are `within` of the end. Raises Failed."""
        begin = arm.commanded
        turn = _rotation_vector(goal.axes @ begin.axes.T)
        way = goal.position - begin.position
        seconds = 1.5 * max(float(np.linalg.norm(way)) / speed, float(np.linalg.norm(turn)) / TURN, TICK)
        count = math.ceil(seconds / TICK)
        for i in range(1, count + 1):
            share = i / count
            share = share * share * (3.0 - 2.0 * share)
            q = arm.solve(Place(begin.position + share * way, _rotated(share * turn) @ begin.axes))
            if q is None:
                raise Failed(f"{arm.name}: out of reach on the way")
            arm.goal = q
            self.tick()
        self.settle(arm, within)

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
        self.settle(arm, NEAR)

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
        meeting = upright(MEETING, turn)
        self._fetch(giver, name, give)
        # To the meeting, round the near end of the wall.
        for goal in self._way(block, side, meeting)[2:]:
            self._carry(goal)
        self._align(meeting)
        self._hand_over(giver, taker, name, take)
        # To the peg.
        for goal in self._way(target, -side, meeting)[-2:0:-1]:
            self._carry(goal)
        self._put(target)

    def _grasp(self, arm: Arm, name: str, how: Grip) -> None:
        """Goes down to a block, closes the jaws, and looks whether they have it. Raises Failed, and is above it with open jaws then."""
        grip = how.tool(self.block(name))
        over = arm.commanded
        self.line(arm, grip)
        failure = ""
        if float(np.linalg.norm(arm.tool.position - grip.position)) > GRASPED:
            failure = f"is stopped above {name}"
        else:
            self.set_jaw(arm, CLOSED)
            if arm.opening < EMPTY:
                failure = "has closed on nothing"
            elif self._slip(arm, name, how) > GRASPED:
                failure = f"has a bad grip of {name}"
        if failure:
            self.refused.add((name, how))
            self.set_jaw(arm, OPEN)
            self.line(arm, over)
            raise Failed(f"{arm.name} {failure}")

    def _fetch(self, arm: Arm, name: str, how: Grip) -> None:
        """Takes a block that stands, and lifts it. Raises Failed; the block stands on its peg then, if it has not fallen."""
        grip = how.tool(self.block(name))
        self.set_jaw(arm, OPEN)
        self._approach(arm, _moved(grip, z=LIFT))
        self._grasp(arm, name, how)
        down = arm.commanded
        self.holder = (arm, name, how)
        # At rest, for over ROS the States of a tool and of a block are not of the same moment.
        self.line(arm, _moved(down, z=LIFT))
        if arm.opening < EMPTY or self._slip(arm, name, how) > GRASPED:
            self.refused.add((name, how))
            self.line(arm, down)
            self.set_jaw(arm, OPEN)
            self.holder = None
            self.line(arm, _moved(down, z=LIFT), NEAR)
            raise Failed(f"{arm.name} has not got {name}")

    def _hand_over(self, giver: Arm, taker: Arm, name: str, how: Grip) -> None:
        """Both hold the block, then the taker alone. Raises Failed; if the taker has not got it, the giver still holds it."""
        side = 1 if giver is self.arms[1] else -1
        self.set_jaw(taker, OPEN)
        self._approach(taker, _moved(how.tool(self.block(name)), z=0.8 * LIFT))
        self._grasp(taker, name, how)
        self.set_jaw(giver, OPEN)
        self.holder = (taker, name, how)
        self._leave(giver, 0.8 * LIFT)
        self.line(giver, _moved(giver.commanded, x=side * ASIDE), NEAR)
        self._check()

    def _leave(self, arm: Arm, height: float) -> None:
        """Draws open jaws off a block, along the fingers, which else would drag it along where they are not upright; then goes up."""
        here = arm.commanded
        off = Place(here.position + FINGERS * here.axes[:, 1], here.axes)
        self.line(arm, off, NEAR, SLOWLY)
        self.line(arm, _moved(off, z=height - FINGERS), NEAR)

    def _slip(self, arm: Arm, name: str, how: Grip) -> float:
        """How far a block is in the jaws from where the grip has it, m."""
        held = self.block(name).inverse().times(arm.tool)
        planned = how.tool(Place(np.zeros(3), np.eye(3)))
        return float(np.linalg.norm(held.position - planned.position))

    def _check(self) -> None:
        """Looks whether the holder still has its block. Raises Failed."""
        if self.holder is None:
            return
        arm, name, how = self.holder
        if arm.opening < EMPTY or self._slip(arm, name, how) > LOST:
            self.holder = None
            raise Failed(f"{arm.name} has lost {name}")

    def _carry(self, goal: Place) -> None:
        """Moves the held block on a straight line. The tool moves as planned, upright: what the block has turned in the jaws is seen to
        where it has to be somewhere exactly, for a tool that turned with it on all its way would leave the reach of the arm.
        """
        assert self.holder is not None
        arm, _, how = self.holder
        self.line(arm, how.tool(goal), NEAR)
        self._check()

    def _align(self, goal: Place) -> None:
        """Brings the held block to where it is to be, whatever it has slipped on its way; not upright where the arm does not reach that."""
        assert self.holder is not None
        arm, name, _ = self.holder
        self.settle(arm)
        for _ in range(3):
            block = self.block(name)
            away = goal.position - block.position
            turned = float(np.linalg.norm(_rotation_vector(goal.axes @ block.axes.T)))
            if float(np.linalg.norm(away)) < ALIGNED[0] and turned < ALIGNED[1]:
                break
            tool = goal.times(block.inverse().times(arm.tool))
            if arm.solve(tool) is None:
                tool = Place(arm.tool.position + away, arm.commanded.axes)
            self.line(arm, tool)
            self._check()

    def _put(self, target: Place) -> None:
        """Puts the held block that is above a peg onto it, and goes up."""
        assert self.holder is not None
        arm, name, _ = self.holder
        for _ in range(3):
            self._align(_moved(target, z=LIFT))
            over = arm.commanded
            self.line(arm, _moved(over, z=-LIFT))
            if self.block(name).position[2] < target.position[2] + LANDED:
                break
            # It stands on the peg.
            self.line(arm, over)
            self._check()
        self.set_jaw(arm, OPEN)
        self.holder = None
        self._leave(arm, LIFT)
        self.wait(0.3)

    def _put_back(self) -> None:
        """Puts a block that is still held after a failure onto a peg of the arm's own side. Raises Failed."""
        if self.holder is None:
            return
        arm, name, how = self.holder
        side = 1 if arm is self.arms[1] else -1
        self._check()
        block = self.block(name)
        yaw = math.atan2(block.axes[1, 0], block.axes[0, 0])
        for peg, turn in itertools.product(self.free_pegs(side), TURNS):
            target = upright(np.array([*self.board.pegs[peg], self.board.top + 0.001]), yaw + turn)
            way = self._way(target, side, Place(block.position, target.axes))
            if all(arm.margin(how.tool(goal)) > 0.0 for goal in way):
                for goal in way[-2:0:-1]:
                    self._carry(goal)
                self._put(target)
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
        best: Tuple[float, Any] = (-0.5, None)
        yaw = math.atan2(block.axes[1, 0], block.axes[0, 0])

        def tip_of(place: Array) -> Array:
            near = min(self.board.pegs.values(), key=lambda at: math.dist(at, place[:2]))
            return np.array([*near, self.board.top + PEG_TIP])

        @functools.cache
        def put(grip: Grip, turn: float) -> float:
            target = upright(stand, turn)
            if taker.to_peg(grip.tool(target), tip_of(stand)) < CLEARANCE:
                return -1.0
            return min(taker.margin(grip.tool(place)) for place in (target, _moved(target, z=LIFT)))

        # A grip that did not take it, or without room beside the peg, comes last.
        def doubt(grip: Grip) -> float:
            angle = WALLS[grip.wall]
            out = block.axes @ np.array([math.cos(angle), math.sin(angle), 0.0])
            tip = tip_of(block.position)
            room = float(out[:2] @ (block.position - tip)[:2])
            clear = giver.to_peg(grip.tool(block), tip)
            return 0.1 * ((name, grip) in self.refused) + 0.1 * (room < ROOM) + 0.1 * (clear < CLEARANCE)

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
            here -= 0.1 * ((name, take) in self.refused)
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
                    self.wait(0.5)
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
    import ambf

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


def run_over_ros(options: argparse.Namespace) -> Score:
    """A run in a simulator that is running, as it stands."""
    from .remote import RemoteSimulation

    return Player(RemoteSimulation(TICK), TICK).play(options.ways, options.verbose)


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
    parser.add_argument("--ros", action="store_true", help="one run in a simulator that is running, over ROS_VERSION")
    options = parser.parse_args(arguments)
    if options.ros:
        print(json.dumps(run_over_ros(options).as_dict()), flush=True)
        return
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
