"""Peg transfer: two arms bring two blocks to pegs of the other side of a wall, and back.

The rules are those of the ICRA 2026 competition, and the referee is that of `ambf_peg_transfer`; docs/competition.md. Blocks start on
pegs of the left side, which are drawn for each episode.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Dict, List, Mapping, Sequence

import gymnasium
import numpy as np
from ambf_peg_transfer import SYMMETRIC, Pose, Referee, draw
from ambf_peg_transfer.arms import FINGERS, JOINTS, LOWER, UPPER
from gymnasium.vector import VectorEnv

from ..backend import Array, BodyState, States
from ..env import Info, Task, Transition
from ..parts import DriveJoints, JointPositions, ObservationPart, Position, Rotation
from ..scene import Scene
from .making import GoalForm, is_shaped, makers

SCENE = Scene(
    tuple(f"peg_transfer/{name}.yaml" for name in ("board", "camera_frame", "psm1", "psm2")),
    launch_file="peg_transfer/launch.yaml",
    options=("--profile", "accurate", "-p", "200"),
)
"""Without the ghosts in the jaws: friction alone holds the blocks."""

ARMS = ("psm1", "psm2")
BLOCKS = SYMMETRIC.blocks
STEP = (0.03, 0.03, 0.003, 0.06, 0.06, 0.06)
"""By how much an action moves the set points of yaw, pitch, insertion, roll and wrist, rad and m, in 50 ms."""
OPEN = 0.5
"""Widest angle of a finger that is commanded, rad."""
HEIGHT = SYMMETRIC.top + 0.0002
"""Of a block that rests, m."""
NEAR = 0.003
"""Distance that counts as there, m."""
SCALE = 0.1
"""Distance that is worth one point in the shaped reward, m."""


def base(arm: str) -> str:
    """The body below which an arm's joints are."""
    return f"{arm}/baselink"


def tool(arm: str) -> str:
    """The link to which its fingers belong."""
    return f"{arm}/toolyawlink"


def block(name: str) -> str:
    """A block's body."""
    return f"phantom/{name}"


def jaw(body: str, at_rest: float = 0.5 * OPEN, widest: float = OPEN) -> DriveJoints:
    """One number: the angle of both fingers below a body, from 0, closed, to `widest`, rad. `at_rest`: the angle while nobody says it."""
    return DriveJoints(body, FINGERS, mode="position", low=0.0, high=widest, tied=True, at_rest=at_rest)


def _pose(body: BodyState) -> Pose:
    return Pose(tuple(body.position.tolist()), tuple(body.rotation.tolist()))


def placed(rng: np.random.Generator) -> Mapping[str, Mapping[str, Sequence[float]]]:
    """Blocks on pegs of the left side, as `ambf_simulator --seed` would place them with a seed that is drawn."""
    poses: Dict[str, Sequence[float]] = {}
    for name, (peg, turn) in draw(int(rng.integers(2**32))).blocks.items():
        poses[block(name)] = (*SYMMETRIC.pegs[peg], HEIGHT + 0.0003, 0.0, 0.0, np.sin(turn / 2), np.cos(turn / 2))
    return {"poses": poses}


@dataclass
class Judge:
    """The referee of an environment, and what it is worth."""

    is_shaped: bool
    """Whether nearness has a reward, too."""
    referee: Referee = field(default_factory=Referee)
    _seen: int = -1
    _gained: int = 0

    def begin(self, rng: np.random.Generator) -> Array:
        """A new episode; the goal is for the goal form: a peg of the right side on which block1 is to be."""
        self.referee.reset()
        self._seen = -1
        pegs = [peg for peg in SYMMETRIC.pegs if SYMMETRIC.side(peg) < 0]
        return np.array([*SYMMETRIC.pegs[pegs[int(rng.integers(len(pegs)))]], HEIGHT])

    def look(self, transition: Transition) -> None:
        """Once a step."""
        if transition.after.sim_step == self._seen:
            return
        if self._seen < 0:
            self._update(transition.before)
        self._seen = transition.after.sim_step
        before = self.referee.score.points
        self._update(transition.after)
        self._gained = self.referee.score.points - before

    def _update(self, states: States) -> None:
        bodies = states.bodies
        self.referee.update(
            states.sim_time,
            {name: _pose(bodies[block(name)]) for name in BLOCKS},
            {arm: _pose(bodies[tool(arm)]) for arm in ARMS},
            {arm: _pose(bodies[base(arm)]) for arm in ARMS},
        )

    def reward(self, transition: Transition) -> float:
        """A point for each point; shaped, in addition what the step has brought nearer, whose sum over a way ends where it began
        (Ng, Harada and Russell 1999).
        """
        self.look(transition)
        if not self.is_shaped:
            return float(self._gained)
        return self._gained + self._worth(transition.after) - self._worth(transition.before)

    def _worth(self, states: States) -> float:
        """Of blocks that are near the side to which they go, and of jaws that are near the blocks."""
        worth = 0.0
        score = self.referee.score
        target = -1 if score.way % 2 == 0 else 1
        for name in BLOCKS:
            place = states.bodies[block(name)].position
            if name in score.counted:
                continue
            pegs = [at for peg, at in SYMMETRIC.pegs.items() if SYMMETRIC.side(peg) == target]
            worth -= min(float(np.linalg.norm(place - (*at, HEIGHT))) for at in pegs) / SCALE
            jaws = [states.bodies[tool(arm)].position - (0.0, 0.0, 0.02) for arm in ARMS]
            worth -= 0.3 * min(float(np.linalg.norm(place - at)) for at in jaws) / SCALE
        return worth

    def terminated(self, transition: Transition) -> bool:
        """The time is over, or a block is out of reach."""
        self.look(transition)
        return self.referee.score.is_over

    def info(self, transition: Transition) -> Info:
        """How the run stands: `score`, as `ambf_peg_transfer.Score.as_dict`; `is_success`: all blocks have been over once."""
        self.look(transition)
        score = self.referee.score
        return {"score": score.as_dict(), "is_success": score.way > 0}


def task(is_shaped: bool = True) -> Task:
    """The task; a step is 50 ms."""
    judge = Judge(is_shaped)
    observe: List[ObservationPart] = []
    for arm in ARMS:
        observe += [JointPositions(base(arm), (*JOINTS, *FINGERS)), Position(tool(arm)), Rotation(tool(arm))]
    for name in BLOCKS:
        observe += [Position(block(name)), Rotation(block(name))]
        observe += [Position(block(name), relative_to=tool(arm)) for arm in ARMS]
    act = [
        part
        for arm in ARMS
        for part in (
            DriveJoints(base(arm), JOINTS, mode="position", low=LOWER.tolist(), high=UPPER.tolist(), increment=STEP),
            jaw(base(arm)),
        )
    ]
    return Task(
        observe=observe,
        act=act,
        reward=judge.reward,
        terminated=judge.terminated,
        goal=judge.begin,
        start=placed,
        goal_size=3,
        info=judge.info,
        # Of 50 ms: the competition's three minutes.
        max_steps=3600,
        n_skip_steps=10,
        settle_steps=100,
    )


def make_peg_transfer(reward: str = "shaped", goal_form: bool = False, **options: Any) -> gymnasium.Env[Any, Any]:
    """The environment `ambf/PegTransfer-v0`. `reward`: "sparse", a point for each point of the referee, or "shaped". `goal_form`:
    block1 is to be on a peg that is drawn, see `GoalForm`. Others as those of the other tasks.
    """
    make, _ = makers("PegTransfer", SCENE, task(is_shaped(reward)))
    env = make(**options)
    return GoalForm(env, block("block1"), NEAR) if goal_form else env


def make_peg_transfer_vec(num_envs: int = 1, reward: str = "shaped", **options: Any) -> VectorEnv[Any, Any, Any]:
    """`num_envs` environments `ambf/PegTransfer-v0`, with the same options but for the goal form."""
    _, make = makers("PegTransfer", SCENE, task(is_shaped(reward)))
    return make(num_envs, **options)
