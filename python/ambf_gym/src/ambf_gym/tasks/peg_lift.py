"""Peg lift, the first stage of the peg transfer: an arm takes a block between its jaws and lifts it off the board.

Scene, block, pegs and what counts as lifted and held are those of `peg_transfer`, with the arm of the blocks' side alone. An episode begins
above the block, jaws open, and ends when the block is held and its foot is `LIFTED` above the board.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Dict, Mapping, Optional, Tuple

import gymnasium
import numpy as np
from ambf_peg_transfer import SYMMETRIC, draw
from ambf_peg_transfer.arms import (
    FINGERS,
    JOINTS,
    LOWER,
    UPPER,
    about,
    base,
    inverse,
    matrices_of,
    matrix_of,
    quaternion_of,
    unlimited_all,
)
from ambf_peg_transfer.player import CLEARANCE, GRIPS, PEG_TIP, Place, to_peg, upright
from ambf_peg_transfer.player import OPEN as READY
from ambf_peg_transfer.referee import TIP, Rules
from gymnasium.vector import VectorEnv

from ..backend import Array, States
from ..env import Info, Task, Transition
from ..parts import DriveJoints, JointPositions, Limits, Position
from ..scene import Scene
from .making import is_shaped, makers
from .peg_transfer import HEIGHT, STEP, block, jaw
from .peg_transfer import SCENE as WHOLE
from .peg_transfer import base as base_of
from .peg_transfer import tool as tool_of

SCENE = Scene(
    tuple(f"peg_transfer/{name}.yaml" for name in ("board_lift", "camera_frame", "psm1")),
    launch_file="peg_transfer/launch_lift.yaml",
    options=WHOLE.options,
)
"""With one block and sub-steps of 5 ms, by which a step takes an eighth of the time that it takes in the scene of the peg transfer."""

FINE = replace(SCENE, launch_file=WHOLE.launch_file)
"""The same with the sub-steps of the peg transfer, 1 ms: for testing what was learnt."""

ARM = "psm1"
BASE, TOOL, BLOCK = base_of(ARM), tool_of(ARM), block("block1")
RULES = Rules()
LIFTED = RULES.lifted
"""Height of a block's foot above the board from which on it is lifted, m: that of the referee."""
STEPS = np.array(STEP) / 3.0
"""By how much an action moves the set points, rad and m, in 50 ms: a third of what it does in the peg transfer, 2 mm at the tool."""
WIDEST = 2.0 * READY
"""Widest angle of a finger that is commanded, rad; half of it is what the scripted player opens."""
ASIDE, ABOVE_BLOCK, TURN = 0.006, (0.013, 0.020), 0.2
"""Where the tool is at the start against where it would hold the block: so far aside along x and along y at most, m, so far above, m, and
turned about the vertical by so much at most, rad."""
SCALE = 0.01
"""Way to the grip that is worth one point, m."""
FAR = 0.05
"""Way to the grip from which on an episode is over: the tool has gone astray, or the block lies elsewhere, m."""
LEVER = 0.01
"""A turn of 1 rad counts as a way of this, m: the length of the fingers."""
NEAR = 0.0015
"""Way to the grip within which closing the jaws is worth something, m."""

_OFFSETS = np.array([grip.tool(Place(np.zeros(3), np.eye(3))).position for grip in GRIPS])
_TURNS = np.array([quaternion_of(grip.tool(Place(np.zeros(3), np.eye(3))).axes) for grip in GRIPS])

_ANGLES = [0, 1, 3, 4, 5]
"""Joints that turn."""


def _times(a: Array, b: Array) -> Array:
    """Products of quaternions (… x 4) x, y, z, w."""
    u, v = a[..., :3], b[..., :3]
    s, t = a[..., 3:], b[..., 3:]
    return np.concatenate((s * v + t * u + np.cross(u, v), s * t - np.sum(u * v, axis=-1, keepdims=True)), axis=-1)


def _turned(q: Array, vector: Array) -> Array:
    """Vectors (… x 3) turned by quaternions (… x 4)."""
    u = q[..., :3]
    across = 2.0 * np.cross(u, vector)
    turned: Array = vector + q[..., 3:] * across + np.cross(u, across)
    return turned


def _back(q: Array) -> Array:
    """Conjugates of quaternions (… x 4)."""
    conjugate: Array = q * np.array([-1.0, -1.0, -1.0, 1.0])
    return conjugate


def grip_of(states: States) -> Tuple[Array, Array]:
    """Where the tool's yaw link would hold the block: (… x 3) m, and (… x 4) quaternions, world. Of the six ways to hold a block
    (`ambf_peg_transfer.player.GRIPS`) it is that to which the tool turns least.
    """
    tool, held = states.bodies[TOOL], states.bodies[BLOCK]
    turns = _times(held.rotation[..., None, :], _TURNS)
    best = np.abs(np.sum(turns * tool.rotation[..., None, :], axis=-1)).argmax(axis=-1)
    turn = np.take_along_axis(turns, best[..., None, None], axis=-2)[..., 0, :]
    place: Array = held.position + _turned(held.rotation, _OFFSETS[best])
    return place, turn


def to_grip(states: States) -> Array:
    """(… x 6) from the tool's yaw link to the grip: m, world axes, and the turn as a rotation vector, rad, axes of the tool."""
    tool = states.bodies[TOOL]
    place, goal = grip_of(states)
    turn = _times(_back(tool.rotation), goal)
    turn = np.where(turn[..., 3:] < 0.0, -turn, turn)
    sine = np.linalg.norm(turn[..., :3], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, turn[..., 3:])
    vector = turn[..., :3] * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 2.0)
    return np.concatenate((place - tool.position, vector), axis=-1)


def joints_to_grip(states: States) -> Array:
    """(… x 6) how far the joints are from those with which the tool is at the grip, rad and m, by inverse kinematics."""
    origin, axes = base(ARM)
    place, turn = grip_of(states)
    wanted = unlimited_all((place - origin) @ axes, axes.T @ matrices_of(turn))
    joints = states.bodies[BASE].joint_positions
    away: Array = wanted - np.stack([joints[name] for name in JOINTS], axis=-1)
    # Angles the shorter way.
    turned = np.remainder(away + np.pi, 2.0 * np.pi) - np.pi
    away[..., _ANGLES] = turned[..., _ANGLES]
    return away


@dataclass(frozen=True)
class ToGrip:
    """What `to_grip` and `joints_to_grip` say: twelve numbers, m and rad."""

    body: str = BLOCK
    relative_to: str = TOOL

    def bounds(self, limits: Optional[Limits]) -> Tuple[Array, Array]:
        """None."""
        del limits
        return np.full(12, -np.inf), np.full(12, np.inf)

    def read(self, states: States) -> Array:
        """Twelve numbers."""
        return np.concatenate((to_grip(states), joints_to_grip(states)), axis=-1)


def placed(rng: np.random.Generator) -> Mapping[str, Any]:
    """The block on a peg of the left side as `ambf_simulator --seed` would place it, and the arm above it, jaws open: by the grip in which
    its joints are furthest from their limits.
    """
    origin, axes = base(ARM)

    def solve(tool: Place) -> Optional[Array]:
        return inverse(axes.T @ (tool.position - origin), axes.T @ tool.axes)

    def margin(tool: Place) -> float:
        q = solve(tool)
        return -1.0 if q is None else float(np.min(np.minimum(UPPER - q, q - LOWER) / (UPPER - LOWER)))

    while True:
        peg, turn = draw(int(rng.integers(2**32))).blocks["block1"]
        place = upright(np.array([*SYMMETRIC.pegs[peg], HEIGHT + 0.0003]), turn)
        tip = np.array([*SYMMETRIC.pegs[peg], SYMMETRIC.top + PEG_TIP])
        # The link above the fingers has room beside the peg.
        grips = [grip for grip in (grip.tool(place) for grip in GRIPS) if to_peg(origin, grip, tip) > CLEARANCE]
        if not grips:
            continue
        grip = max(grips, key=margin)
        away = np.array([*rng.uniform(-ASIDE, ASIDE, 2), rng.uniform(*ABOVE_BLOCK)])
        q = solve(Place(grip.position + away, about(2, float(rng.uniform(-TURN, TURN))) @ grip.axes))
        if margin(grip) > 0.0 and q is not None:
            break
    joints: Dict[str, float] = dict(zip(JOINTS, q.tolist()))
    joints.update(dict.fromkeys(FINGERS, READY))
    return {"poses": {BLOCK: (*place.position, *quaternion_of(place.axes))}, "joint_positions": joints}


def height(states: States) -> Array:
    """(…) of the block's foot above the board, m."""
    lifted: Array = states.bodies[BLOCK].position[..., 2] - SYMMETRIC.top
    return lifted


def is_between(states: States) -> Any:
    """(…) whether the tips of the jaws are where the referee takes a block to be held."""
    tool, held = states.bodies[TOOL], states.bodies[BLOCK]
    tip = tool.position + _turned(tool.rotation, np.array(TIP))
    x, y, z = np.moveaxis(_turned(_back(held.rotation), tip - held.position), -1, 0)
    return (np.hypot(x, y) < RULES.held_radius) & (z > -0.003) & (z < RULES.held_height)


def is_lifted(transition: Transition) -> Any:
    """(…) whether the block is held and lifted."""
    after = transition.after
    return is_between(after) & (height(after) > LIFTED)


def way(states: States) -> Any:
    """(…) from the tool to the grip, m: distances aside and along the vertical, and `LEVER` for each rad of the turn. They are added, so
    that jaws that stand on a wall gain by what brings them beside it.
    """
    to = to_grip(states)
    aside, turn = np.linalg.norm(to[..., :2], axis=-1), np.linalg.norm(to[..., 3:], axis=-1)
    return aside + np.abs(to[..., 2]) + LEVER * turn


def worth(states: States) -> Any:
    """(…) how far an episode is: minus the way to the grip in `SCALE`, `FAR` at most, up to 1 for jaws that are closed there, and up to 1
    for the block that is held and lifted.
    """
    away = np.minimum(way(states), FAR)
    fingers = states.bodies[BASE].joint_positions
    closed = 1.0 - np.clip(sum(fingers[name] for name in FINGERS) / (len(FINGERS) * WIDEST), 0.0, 1.0)
    lifted = is_between(states) * np.clip((height(states) - HEIGHT + SYMMETRIC.top) / LIFTED, 0.0, 1.0)
    return -away / SCALE + np.exp(-((away / NEAR) ** 2)) * closed + lifted


def reward(transition: Transition) -> Any:
    """1 for the lifted block, and what the step has added to `worth`, whose sum over a way ends where it began (Ng, Harada and Russell
    1999).
    """
    return transition.once(is_lifted) + worth(transition.after) - worth(transition.before)


def sparse(transition: Transition) -> Any:
    """1 for the lifted block."""
    return 1.0 * transition.once(is_lifted)


def terminated(transition: Transition) -> Any:
    """The block is lifted, or far from the tool."""
    return transition.once(is_lifted) | (way(transition.after) > FAR)


def info(transition: Transition) -> Info:
    """`height`: of the block's foot above the board, m; `is_success`: it is held and lifted."""
    return {"height": height(transition.after), "is_success": transition.once(is_lifted)}


def task(shaped: bool = True) -> Task:
    """The task; a step is 50 ms."""
    return Task(
        observe=(JointPositions(BASE, (*JOINTS, *FINGERS)), ToGrip(), Position(BLOCK)),
        act=(
            DriveJoints(
                BASE, JOINTS, mode="position", low=LOWER.tolist(), high=UPPER.tolist(), increment=STEPS.tolist()
            ),
            jaw(BASE, at_rest=READY, widest=WIDEST),
        ),
        reward=reward if shaped else sparse,
        terminated=terminated,
        start=placed,
        info=info,
        max_steps=100,
        n_skip_steps=10,
        settle_steps=40,
        of_arrays=True,
    )


TASK = task()


class Player:
    """A scripted solution for one world: says what to do, from all that the simulator knows.

    It works through stages, and waits in each until the tool is where it is to be, or for so many steps: above the grip, slowly down to it,
    closing the jaws, and further up.
    """

    OVER = 0.012
    """How far above the grip the tool stops first, m."""
    DOWN = 0.001
    """How far it goes down in a step, m."""
    NEAR = 0.0004
    """Distance that counts as there, m, with `LEVER` for its turn."""
    MOST = (40, 25, 10, 100)
    """Steps that it waits at most."""
    UP = 0.001
    """How far it goes up in a step, m."""

    def __init__(self) -> None:
        self._origin, self._axes = base(ARM)
        self._set_point: Optional[Array] = None
        self._stage = self._waited = 0
        self._goal: Array = np.zeros(3)
        self._turn: Array = np.eye(3)

    def action(self, states: States) -> Array:
        """(7) for `states`: shares of the largest steps of the set points, and how far the jaws are open, -1 … 1."""
        tool = states.bodies[TOOL]
        if self._set_point is None:
            positions = states.bodies[BASE].joint_positions
            self._set_point = np.array([positions[name] for name in JOINTS])
        to = to_grip(states)
        self._waited += 1
        is_there = False
        if self._stage < 2:
            above = max(self.OVER - self.DOWN * self._waited, 0.0) if self._stage else self.OVER
            self._goal = tool.position + to[:3] + np.array([0.0, 0.0, above])
            self._turn = matrix_of(tool.rotation) @ _axes_of(to[3:])
            away = np.linalg.norm(self._goal - tool.position) + LEVER * np.linalg.norm(to[3:])
            is_there = bool(away < self.NEAR) and (self._stage == 0 or above == 0.0)
        if is_there or self._waited > self.MOST[self._stage]:
            self._stage, self._waited = self._stage + 1, 0
        goal = self._goal + np.array([0.0, 0.0, self.UP * self._waited if self._stage > 2 else 0.0])
        wanted = inverse(self._axes.T @ (goal - self._origin), self._axes.T @ self._turn)
        action = np.zeros(len(JOINTS) + 1)
        if wanted is not None:
            action[:-1] = np.clip((wanted - self._set_point) / STEPS, -1.0, 1.0)
        self._set_point = np.clip(self._set_point + action[:-1] * STEPS, LOWER, UPPER)
        action[-1] = 0.0 if self._stage < 2 else -1.0
        return action


def _axes_of(vector: Array) -> Array:
    """The rotation matrix of a rotation vector, rad."""
    half = 0.5 * float(np.linalg.norm(vector))
    return matrix_of([*(0.5 * np.sinc(half / np.pi) * vector), np.cos(half)])


def make_peg_lift(reward: str = "shaped", **options: Any) -> gymnasium.Env[Any, Any]:
    """The environment `ambf/PegLift-v0`. `reward`: "sparse", 1 for the lifted block, or "shaped". Others as those of the other tasks."""
    make, _ = makers("PegLift", SCENE, task(is_shaped(reward)))
    return make(**options)


def make_peg_lift_vec(num_envs: int = 1, reward: str = "shaped", **options: Any) -> VectorEnv[Any, Any, Any]:
    """`num_envs` environments `ambf/PegLift-v0`, with the same options."""
    _, make = makers("PegLift", SCENE, task(is_shaped(reward)))
    return make(num_envs, **options)
