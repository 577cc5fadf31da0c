"""The world: time, throttled stepping, resets."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Any, Callable, Dict, Optional, Sequence

import rospy
from ambf_msgs.msg import WorldCmd, WorldState
from ambf_msgs.srv import Step, StepRequest
from std_msgs.msg import Empty

from .actuator import Actuator
from .base_object import BaseObject
from .errors import SimulatorTimeout, StepRefused, UnsupportedCommand
from .rigid_body import RigidBody
from .sensor import Sensor
from .service import ServiceConnection
from .watch_dog import WatchDog


@dataclass(frozen=True)
class StepResult:
    """What `World.step` has led to."""

    sim_step: int
    """Physics iterations since the simulator started."""
    sim_time: float
    """Simulated time, s."""
    states: Dict[str, Any]
    """States of the observed objects by the names of their handles, all of step `sim_step`; without names of joints and children."""


class World(WatchDog):
    """The world of the simulator."""

    def __init__(self, a_name: str, topic: str = "") -> None:
        """`a_name`: name of the handle; `topic`: what its topics begin with, `/ambf/env/World`."""
        super().__init__(2.0)
        self.pub_flag = True
        self.object_type = "WORLD"
        self._name = a_name
        self._topic = topic
        self._state = WorldState()
        self._cmd = WorldCmd()
        self._pub: Optional[rospy.Publisher] = None
        self._reset_pub: Optional[rospy.Publisher] = None
        self._reset_bodies_pub: Optional[rospy.Publisher] = None
        self._sub: Optional[rospy.Subscriber] = None
        self._active = False
        self._count = 0
        self._lock = threading.RLock()
        self._arrived = threading.Condition()
        self._stepper = ServiceConnection(f"{topic}/step", Step)

    # --- life -------------------------------------------------------------------------------------------------------------------

    def ros_cb(self, data: WorldState) -> None:
        """Takes a state; the subscriber's callback."""
        with self._arrived:
            self._state = data
            self._count += 1
            self._arrived.notify_all()

    def set_name(self, name: str) -> None:
        """Renames this handle."""
        self._name = name

    def get_name(self) -> str:
        """Name of this handle."""
        return self._name

    def is_active(self) -> bool:
        """Whether the client's thread publishes the command."""
        return self._active

    def set_active(self) -> None:
        """Lets the client's thread publish the command, without clock edges, so that throttling goes on between calls of `update`.

        It ends all the same when `update` was not called for 2 s (`set_timeout`).
        """
        self._active = True

    def run_publisher(self) -> None:
        """Publishes the command; called by the client's thread."""
        with self._lock:
            if self.is_wd_expired():
                self.console_print(self._name)
                self.clear_cmd()
            if self.pub_flag and self._pub is not None:
                self._pub.publish(self._cmd)

    def close(self) -> None:
        """Ends publishing and subscribing for good."""
        self._active = False
        self._stepper.close()
        for end in (self._pub, self._reset_pub, self._reset_bodies_pub, self._sub):
            if end is not None:
                end.unregister()
        self._pub = self._reset_pub = self._reset_bodies_pub = self._sub = None

    def wait_for_state(self, is_there: Callable[[WorldState], bool], timeout: float = 5.0) -> WorldState:
        """Waits until a state has arrived for which `is_there` is true; the state.

        Raises SimulatorTimeout after `timeout` s.
        """
        with self._arrived:
            if not self._arrived.wait_for(lambda: self._count > 0 and is_there(self._state), timeout):
                raise SimulatorTimeout(f"{self._name}: no such state within {timeout} s")
            return self._state

    def wait_for_step(self, step: int, timeout: float = 5.0) -> int:
        """Waits until the state is of step `step` or later; its step.

        Raises SimulatorTimeout after `timeout` s.
        """
        return int(self.wait_for_state(lambda state: state.sim_step >= step, timeout).sim_step)

    # --- state ------------------------------------------------------------------------------------------------------------------

    def get_wall_time(self) -> float:
        """Time since the physics loop started, s."""
        return float(self._state.wall_time)

    def get_sim_time(self) -> float:
        """Simulated time, s."""
        return float(self._state.sim_time)

    def get_sim_step(self) -> int:
        """Physics iterations since the simulator started."""
        return int(self._state.sim_step)

    def get_graphics_loop_freq(self) -> int:
        """Frequency of the graphics loop, Hz; 0 without a window."""
        return int(self._state.graphics_loop_freq)

    def get_dynamic_loop_freq(self) -> int:
        """Physics iterations in the last second, Hz."""
        return int(self._state.dynamic_loop_freq)

    def get_num_devices(self) -> int:
        """Number of input devices."""
        return int(self._state.n_devices)

    # --- throttled stepping with topics -----------------------------------------------------------------------------------------

    def enable_throttling(self, flag: bool) -> None:
        """Whether the physics is to wait for `update`. Sent with the next `update`."""
        self._cmd.enable_step_throttling = bool(flag)

    def set_num_step_skips(self, num: int) -> None:
        """Physics iterations that an `update` lets through, 1 … 100; else ValueError. Sent with the next `update`."""
        if not 1 <= num <= 100:
            raise ValueError(f"an update lets 1 to 100 iterations through, not {num}")
        self._cmd.n_skip_steps = num

    def update(self) -> None:
        """A clock edge, published at once. While throttling, the physics makes as many iterations as `set_num_step_skips` says.

        An edge that comes before the iterations of the one before are done is lost: wait for the state of an object
        (`wait_for_step`). 0.5 s after the last `update` the physics runs freely, unless the world is active. Commands of objects travel
        on other topics and may come later than the edge; `step` has neither of these problems.
        """
        with self._lock:
            self._cmd.step_clock = not self._cmd.step_clock
            if self._pub is not None:
                self._pub.publish(self._cmd)
            self.acknowledge_wd()

    def clear_cmd(self) -> None:
        """Ends throttling with the next publication."""
        self._cmd.enable_step_throttling = False

    def reset(self) -> None:
        """Everything returns to where it started; time and step counters go on."""
        self._send(self._reset_pub)

    def reset_bodies(self) -> None:
        """Rigid bodies return to where they started."""
        self._send(self._reset_bodies_pub)

    @staticmethod
    def _send(publisher: Optional[rospy.Publisher]) -> None:
        if publisher is None:
            return
        # The first message would be lost while the simulator is still connecting.
        end = time.monotonic() + 5.0
        while publisher.get_num_connections() == 0:
            if time.monotonic() > end:
                raise SimulatorTimeout(f"nobody listens to {publisher.name}")
            time.sleep(0.005)
        publisher.publish(Empty())

    # --- throttled stepping with the service of this simulator -------------------------------------------------------------------

    def step(
        self,
        steps: int,
        commands: Sequence[BaseObject] = (),
        observe: Sequence[BaseObject] = (),
        *,
        reset: bool = False,
        patience: float = 0.5,
        timeout: float = 10.0,
    ) -> StepResult:
        """Lets the physics make exactly `steps` iterations (0: only waits) and hold again; states are read in between, at rest.

        `commands`: rigid bodies and actuators whose present commands are put in force before the iterations; they hold throughout them.
        `observe`: rigid bodies, sensors and actuators whose states are to be returned; their handles get them too.
        `reset`: everything returns to where it started before that.
        `patience`: time in s after which the physics runs freely if no further step comes.

        With a simulator that was started with `-t 1` the result depends on nothing but what was asked since it started, and
        iterations are made as fast as the computer can.

        Raises StepRefused with the simulator's reason, SimulatorNotFound if it is not there or has no steps (the C++ simulator),
        SimulatorTimeout if no answer comes within `timeout` s.
        """
        request = StepRequest(steps=steps, reset=reset, patience=patience)
        for handle in commands:
            with handle._lock:
                if isinstance(handle, RigidBody):
                    request.body_names.append(handle._topic)
                    request.body_commands.append(handle._cmd)
                elif isinstance(handle, Actuator):
                    request.actuator_names.append(handle._topic)
                    request.actuator_commands.append(handle._cmd)
                else:
                    raise UnsupportedCommand(f"{handle.get_name()}: steps command rigid bodies and actuators only")
        for handle in observe:
            if not isinstance(handle, (RigidBody, Actuator, Sensor)):
                raise UnsupportedCommand(f"{handle.get_name()}: steps observe rigid bodies, sensors and actuators only")
            request.observe.append(handle._topic)
        answer = self._stepper.call(request, timeout)
        if not answer.success:
            raise StepRefused(answer.message)
        pools = {RigidBody: iter(answer.bodies), Sensor: iter(answer.sensors), Actuator: iter(answer.actuators)}
        states: Dict[str, Any] = {}
        for handle in observe:
            state = next(next(pool for kind, pool in pools.items() if isinstance(handle, kind)))
            handle.take_step(state)
            states[handle.get_name()] = state
        return StepResult(int(answer.sim_step), float(answer.sim_time), states)
