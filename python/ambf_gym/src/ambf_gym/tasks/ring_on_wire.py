"""Ring on wire: an arm brings a ring along a wire of several bends without touching it; docs/competition.md.

The ring starts in the closed jaws, around the wire's left leg, held as it is drawn for each episode.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, List, Mapping, Optional, Tuple

import gymnasium
import numpy as np
from ambf_peg_transfer.arms import FINGERS, JOINTS, LOWER, UPPER, quaternion_of
from ambf_ring_on_wire import plan, wire
from ambf_ring_on_wire.judge import TIME_LIMIT, Judge
from gymnasium.vector import VectorEnv

from ..backend import Array, States
from ..env import Info, Task, Transition
from ..parts import DriveJoints, JointPositions, Limits, ObservationPart, Position, Rotation, Twist
from ..scene import Scene
from .making import GoalForm, is_shaped, makers
from .peg_transfer import STEP, jaw

SCENE = Scene(
    ("ring_on_wire/phantom.yaml", "ring_on_wire/camera_frame.yaml", "peg_transfer/psm1.yaml"),
    launch_file="ring_on_wire/launch.yaml",
    options=("--profile", "accurate", "-p", "200"),
)
"""Without the ghosts in the jaws: friction alone holds the ring."""

BASE, TOOL, RING = "psm1/baselink", "psm1/toolyawlink", "phantom/ring_visual"
NEAR = 0.003
"""Distance that counts as there in the goal form, m."""
PROGRESS, TOUCH = 10.0, 0.02
"""Shaped: what the whole way is worth, and what a step costs in which the ring touches the wire."""


@dataclass(frozen=True)
class OnWire:
    """Where the ring is to the wire: from its middle to the nearest point of the wire, m, the tangent there, and the share of the way."""

    body: str = RING

    def bounds(self, limits: Optional[Limits]) -> Tuple[Array, Array]:
        """None but for the tangent."""
        del limits
        high = np.array([np.inf] * 3 + [1.0 + 1e-6] * 3 + [np.inf])
        return -high, high

    def read(self, states: States) -> Array:
        """Seven numbers."""
        here = states.bodies[self.body].position
        near = wire.nearest(here)
        share = (near.along - wire.START) / (wire.LENGTH - wire.GOAL - wire.START)
        return np.array([*(near.point - here), *near.tangent, share])


def placed(rng: np.random.Generator) -> Mapping[str, Any]:
    """The ring at the start of the way, and the arm that holds it by a place of its rim that is drawn."""
    starts = plan.ways().starts()
    ring = plan.ring_at(wire.START, float(plan.ways().turns[starts[int(rng.integers(len(starts)))]]))
    q = plan.joints("psm1", plan.tool_of(ring))
    assert q is not None  # a start from which there is a way
    names = (*JOINTS, *FINGERS)
    return {
        "poses": {RING: (*ring.position, *quaternion_of(ring.axes))},
        "twists": {RING: np.zeros(6)},
        # The scene has one arm: names of joints are theirs alone, without that of the model.
        "joint_positions": dict(zip(names, (*q, *plan.FINGERS))),
    }


@dataclass
class _Watch:
    """The judge of an environment, and what it is worth."""

    is_shaped: bool
    judge: Judge = field(default_factory=Judge)
    _first: int = 0
    _seen: int = -1
    _before: Tuple[float, float] = (0.0, 0.0)

    def begin(self, rng: np.random.Generator) -> Array:
        """A new episode; the goal is for the goal form: a place on the wire where the ring is to be."""
        self.judge.reset()
        self._seen = -1
        point, _ = wire.at(float(rng.uniform(wire.START + 0.01, wire.LENGTH - wire.GOAL)))
        return point

    def look(self, transition: Transition) -> None:
        """Once a step."""
        if transition.after.sim_step == self._seen:
            return
        if self._seen < 0:
            self._first = transition.before.sim_step
            self._update(transition.before)
        self._seen = transition.after.sim_step
        self._before = (self.judge.score.progress, self.judge.score.touch_time)
        self._update(transition.after)

    def _update(self, states: States) -> None:
        ring = states.bodies[RING]
        # Simulated time goes on over resets, and so would its rounding.
        time = (states.sim_step - self._first) % 2**32 * SCENE.interval()
        self.judge.update(time, (*ring.position, *ring.rotation), states.bodies[TOOL].position)

    def reward(self, transition: Transition) -> float:
        """1 for the end of the way; shaped, in addition what was new of it, less what the step has touched."""
        self.look(transition)
        score = self.judge.score
        done = float(score.is_there)
        if not self.is_shaped:
            return done
        progress, touched = self._before
        return done + PROGRESS * (score.progress - progress) - TOUCH * float(score.touch_time > touched)

    def terminated(self, transition: Transition) -> bool:
        """The end, or the ring is off the wire."""
        self.look(transition)
        return self.judge.score.is_over

    def info(self, transition: Transition) -> Info:
        """How the run stands: `score`, as `ambf_ring_on_wire.judge.Score.as_dict`; `is_success`: the ring is there."""
        self.look(transition)
        return {"score": self.judge.score.as_dict(), "is_success": self.judge.score.is_there}


def task(shaped: bool = True) -> Task:
    """The task; a step is 50 ms."""
    watch = _Watch(shaped)
    observe: List[ObservationPart] = [
        JointPositions(BASE, (*JOINTS, *FINGERS)),
        Position(TOOL),
        Rotation(TOOL),
        Position(RING),
        Rotation(RING),
        Twist(RING),
        Position(RING, relative_to=TOOL),
        OnWire(),
    ]
    return Task(
        observe=observe,
        act=[
            DriveJoints(BASE, JOINTS, mode="position", low=LOWER.tolist(), high=UPPER.tolist(), increment=STEP),
            jaw(BASE, at_rest=0.0),
        ],
        reward=watch.reward,
        terminated=watch.terminated,
        goal=watch.begin,
        start=placed,
        goal_size=3,
        info=watch.info,
        max_steps=round(TIME_LIMIT / 0.05),
        n_skip_steps=10,
    )


def make_ring_on_wire(reward: str = "shaped", goal_form: bool = False, **options: Any) -> gymnasium.Env[Any, Any]:
    """The environment `ambf/RingOnWire-v0`. `reward`: "sparse", 1 at the end of the way, or "shaped". `goal_form`: the ring is to be at a
    place on the wire that is drawn, see `GoalForm`. Others as those of the other tasks.
    """
    make, _ = makers("RingOnWire", SCENE, task(is_shaped(reward)))
    env = make(**options)
    return GoalForm(env, RING, NEAR) if goal_form else env


def make_ring_on_wire_vec(num_envs: int = 1, reward: str = "shaped", **options: Any) -> VectorEnv[Any, Any, Any]:
    """`num_envs` environments `ambf/RingOnWire-v0`, with the same options but for the goal form."""
    _, make = makers("RingOnWire", SCENE, task(is_shaped(reward)))
    return make(num_envs, **options)
