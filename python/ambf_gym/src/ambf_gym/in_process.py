"""The simulator in this process, through `ambf`: no ROS, and many times faster."""

from __future__ import annotations

import argparse
from typing import Any, Callable, Dict, List, Mapping, NoReturn, Optional, Sequence, Tuple, Union

import ambf
import numpy as np

from .backend import (
    FORCE,
    POSITION,
    Array,
    BodyCommand,
    Commands,
    Named,
    Picture,
    Prepared,
    SensorState,
    States,
    plain,
)
from .errors import InvalidDescription, SimulatorFailed, StepMismatch
from .gather import Gather, Layout, Seen, SeenStates, columns_by_name, narrow
from .parts import DriveBody, DriveJoints, Hold
from .scene import Scene, resources


class InProcessBackend:
    """Steps a simulation of its own in the calling thread.

    It does what `RosBackend` does, number for number: over ROS joints are in single precision, so they are here too.
    """

    def __init__(self, scene: Scene, *, integrator: Optional[str] = None) -> None:
        """Loads `scene` when it is opened; of its options those about time and physics count, and others are an InvalidDescription.
        `integrator`: one of `scene.INTEGRATORS` instead of the scene's.
        """
        self._scene = scene = scene.integrated_by(integrator)
        self._options = physics_options(scene.options)
        self._simulation: Optional[ambf.Simulation] = None
        self._bodies: Dict[str, _Body] = {}
        self._sensors: Dict[str, ambf.Sensor] = {}
        self._actuators: Dict[str, ambf.Actuator] = {}
        self._sim_step = -1
        self._is_shown = False
        self.next_recording: Optional[str] = None
        """File into which the simulation is recorded from its next reset on."""
        self.is_recording = False
        """Whether it is recorded now."""
        self.layout = Layout(0, 0)
        self.seen = Seen(self.layout, ())
        """What is observed, and where it stands in `arrays`."""

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

    @property
    def opened(self) -> Optional[ambf.Simulation]:
        """The simulation; None while closed."""
        return self._simulation

    def joint_limits(self) -> Optional[Dict[str, Tuple[float, float]]]:
        """From the files of the scene."""
        return self._scene.joint_limits()

    def open(self, bodies: Sequence[str], sensors: Sequence[str], actuators: Sequence[str]) -> Dict[str, Sequence[str]]:
        """Loads the scene. Raises ambf.LoadError or InvalidDescription."""
        self.close()
        launch = self._scene.launch() or str(resources() / "launch.yaml")
        # No part observes the wrenches of joints.
        simulation = ambf.Simulation(
            self._scene.model_files(), launch_file=launch, joint_wrenches=False, **self._options
        )
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
        counts = (simulation.bodies, simulation.joints, simulation.measurements, simulation.actuators)
        self.layout = Layout(*map(len, counts))
        self.seen = Seen(
            self.layout,
            [(name, body.handle.index, body.columns) for name, body in self._bodies.items()],
            tuple(self._sensors),
            [(name, actuator.index) for name, actuator in self._actuators.items()],
        )
        if self._is_shown:
            try:
                simulation.view()
            except ambf.RenderError:
                self.close()
                raise
        return {name: body.names for name, body in self._bodies.items()}

    sets_states = True
    """`step` takes states."""

    def step(
        self, commands: Commands, steps: int, reset: bool = False, state: Optional[Mapping[str, Any]] = None
    ) -> States:
        """See `Backend.step`; `state`: arguments of `ambf.Simulation.set_state`, after the reset.

        Raises ambf.NonFiniteError, ambf.InvalidCommand and what `set_state` raises too.
        """
        self.prepare(commands, reset, state)
        self.simulation.step(steps)
        return self.observe(steps)

    def prepare(self, commands: Commands, reset: bool = False, state: Optional[Mapping[str, Any]] = None) -> None:
        """What `step` does before the iterations; whoever uses this makes them."""
        simulation = self.simulation
        if isinstance(commands, Prepared):
            commands.write()
            return
        if reset:
            self.stop_recording()
            simulation.reset()
            if self.next_recording is not None:
                file, self.next_recording = self.next_recording, None
                simulation.record(file)
                self.is_recording = True
        if state:
            simulation.set_state(**state)
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

    def stop_recording(self) -> Optional[int]:
        """Completes the recording; how many updates are in it, or None if there is none. Raises ambf.RecordingError."""
        if not self.is_recording:
            return None
        self.is_recording = False
        return self.simulation.stop_recording()

    def observe(self, steps: int) -> States:
        """What `step` does after `steps` iterations."""
        (step,), (time,), flat = stacked([self], steps)
        sensed = [_sensor_state(sensor) for sensor in self._sensors.values()]
        return SeenStates(int(step), float(time), flat[0], self.seen, sensed)

    def count(self, steps: int, reached: int) -> None:
        """Raises StepMismatch if another iteration was reached than that after `steps` more."""
        expected, self._sim_step = (self._sim_step + steps) % 2**32, reached
        if reached != expected:
            raise StepMismatch(f"step {reached} was reached instead of {expected}: somebody else steps the simulation")

    def gather(self, parts: Sequence[Any]) -> Optional[Gather]:
        """What the parts observe as places in `States.flat`; None if there are parts of other kinds."""
        try:
            return Gather(parts, self)
        except LookupError:
            return None

    def body(self, name: str) -> int:
        """See `gather.Finder`."""
        return self._bodies[name].handle.index

    def joints(self, body: str) -> Dict[str, int]:
        """See `gather.Finder`."""
        handle = self._bodies[body].handle
        return columns_by_name(handle.joints, handle.joint_indices.tolist(), body)

    def rays(self, sensor: str) -> Tuple[int, int]:
        """See `gather.Finder`."""
        begin = 0
        for index in range(self._sensors[sensor].index):
            begin += len(self.simulation.sensor(index).measurements)
        return begin, begin + len(self._sensors[sensor].measurements)

    def actuator(self, name: str) -> int:
        """See `gather.Finder`."""
        return self._actuators[name].index

    def writers(self, parts: Sequence[Any]) -> Optional[List[Callable[[Array], None]]]:
        """For each part what writes its action over the commands that are in force; None if there are parts of other kinds."""
        makers: Dict[Any, Callable[[Any], Callable[[Array], None]]] = {
            DriveJoints: self._joint_writer,
            DriveBody: self._body_writer,
            Hold: self._hold_writer,
        }
        if not all(type(part) in makers for part in parts):
            return None
        return [makers[type(part)](part) for part in parts]

    def target(self, part: Union[DriveJoints, DriveBody]) -> Tuple[Array, Any]:
        """The array that an action of the part goes into, and the places in it."""
        body = self._bodies[part.body]
        if isinstance(part, DriveBody):
            handle = body.handle
            by_mode = {"force": handle.wrench, "velocity": handle.target_twist, "position": handle.target_pose}
            return by_mode[part.mode], slice(part.size)
        places = [body.places[plain(joint)] for joint in part.joints]
        return body.handle.joint_commands, span(places)

    def _joint_writer(self, part: DriveJoints) -> Callable[[Array], None]:
        commands, places = self.target(part)

        def write(values: Array) -> None:
            commands[places] = part.targets(values).astype(np.float32)

        return write

    def _body_writer(self, part: DriveBody) -> Callable[[Array], None]:
        target, places = self.target(part)

        def write(values: Array) -> None:
            target[places] = values

        return write

    def _hold_writer(self, part: Hold) -> Callable[[Array], None]:
        def write(values: Array) -> None:
            commands = Commands()
            part.write(values, commands)
            self.prepare(commands)

        return write

    def render(
        self, camera: Optional[str], width: Optional[int], height: Optional[int], rgb: bool, depth: bool
    ) -> Picture:
        """See `Backend.render`. Raises ambf.RenderError where nothing can be drawn."""
        try:
            found = self.simulation.render(camera, width, height, rgb=rgb, depth=depth)
        except (ambf.NotFoundError, ValueError) as error:
            raise InvalidDescription(str(error)) from error
        return found if isinstance(found, dict) else {"rgb" if rgb else "depth": found}

    def show(self) -> None:
        """See `Backend.show`. Opening raises ambf.RenderError without a display."""
        self._is_shown = True

    def close(self) -> None:
        """See `Backend.close`."""
        simulation, self._simulation = self._simulation, None
        self.is_recording = False
        if simulation is not None:
            simulation.close()


def stacked(backends: Sequence[InProcessBackend], steps: int) -> ambf.StackedStates:
    """Iterations, times and flat arrays of what is seen after `steps` iterations of each. Raises StepMismatch."""
    found = ambf.stack_states([backend.simulation for backend in backends])
    for backend, reached in zip(backends, found.sim_steps.tolist()):
        backend.count(steps, reached)
    narrow(found.numbers, backends[0].layout)
    return found


class _Body:
    """A body with the names of its joints."""

    def __init__(self, handle: ambf.Body) -> None:
        self.handle = handle
        self.names = [plain(name) for name in handle.joints]
        # The first of those of the same name.
        places = {name: place for place, name in reversed(list(enumerate(self.names)))}
        self.places = Named(f"joint of {handle.name}", places)
        self.columns = list(zip(self.names, handle.joint_indices.tolist()))

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
            last = max(self.places[name] for name in command.joints) + 1
            body.joint_kinds[:last] = ambf.EFFORT
            for name, (kind, value) in command.joints.items():
                place = self.places[name]
                body.joint_kinds[place], body.joint_commands[place] = kind, np.float32(value)


def span(places: Sequence[int]) -> Any:
    """Places that stand in a row as a slice, which is faster; else as an array."""
    if len(places) > 0 and list(places) == list(range(places[0], places[0] + len(places))):
        return slice(places[0], places[0] + len(places))
    return np.array(places, dtype=np.intp)


def _sensor_state(sensor: ambf.Sensor) -> SensorState:
    measured, seen = sensor.readings()
    most = float(np.finfo(np.float32).max)
    return SensorState(measurement=measured.clip(-most, most).astype(np.float32).astype(np.float64), sensed=seen)


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


def physics_options(options: Sequence[str]) -> Dict[str, Any]:
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
