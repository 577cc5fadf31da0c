"""The world: time, throttled stepping, resets."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Dict, Sequence, Tuple, Type

from ambf_msgs.msg import WorldCmd, WorldState
from ambf_msgs.srv import AddModel, ListModels, RemoveModel, StartRecording, Step, StopRecording
from std_msgs.msg import Empty

from .actuator import Actuator
from .base_object import BaseObject
from .contact_sensor import ContactSensor
from .errors import SimulationLost, SimulatorNotFound, SimulatorTimeout, StepRefused, UnsupportedCommand
from .ghost import GhostObject
from .handle import Handle
from .rigid_body import RigidBody
from .ros import Connection
from .ros_abstraction_layer import ral, ral_may_come_first, request
from .sensor import Sensor

# What the reports of a lost simulation begin with.
_LOST = "lost at step"

# Services by their names of ROS 1.
_SERVICES: Dict[str, Any] = {
    "step": Step,
    "add_model": AddModel,
    "remove_model": RemoveModel,
    "list_models": ListModels,
    "start_recording": StartRecording,
    "stop_recording": StopRecording,
}

# A reset has ended a loss after so long, s.
_RESUME_S = 5.0

# What a step can observe, in the order of its answer.
_OBSERVABLE: Tuple[Type[BaseObject], ...] = (RigidBody, Sensor, Actuator, ContactSensor, GhostObject)


@dataclass(frozen=True)
class StepResult:
    """What `World.step` has led to."""

    sim_step: int
    """Physics iterations since the simulator started."""
    sim_time: float
    """Simulated time, s."""
    states: Dict[str, Any]
    """States of the observed objects by the names of their handles, all of step `sim_step`; without names of joints and children."""


class World(Handle):
    """The world of the simulator.

    When the simulator has lost its state, because a number became non-finite or implausible, it pauses. States of all handles of the
    client, `update` and `step` then raise SimulationLost until everything was reset.
    """

    @ral_may_come_first
    def __init__(self, a_name: str, topic: str = "") -> None:
        """`a_name`: name of the handle; `topic`: what its topics begin with, `/ambf/env/World`."""
        super().__init__(a_name, 2.0, WorldState(), WorldCmd(), topic)
        self.object_type = "WORLD"
        self._reset_pub: Any = None
        self._reset_bodies_pub: Any = None
        self._services: Dict[str, Connection] = {}

    # --- life -------------------------------------------------------------------------------------------------------------------

    def ros_cb(self, data: WorldState) -> None:
        """Takes a state; the subscriber's callback."""
        with self._arrived:
            if not self._is_late(data):
                self._health.lost = data.header.frame_id
            super().ros_cb(data)

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
        for connection in self._services.values():
            connection.close()
        for end in (self._pub, self._reset_pub, self._reset_bodies_pub, self._sub):
            self._close(end)
        self._pub = self._reset_pub = self._reset_bodies_pub = self._sub = None

    # --- state ------------------------------------------------------------------------------------------------------------------

    def get_wall_time(self) -> float:
        """Time since the physics loop started, s."""
        return float(self._state.wall_time)

    def get_sim_time(self) -> float:
        """Simulated time, s."""
        return float(self._state.sim_time)

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

        Raises SimulationLost, and publishes nothing, while the simulation is lost.
        """
        self._health.check()
        with self._lock:
            self._cmd.step_clock = not self._cmd.step_clock
            if self._pub is not None:
                self._pub.publish(self._cmd)
            self.acknowledge_wd()

    def clear_cmd(self) -> None:
        """Ends throttling with the next publication."""
        self._cmd.enable_step_throttling = False

    def reset(self) -> None:
        """Everything returns to where it started; time and step counters go on. A lost simulation resumes: it is waited for."""
        self._reset(self._reset_pub)

    def reset_bodies(self) -> None:
        """Rigid bodies return to where they started. A lost simulation resumes: it is waited for."""
        self._reset(self._reset_bodies_pub)

    def _reset(self, publisher: Any) -> None:
        if publisher is None:
            return
        self._send(publisher)
        self._wait_for_recovery()

    def _wait_for_recovery(self) -> None:
        """After a reset: until the states say so."""
        with self._arrived:
            self._arrived.wait_for(lambda: not self._health.lost, _RESUME_S)

    def _send(self, publisher: Any) -> None:
        # The first message would be lost while the simulator is still connecting.
        end = time.monotonic() + 5.0
        while self._ral is not None and self._ral.get_num_connections(publisher) == 0:
            if time.monotonic() > end:
                raise SimulatorTimeout(f"nobody listens to the resets of {self._topic}")
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
        `observe`: rigid bodies, sensors, contact sensors, ghost objects and actuators whose states are to be returned; their handles get
        them too.
        `reset`: everything returns to where it started before that.
        `patience`: time in s after which the physics runs freely if no further step comes.

        With a simulator that was started with `-t 1` the result depends on nothing but what was asked since it started, and
        iterations are made as fast as the computer can.

        Raises SimulationLost if the simulation is lost, and `reset` is not asked for, or is lost in one of the iterations; StepRefused
        with the simulator's reason for other refusals; SimulatorNotFound if it is not there or has no steps (the C++ simulator),
        SimulatorTimeout if no answer comes within `timeout` s.
        """
        asked = request(Step, steps=int(steps), reset=bool(reset), patience=float(patience))
        for handle in commands:
            with handle._lock:
                if isinstance(handle, RigidBody):
                    asked.body_names.append(handle._topic)
                    asked.body_commands.append(handle._cmd)
                elif isinstance(handle, Actuator):
                    asked.actuator_names.append(handle._topic)
                    asked.actuator_commands.append(handle._cmd)
                else:
                    raise UnsupportedCommand(f"{handle.get_name()}: steps command rigid bodies and actuators only")
        for handle in observe:
            if not isinstance(handle, _OBSERVABLE):
                raise UnsupportedCommand(
                    f"{handle.get_name()}: steps observe rigid bodies, sensors, ghost objects and actuators only"
                )
            asked.observe.append(handle._topic)
        answer = self._ask("step", asked, timeout)
        if not answer.success:
            if answer.message.startswith(_LOST):
                self._health.lost = answer.message
                raise SimulationLost(answer.message)
            raise StepRefused(answer.message)
        with self._arrived:
            self._stepped = answer.sim_step
        self._wait_for_recovery()
        arrays = (answer.bodies, answer.sensors, answer.actuators, answer.contact_sensors, answer.ghosts)
        pools = {kind: iter(array) for kind, array in zip(_OBSERVABLE, arrays)}
        states: Dict[str, Any] = {}
        for handle in observe:
            state = next(next(pool for kind, pool in pools.items() if isinstance(handle, kind)))
            handle.take_step(state)
            states[handle.get_name()] = state
        return StepResult(int(answer.sim_step), float(answer.sim_time), states)

    # --- services of this simulator ---------------------------------------------------------------------------------------------

    def add_model(self, file: str, timeout: float = 60.0) -> Any:
        """Loads a model into the running simulation: an answer with `success`, `model`, its name, and `message`.

        `file`: path of its file, for the simulator. `Client.wait_for_object` then finds its objects. Raises SimulatorNotFound and
        SimulatorTimeout as `step` does.
        """
        return self._ask("add_model", request(AddModel, file=str(file)), timeout)

    def remove_model(self, model: str, timeout: float = 60.0) -> Any:
        """Removes a model from the running simulation: an answer with `success` and `message`. Raises as `add_model`."""
        return self._ask("remove_model", request(RemoveModel, model=str(model)), timeout)

    def list_models(self, timeout: float = 10.0) -> Any:
        """The models that there are: an answer with `models`, their names. Raises as `add_model`."""
        return self._ask("list_models", request(ListModels), timeout)

    def start_recording(self, file: str = "", reset: bool = False, timeout: float = 60.0) -> Any:
        """Begins a recording: an answer with `success`, `file` and `message`. Raises as `add_model`.

        `file`: for the simulator; empty: it chooses a name. `reset`: the world is reset, and the recording begins with that; else it can
        begin only where the simulation began, or directly after a reset.
        """
        return self._ask("start_recording", request(StartRecording, file=str(file), reset=bool(reset)), timeout)

    def stop_recording(self, timeout: float = 60.0) -> Any:
        """Ends the recording: an answer with `success`, `file` and `message`. Raises as `add_model`."""
        return self._ask("stop_recording", request(StopRecording), timeout)

    def _ask(self, service: str, asked: Any, timeout: float) -> Any:
        if service not in self._services:
            raise SimulatorNotFound(f"{self._name} has no simulator: it was not found by a Client")
        return self._services[service].call(asked, timeout)

    def connect_services(self, layer: ral) -> None:
        """Lets the services be called: long before the first call, so that each knows by then where to send its answers.

        ROS 2 calls them `AddModel` instead of `add_model`.
        """
        for name, kind in _SERVICES.items():
            full = name if layer.ros_version() == 1 else name.title().replace("_", "")
            self._services[name] = layer.connection(f"{self._topic}/{full}", kind)
