"""The environment of the C++ simulator's client, for scripts that use it. New programs use the package `ambf_gym`."""

from __future__ import annotations

import math
import time
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np

from .base_object import say
from .client import Client
from .errors import ObjectNotFound, SimulatorTimeout
from .rigid_body import RigidBody
from .world import World

_LOW = (-30.0, -30.0, -30.0, -2.0, -2.0, -2.0, 0.0)
_HIGH = (30.0, 30.0, 30.0, 2.0, 2.0, 2.0, 1.0)

_FREE_AFTER = 0.45
"""Time without a clock edge after which the physics may run freely, s; it does after 0.5."""
_REST = 0.2
"""Time without an iteration after which the physics is taken to be held, s; well above the pauses of a busy computer."""


class Box:
    """Bounds of an array, where no learning library is installed."""

    def __init__(self, low: Any, high: Any) -> None:
        self.low = np.asarray(low, dtype=np.float64)
        self.high = np.asarray(high, dtype=np.float64)
        self.shape = self.low.shape

    def sample(self) -> Any:
        """An array between finite bounds, or of normal distribution between infinite ones."""
        if np.isfinite(self.low).all() and np.isfinite(self.high).all():
            return np.random.uniform(self.low, self.high)
        return np.random.normal(size=self.shape)


class Observation:
    """What a step has led to."""

    def __init__(self) -> None:
        self.state: List[float] = [0.0] * 13
        self.dist = 0.0
        self.reward = 0.0
        self.prev_reward = 0.0
        self.cur_reward = 0.0
        self.is_done = False
        self.info: Dict[str, Any] = {}
        self.sim_step_no = 0

    def cur_observation(self) -> Tuple[Any, float, bool, Dict[str, Any]]:
        """(state, reward, done, info); the state is an array of 13: pose of the object, pose of the base, steps made."""
        return np.array(self.state), self.reward, self.is_done, self.info


class AmbfEnv:
    """Drives one body with poses while the physics is throttled, and rewards coming nearer to a second one."""

    def __init__(self, base_name: str = "PegBase", client_name: str = "ambf_client") -> None:
        """`base_name`: the second body. Raises as `Client.connect` and `Client.wait_for_object`."""
        self.obj_handle: Any = None
        self.world_handle: Any = None
        self.ambf_client = Client(client_name)
        self.ambf_client.connect()
        self.base_handle: RigidBody = self.ambf_client.wait_for_object(base_name)
        self.n_skip_steps = 5
        self.enable_step_throttling = True
        self.action: Any = [0.0] * 7
        self.action_lims_low = np.array(_LOW)
        self.action_lims_high = np.array(_HIGH)
        self.action_space = Box(_LOW, _HIGH)
        self.observation_space = Box([-math.inf] * 13, [math.inf] * 13)
        self.obs = Observation()
        self._last_edge = -math.inf

    def make(self, a_name: str) -> None:
        """Drives the body called `a_name`. Raises ObjectNotFound."""
        self.obj_handle = self.ambf_client.wait_for_object(a_name)
        world = self.ambf_client.get_world_handle()
        if world is None:
            raise ObjectNotFound("there is no world")
        self.world_handle = world
        self.world_handle.enable_throttling(self.enable_step_throttling)
        self.world_handle.set_num_step_skips(self.n_skip_steps)
        self._hold()

    def skip_sim_steps(self, num: int) -> None:
        """Iterations that a step makes, 1 … 100."""
        self.n_skip_steps = num
        self._world().set_num_step_skips(num)

    def set_throttling_enable(self, check: bool) -> None:
        """Whether the physics waits for steps."""
        self.enable_step_throttling = check
        self._world().enable_throttling(check)
        self._last_edge = -math.inf

    def reset(self) -> Any:
        """A step without action; the state. The simulation is not reset."""
        return self.step([0.0] * 7)[0]

    def step(self, action: Sequence[float]) -> Tuple[Any, float, bool, Dict[str, Any]]:
        """Commands a pose (six numbers as in `pose_command`, then one without effect) and makes a step: (state, reward, done, info)."""
        if len(action) != 7 or not np.isfinite(np.asarray(action, dtype=np.float64)).all():
            raise ValueError(f"an action is seven finite numbers, not {action!r}")
        world = self._world()
        self.action = np.clip(np.asarray(action, dtype=np.float64), self.action_lims_low, self.action_lims_high)
        self.obj_handle.pose_command(*self.action)
        self._hold()
        self._edge(world)
        self._update_observation(self.action)
        return self.obs.cur_observation()

    def render(self, mode: str = "human") -> None:
        """Says that there is nothing to render here."""
        say(f"render({mode}): look at the simulator")

    def _world(self) -> World:
        if self.world_handle is None:
            raise ObjectNotFound("call make(NAME) first")
        return self.world_handle  # type: ignore[no-any-return]

    def _edge(self, world: World) -> None:
        world.update()
        self._last_edge = time.monotonic()

    def _hold(self) -> None:
        """Brings a freely running physics to rest, so that the next edge is neither lost nor mistaken for steps made before it."""
        if not self.enable_step_throttling or time.monotonic() - self._last_edge < _FREE_AFTER:
            return
        world = self._world()
        end = time.monotonic() + 5.0
        self._edge(world)
        at, since = self.obj_handle.get_sim_step(), time.monotonic()
        while time.monotonic() - since < _REST:
            time.sleep(0.01)
            now = self.obj_handle.get_sim_step()
            if now != at:
                at, since = now, time.monotonic()
            if time.monotonic() > end:
                say("the physics goes on; does the simulator take commands of the world?")
                break
            # The first edges are lost while the simulator is still connecting; it runs freely then.
            if time.monotonic() - self._last_edge > _FREE_AFTER / 2:
                self._edge(world)
                at, since = self.obj_handle.get_sim_step(), time.monotonic()
        self.obs.sim_step_no = self.obj_handle.get_sim_step()

    def _update_observation(self, action: Any) -> None:
        jumped = 0
        if self.enable_step_throttling:
            try:
                now = self.obj_handle.wait_for_step(self.obs.sim_step_no + self.n_skip_steps)
            except SimulatorTimeout as error:
                say(f"{error}; does the simulator run?")
                now = self.obj_handle.get_sim_step()
            jumped = now - self.obs.sim_step_no
            if jumped > self.n_skip_steps:
                say(f"{jumped} steps were made instead of {self.n_skip_steps}")
        else:
            now = self.obj_handle.get_sim_step()
            jumped = now - self.obs.sim_step_no
        self.obs.sim_step_no = now
        pose, base = self.obj_handle.get_pose(), self.base_handle.get_pose()
        self.obs.state = [*pose, *base, float(jumped)]
        self.obs.reward = self._reward(pose, base, action)
        self.obs.is_done = False

    def _reward(self, pose: List[float], base: List[float], action: Any) -> float:
        previous, self.obs.dist = self.obs.dist, math.dist(pose[:3], base[:3])
        return float(previous - self.obs.dist - 4.0 * float(np.sum(np.square(action))))
