"""The simulator in this process, through `ambf`: no ROS, and many times faster."""

from __future__ import annotations

import argparse
from typing import Any, Dict, List, Mapping, NoReturn, Optional, Sequence, Tuple

import ambf
import numpy as np

from .backend import (
    FORCE,
    POSITION,
    Array,
    BodyCommand,
    BodyState,
    Commands,
    Named,
    Picture,
    SensorState,
    States,
    plain,
)
from .errors import InvalidDescription, SimulatorFailed, StepMismatch
from .scene import Scene, resources

_LARGEST = float(np.finfo(np.float32).max)


class InProcessBackend:
    """Steps a simulation of its own in the calling thread.

    It does what `RosBackend` does, number for number: over ROS joints are in single precision, so they are here too.
    """

    def __init__(self, scene: Scene) -> None:
        """Loads `scene` when it is opened; of its options those about time and physics count, and others are an InvalidDescription."""
        self._scene = scene
        self._options = _options(scene.options)
        self._simulation: Optional[ambf.Simulation] = None
        self._bodies: Dict[str, _Body] = {}
        self._sensors: Dict[str, ambf.Sensor] = {}
        self._actuators: Dict[str, ambf.Actuator] = {}
        self._sim_step = -1
        self._is_shown = False
        self._poses: Dict[str, Sequence[float]] = {}

    @property
    def interval(self) -> float:
        """See `Backend.interval`."""
        return float(self._options["step"])

    @property
    def simulation(self) -> ambf.Simulation:
        """The simulation; it is another one after each `open`. Raises SimulatorFailed while closed."""
        if self._simulation is None:
            raise SimulatorFailed("the environment is closed; reset() opens it again")
        return self._simulation

    def joint_limits(self) -> Optional[Dict[str, Tuple[float, float]]]:
        """From the files of the scene."""
        return self._scene.joint_limits()

    def open(self, bodies: Sequence[str], sensors: Sequence[str], actuators: Sequence[str]) -> Dict[str, Sequence[str]]:
        """Loads the scene. Raises ambf.LoadError or InvalidDescription."""
        self.close()
        launch = self._scene.launch() or str(resources() / "launch.yaml")
        simulation = ambf.Simulation(self._scene.model_files(), launch_file=launch, **self._options)
        self._simulation = simulation
        try:
            self._bodies = Named("observed body", {name: _Body(simulation.body(name)) for name in bodies})
            self._sensors = {name: simulation.sensor(name) for name in sensors}
            self._actuators = Named("observed actuator", {name: simulation.actuator(name) for name in actuators})
        except ambf.NotFoundError as error:
            self.close()
            raise InvalidDescription(str(error)) from error
        # As over ROS: what is observed is told to do nothing, and the first step tells where the count stands.
        for body in self._bodies.values():
            body.handle.kind = FORCE
        simulation.step(1)
        self._sim_step = simulation.sim_step
        if self._is_shown:
            try:
                simulation.view()
            except ambf.RenderError:
                self.close()
                raise
        return {name: body.names for name, body in self._bodies.items()}

    def step(self, commands: Commands, steps: int, reset: bool = False) -> States:
        """See `Backend.step`. Raises ambf.NonFiniteError and ambf.InvalidCommand too."""
        self.prepare(commands, reset)
        self.simulation.step(steps)
        return self.observe(steps)

    def prepare(self, commands: Commands, reset: bool = False) -> None:
        """What `step` does before the iterations; whoever uses this makes them."""
        simulation = self.simulation
        if reset:
            simulation.reset()
        if self._poses:
            simulation.set_state(poses={self._bodies[name].handle.name: pose for name, pose in self._poses.items()})
            self._poses = {}
        for name, command in commands.bodies.items():
            self._bodies[name].command(command)
        for name, hold in commands.actuators.items():
            actuator = self._actuators[name]
            if not hold.hold:
                actuator.release()
            elif hold.sensor:
                actuator.hold(sensor=hold.sensor)
            else:
                actuator.hold(body=hold.body)

    def observe(self, steps: int) -> States:
        """What `step` does after `steps` iterations."""
        simulation = self.simulation
        expected, self._sim_step = (self._sim_step + steps) % 2**32, simulation.sim_step
        if self._sim_step != expected:
            raise StepMismatch(
                f"step {self._sim_step} was reached instead of {expected}: somebody else steps the simulation"
            )
        return States(
            sim_step=self._sim_step,
            sim_time=simulation.sim_time,
            bodies={name: body.state() for name, body in self._bodies.items()},
            sensors={name: _sensor_state(sensor) for name, sensor in self._sensors.items()},
            actuators={name: actuator.holding for name, actuator in self._actuators.items()},
        )

    def place(self, poses: Mapping[str, Sequence[float]]) -> None:
        """See `Backend.place`."""
        self._poses = dict(poses)

    def render(
        self, camera: Optional[str], width: Optional[int], height: Optional[int], rgb: bool, depth: bool
    ) -> Picture:
        """See `Backend.render`. Raises ambf.RenderError where nothing can be drawn."""
        wanted = {"rgb": rgb, "depth": depth}
        try:
            found = self.simulation.render(camera, width, height, **wanted)
        except (ambf.NotFoundError, ValueError) as error:
            raise InvalidDescription(str(error)) from error
        return found if isinstance(found, dict) else {name: found for name, is_wanted in wanted.items() if is_wanted}

    def show(self) -> None:
        """See `Backend.show`. Opening raises ambf.RenderError without a display."""
        self._is_shown = True

    def close(self) -> None:
        """See `Backend.close`."""
        simulation, self._simulation = self._simulation, None
        if simulation is not None:
            simulation.close()


class _Body:
    """A body with the names of its joints."""

    def __init__(self, handle: ambf.Body) -> None:
        self.handle = handle
        self.names = [plain(name) for name in handle.joints]
        # The first of those of the same name.
        places = {name: place for place, name in reversed(list(enumerate(self.names)))}
        self._places = Named(f"joint of {handle.name}", places)

    def command(self, command: BodyCommand) -> None:
        body = self.handle
        body.kind = command.kind
        if command.kind == FORCE:
            body.wrench[:3], body.wrench[3:] = command.linear, command.angular
        elif command.kind == POSITION:
            body.target_pose[:3], body.target_pose[3:] = command.linear, command.angular
        else:
            body.target_twist[:3], body.target_twist[3:] = command.linear, command.angular
        if command.joints:
            # Joints before the last one that is commanded are told to do nothing, as over ROS.
            body.joint_kinds[:], body.joint_commands[:] = ambf.NONE, 0.0
            last = max(self._places[name] for name in command.joints) + 1
            body.joint_kinds[:last] = ambf.EFFORT
            for name, (kind, value) in command.joints.items():
                place = self._places[name]
                body.joint_kinds[place], body.joint_commands[place] = kind, np.float32(value)

    def state(self) -> BodyState:
        body = self.handle
        pose, twist = body.pose.copy(), body.twist.copy()
        return BodyState(
            position=pose[:3],
            rotation=pose[3:],
            linear_velocity=twist[:3],
            angular_velocity=twist[3:],
            joint_positions=dict(zip(self.names, _narrow(body.joint_positions))),
            joint_velocities=dict(zip(self.names, _narrow(body.joint_velocities))),
            joint_efforts=dict(zip(self.names, _narrow(body.joint_efforts))),
        )


def _sensor_state(sensor: ambf.Sensor) -> SensorState:
    measured, seen = sensor.readings()
    return SensorState(measurement=np.array(_narrow(measured), dtype=np.float64), sensed=seen)


def _narrow(values: Array) -> List[float]:
    """In single precision; what is too large becomes the largest number, not infinite."""
    return [float(value) for value in np.clip(values, -_LARGEST, _LARGEST).astype(np.float32)]


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise InvalidDescription(
            f"options of the scene: {message}; in this process only those about time and physics count"
        )


def _boolean(text: str) -> bool:
    words = {"true": True, "yes": True, "on": True, "1": True, "false": False, "no": False, "off": False, "0": False}
    if text.lower() not in words:
        raise argparse.ArgumentTypeError(f"{text} is neither true nor false")
    return words[text.lower()]


def _options(options: Sequence[str]) -> Dict[str, Any]:
    """Arguments of `ambf.Simulation` that mean what these options of `ambf_simulator` mean."""
    parser = _Parser(add_help=False)
    add = parser.add_argument
    add("--profile")
    add("--solver")
    add("--integrator")
    add("--iterations", type=int)
    for name in ("--sleep", "--articulated"):
        add(name, nargs="?", const=True, type=_boolean)
    add("-p", "--phx_frequency", type=float, default=1000.0)
    add("-s", "--sim_speed_factor", type=float, default=1.0)
    known, unknown = parser.parse_known_args(list(options))
    if unknown:
        parser.error(f"{' '.join(unknown)}: not known")
    found = dict(vars(known))
    frequency, factor = found.pop("phx_frequency"), found.pop("sim_speed_factor")
    if not frequency > 0.0:
        parser.error(f"a frequency of {frequency} Hz")
    return {**found, "step": factor / frequency}
