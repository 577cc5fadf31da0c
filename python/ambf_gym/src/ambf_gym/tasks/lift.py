"""Lift and place: a gripper fetches a block from the floor and puts it down elsewhere.

At the start the fingers open and the block falls to the floor below the palm. The palm is moved by velocity; the holder, a constraint
actuator, fixes to it what the palm's ray sees.
"""

from __future__ import annotations

import numpy as np

from ..backend import POSITION, Array, BodyCommand, Commands
from ..env import Info, Task, Transition
from ..parts import DriveBody, Hold, Holds, Measurements, Position, Twist
from ..scene import Scene
from .making import makers

SCENE = Scene(("models/gripper.yaml",), options=("--profile", "accurate"))

PALM = "gripper/palm"
BLOCK = "gripper/block"
EYE = "gripper/proximity"
HOLDER = "gripper/holder"
FINGERS = ("leftslide", "rightslide")

FLOOR = -1.5
BLOCK_HEIGHT = 0.02
"""Of its centre when it lies on the floor, m."""

SUCCESS = 0.03
"""Distance that counts as there, m."""


def draw_goal(rng: np.random.Generator) -> Array:
    """A place on the floor, 0.1 to 0.3 m away: where the centre of the block is to be, m."""
    angle, far = rng.uniform(-np.pi, np.pi), rng.uniform(0.1, 0.3)
    return np.array([far * np.cos(angle), far * np.sin(angle), FLOOR + BLOCK_HEIGHT])


def open_fingers(commands: Commands) -> None:
    """The fingers stay open."""
    commands.bodies.setdefault(PALM, BodyCommand()).joints.update({finger: (POSITION, 0.0) for finger in FINGERS})


def away(transition: Transition) -> float:
    """From block to goal, m."""
    return float(np.linalg.norm(transition.after.bodies[BLOCK].position - transition.goal))


def is_placed(transition: Transition) -> bool:
    """The block lies at the goal, and nothing holds it."""
    block = transition.after.bodies[BLOCK]
    still = float(np.linalg.norm(block.linear_velocity)) < 0.05
    return away(transition) < SUCCESS and still and not transition.after.actuators[HOLDER]


def reward(transition: Transition) -> float:
    """For the palm near the block, the block near the goal, and the end."""
    after = transition.after
    reach = float(np.linalg.norm(after.bodies[PALM].position - after.bodies[BLOCK].position - [0.0, 0.0, 0.09]))
    return -0.3 * reach - away(transition) + 5.0 * is_placed(transition)


def is_over(transition: Transition) -> bool:
    """Placed, or the palm has gone where it can't do its work."""
    palm = transition.after.bodies[PALM].position
    return is_placed(transition) or bool(np.abs(palm[:2]).max() > 0.6 or not FLOOR + 0.04 < palm[2] < -0.4)


def info(transition: Transition) -> Info:
    """Distance of the block from the goal, m, and whether it is placed."""
    return {"distance": away(transition), "is_success": is_placed(transition)}


TASK = Task(
    observe=(
        Position(PALM),
        Position(BLOCK),
        Position(BLOCK, relative_to=PALM),
        Twist(BLOCK),
        Measurements(EYE),
        Holds(HOLDER),
    ),
    act=(DriveBody(PALM, mode="velocity", low=-0.5, high=0.5), Hold(HOLDER, sensor="SENSOR proximity")),
    reward=reward,
    terminated=is_over,
    goal=draw_goal,
    goal_size=3,
    also=open_fingers,
    info=info,
    max_steps=200,
    n_skip_steps=20,
    settle_steps=800,
)


make_lift, make_lift_vec = makers("Lift", SCENE, TASK)
