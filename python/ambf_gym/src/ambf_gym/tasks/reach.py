"""Reach: the flange of the arm of seven joints is to go to a point and stay there."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..backend import Array
from ..env import Info, Task, Transition
from ..parts import DriveJoints, JointPositions, JointVelocities, Position
from ..scene import Scene
from .making import makers

SCENE = Scene(("models/arm7.yaml",), options=("--profile", "accurate"))

BASE = "arm7/base"
FLANGE = "arm7/flange"
JOINTS = ("yaw", "shoulder", "roll", "elbow", "forearm_roll", "wrist", "flange_roll")

# Where the flange is at the start, m, and how far from there goals are.
HOME = np.array([0.515, 0.0, -0.939])
SPREAD = np.array([0.15, 0.3, 0.2])

SUCCESS = 0.03
"""Distance that counts as there, m."""


def draw_goal(rng: np.random.Generator) -> Array:
    """A point in a box about the home position, m."""
    return HOME + rng.uniform(-SPREAD, SPREAD)


def distance(transition: Transition) -> Any:
    """From flange to goal, m."""
    way = transition.after.bodies[FLANGE].position - transition.goal
    return np.sqrt(np.add.reduce(way * way, axis=-1))


def reward(transition: Transition) -> Any:
    """Less for distance and for moving about; a bonus for being there."""
    away = transition.once(distance)
    pace = transition.action / 0.08
    return -away - 0.02 * (np.add.reduce(pace * pace, axis=-1) / len(JOINTS)) + 0.5 * (away < SUCCESS)


def info(transition: Transition) -> Info:
    """Distance, m, and whether it is there."""
    away = transition.once(distance)
    return {"distance": away, "is_success": away < SUCCESS}


TASK = Task(
    observe=(JointPositions(BASE, JOINTS), JointVelocities(BASE, JOINTS), Position(FLANGE)),
    # Each step moves the set points by up to 0.08 rad.
    act=(DriveJoints(BASE, JOINTS, mode="position", increment=0.08),),
    reward=reward,
    goal=draw_goal,
    goal_size=3,
    info=info,
    max_steps=50,
    n_skip_steps=40,
    of_arrays=True,
)


make_reach, make_reach_vec = makers("Reach", SCENE, TASK)
