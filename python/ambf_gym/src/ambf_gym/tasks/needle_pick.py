"""Needle pick: one instrument fetches a curved needle from a pad, hands it over to the other one, and takes it back elsewhere.

Both instruments are moved by velocity and hold what they are close to. The needle lies somewhere, and turned anyhow, at the start.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, List, Mapping, Tuple

import gymnasium
import numpy as np
from gymnasium.vector import VectorEnv

from ..backend import Array, States
from ..env import Info, Task, Transition
from ..parts import DriveBody, Hold, Holds, Measurements, ObservationPart, Position, Rotation, Twist
from ..scene import Scene
from .making import makers

SCENE = Scene(("needle/needle.yaml",), options=("--profile", "accurate"))

NEEDLE = "needle/needle"
TOOLS = ("needle/tool1", "needle/tool2")
HOLDERS = ("needle/holder1", "needle/holder2")
EYES = ("needle/eye1", "needle/eye2")

RADIUS = 0.025
"""Of the needle's arc, about the origin of its frame, m."""
HALF_ANGLE = np.radians(67.5)
"""The needle lies between minus this and this, from x about z of its frame, rad."""
SPEED = 0.1
"""Largest speed of an instrument, m/s."""
LIFTED = 0.03
"""Height above the pad from which on the needle counts as lifted, m."""
ELSEWHERE = 0.5
"""How far from the first grip the second one has to be, as an angle of the arc, rad."""

STAGES = ("pick", "hand over", "regrasp", "done")


def placed(rng: np.random.Generator) -> Mapping[str, Any]:
    """The needle on the pad, up to 20 mm off the middle and turned by up to 0.6 rad."""
    x, y = rng.uniform(-0.02, 0.02, 2)
    turn = rng.uniform(-0.6, 0.6)
    return {"poses": {NEEDLE: (x, y, 0.0012, 0.0, 0.0, np.sin(turn / 2), np.cos(turn / 2))}}


def rotated(rotation: Array, vector: Array) -> Array:
    """A vector turned by a quaternion x, y, z, w."""
    axis, w = rotation[:3], rotation[3]
    across = 2.0 * np.cross(axis, vector)
    turned: Array = vector + w * across + np.cross(axis, across)
    return turned


def point_of(states: States, angle: float) -> Array:
    """Where the needle's middle line is at an angle of its arc, m, world."""
    needle = states.bodies[NEEDLE]
    return needle.position + rotated(needle.rotation, RADIUS * np.array([np.cos(angle), np.sin(angle), 0.0]))


def angle_of(states: States, place: Array) -> float:
    """The angle of the needle's arc next to a place, rad."""
    needle = states.bodies[NEEDLE]
    inverse = needle.rotation * np.array([-1.0, -1.0, -1.0, 1.0])
    x, y, _ = rotated(inverse, place - needle.position)
    return float(np.clip(np.arctan2(y, x), -HALF_ANGLE, HALF_ANGLE))


@dataclass
class Judge:
    """How far an episode is."""

    stage: int = 0
    """Index in `STAGES`."""
    first_grip: float = 0.0
    """Where the first instrument held the needle at first, an angle of the arc, rad."""
    _seen: int = field(default=-1, repr=False)
    _gained: float = field(default=0.0, repr=False)

    def begin(self, rng: np.random.Generator) -> Array:
        """A new episode. There is no goal to be observed."""
        del rng
        self.stage, self._seen = 0, -1
        return np.zeros(0)

    def look(self, transition: Transition) -> None:
        """Once a step."""
        after = transition.after
        if after.sim_step == self._seen:
            return
        self._seen = after.sim_step
        before, worth = self.stage, self._worth(transition.before)
        holds = tuple(after.actuators[holder] for holder in HOLDERS)
        if point_of(after, 0.0)[2] > LIFTED:
            grip = angle_of(after, after.bodies[TOOLS[0]].position)
            if self.stage == 0 and holds == (True, False):
                self.stage, self.first_grip = 1, grip
            elif self.stage == 1 and holds == (False, True):
                self.stage = 2
            elif self.stage == 2 and holds == (True, False) and abs(grip - self.first_grip) > ELSEWHERE:
                self.stage = 3
        self._gained = 5.0 * (self.stage - before) + (self._worth(after) - worth if self.stage == before else 0.0)

    def _worth(self, states: States) -> float:
        """Minus the distance of the instrument that is to take the needle from it, in tenths of a metre."""
        tool = states.bodies[TOOLS[1 if self.stage == 1 else 0]].position
        return -10.0 * float(np.linalg.norm(tool - point_of(states, angle_of(states, tool))))

    def reward(self, transition: Transition) -> float:
        """5 for each stage, and what the step has brought the next instrument nearer to the needle, in tenths of a metre."""
        self.look(transition)
        return self._gained

    def terminated(self, transition: Transition) -> bool:
        """All is done, or the needle has fallen off the pad."""
        self.look(transition)
        return self.stage == len(STAGES) - 1 or bool(transition.after.bodies[NEEDLE].position[2] < -0.05)

    def info(self, transition: Transition) -> Info:
        """`stage`: what is to be done next, an index in `STAGES`; `is_success`: all is done."""
        self.look(transition)
        return {"stage": self.stage, "is_success": self.stage == len(STAGES) - 1}


def task() -> Task:
    """The task; a step is 20 ms."""
    judge = Judge()
    observe: List[ObservationPart] = [Position(NEEDLE), Rotation(NEEDLE), Twist(NEEDLE)]
    act: List[Any] = []
    for number, (tool, holder, eye) in enumerate(zip(TOOLS, HOLDERS, EYES)):
        observe += [Position(tool), Position(NEEDLE, relative_to=tool), Measurements(eye, 9), Holds(holder)]
        act += [
            DriveBody(tool, mode="velocity", low=-SPEED, high=SPEED),
            Hold(holder, sensor=f"SENSOR eye{number + 1}"),
        ]
    return Task(
        observe=observe,
        act=act,
        reward=judge.reward,
        terminated=judge.terminated,
        goal=judge.begin,
        start=placed,
        info=judge.info,
        max_steps=400,
        n_skip_steps=20,
        settle_steps=50,
    )


class Player:
    """A scripted solution: says what to do, from all that the simulator knows.

    It works through places for one instrument after the other, and waits at each until it is there.
    """

    ABOVE = 0.015
    """Distance from which an instrument goes straight to the needle, m."""
    GAP = 0.002
    """From the tip of an instrument that holds to the needle's middle line, m."""
    NEAR = 0.0004
    """Distance that counts as there, m."""
    PLACE = np.array([0.02, 0.0, 0.06])
    """Where the needle is handed over: the point that the second instrument takes, m."""

    def __init__(self) -> None:
        self._stage = 0
        self._holds = [False, False]
        self._waited = 0
        self._angles: Tuple[float, float, float] = (0.0, 0.0, 0.0)

    def action(self, states: States) -> Array:
        """(8) for `states`: velocity of the first instrument as a share of the largest, whether it holds, and the same of the second."""
        if self._stage == 0:
            # The second instrument comes along -x, and takes the needle where that is across it.
            x, y, _ = rotated(states.bodies[NEEDLE].rotation, np.array([1.0, 0.0, 0.0]))
            middle = float(np.clip(-np.arctan2(y, x), -0.6, 0.6))
            self._angles = (middle - 0.5, middle, middle + 0.5)
            self._stage = 1
        first, second, third = self._angles
        down, along = np.array([0.0, 0.0, -1.0]), np.array([-1.0, 0.0, 0.0])
        # Instrument, where it goes, and which instruments hold on the way.
        course = (
            (0, point_of(states, first) - self.ABOVE * down, (False, False)),
            (0, point_of(states, first) - self.GAP * down, (False, False)),
            (0, None, (True, False)),
            (0, self._carried(states, second), (True, False)),
            (1, point_of(states, second) - self.ABOVE * along, (True, False)),
            (1, point_of(states, second) - self.GAP * along, (True, False)),
            (1, None, (True, True)),
            (0, None, (False, True)),
            (0, point_of(states, first) - self.ABOVE * down, (False, True)),
            (0, point_of(states, third) - self.ABOVE * down, (False, True)),
            (0, point_of(states, third) - self.GAP * down, (False, True)),
            (0, None, (True, True)),
            (1, None, (True, False)),
            (1, point_of(states, second) - self.ABOVE * along, (True, False)),
        )
        while True:
            tool, place, holds = course[min(self._stage, len(course)) - 1]
            away = np.zeros(3) if place is None else place - states.bodies[TOOLS[tool]].position
            is_there = bool(np.linalg.norm(away) < self.NEAR) if place is not None else self._waited >= 3
            if not is_there or self._stage >= len(course):
                break
            self._stage, self._waited = self._stage + 1, 0
        self._waited += 1
        action = np.zeros(8)
        # Most of the way in a step of 20 ms.
        action[4 * tool : 4 * tool + 3] = np.clip(away / (0.03 * SPEED), -1.0, 1.0)
        action[3], action[7] = (1.0 if held else -1.0 for held in holds)
        return action

    def _carried(self, states: States, angle: float) -> Array:
        """Where the first instrument brings the needle's point to the place where it is handed over."""
        place: Array = states.bodies[TOOLS[0]].position + self.PLACE - point_of(states, angle)
        return place


def make_needle_pick(**options: Any) -> gymnasium.Env[Any, Any]:
    """The environment `ambf/NeedlePick-v0`. Options as those of the other tasks."""
    make, _ = makers("NeedlePick", SCENE, task())
    return make(**options)


def make_needle_pick_vec(num_envs: int = 1, **options: Any) -> VectorEnv[Any, Any, Any]:
    """`num_envs` environments `ambf/NeedlePick-v0`, with the same options."""
    _, make = makers("NeedlePick", SCENE, task())
    return make(num_envs, **options)
