"""The simulator over ROS, through `ambf_client`."""

from __future__ import annotations

import contextlib
from typing import Any, Dict, List, Optional, Sequence, Tuple

from ambf_client import Actuator, Client, ClientError, ObjectNotFound, RigidBody, Sensor, World
from geometry_msgs.msg import Point, Pose, Quaternion, Twist, Vector3, Wrench

from .backend import (
    FORCE,
    POSITION,
    BodyCommand,
    BodyState,
    Commands,
    HoldCommand,
    Named,
    Picture,
    SensorState,
    States,
    array,
    plain,
)
from .errors import InvalidDescription, SimulatorFailed, StepMismatch
from .pictures import CameraTopics
from .process import SimulatorProcess
from .scene import Scene


class RosBackend:
    """Steps a simulator with its service `World/step`.

    It starts one of its own, or attaches to a running one, which should have been started with `-t 1`: otherwise each step is as long
    as it takes.
    """

    def __init__(
        self,
        scene: Optional[Scene] = None,
        *,
        attach: Optional[str] = None,
        patience: float = 60.0,
        timeout: float = 30.0,
    ) -> None:
        """`scene`: a simulator is started with it, unless `attach` says what the topics of the one begin with that runs: its `--ns`,
        or '' for any. Then the scene only tells the limits of joints, and may be missing.

        `patience`: seconds between two steps after which the simulator runs freely, so that a client that died doesn't hold it.
        `timeout`: seconds that the simulator may take to start, or for a step.
        """
        self._scene = scene
        if scene is None and attach is None:
            raise InvalidDescription("give a scene to start, or say what to attach to")
        self._attach = attach
        self._patience = patience
        self._timeout = timeout
        self._process: Optional[SimulatorProcess] = None
        self._client: Optional[Client] = None
        self._world: Optional[World] = None
        self._bodies: Dict[str, RigidBody] = {}
        self._sensors: Dict[str, Sensor] = {}
        self._actuators: Dict[str, Actuator] = {}
        self._sim_step = -1
        self._pictures: Optional[CameraTopics] = None
        self._is_shown = False

    @property
    def interval(self) -> float:
        """See `Backend.interval`. Of a simulator that is attached to it is taken to be 1 ms unless `scene` says otherwise."""
        return 0.001 if self._scene is None else self._scene.interval()

    def joint_limits(self) -> Optional[Dict[str, Tuple[float, float]]]:
        """From the files of the scene."""
        return None if self._scene is None else self._scene.joint_limits()

    def open(self, bodies: Sequence[str], sensors: Sequence[str], actuators: Sequence[str]) -> Dict[str, Sequence[str]]:
        """Starts the simulator, if it is to be started, and connects.

        Raises SimulatorFailed, InvalidDescription, MasterNotFound or SimulatorNotFound.
        """
        self.close()
        try:
            namespace = self._attach
            if self._scene is not None and namespace is None:
                self._process = SimulatorProcess(self._scene, self._is_shown)
                namespace = self._process.namespace
            only = (*bodies, *sensors, *actuators)
            client = self._client = Client("ambf_gym", namespace=namespace or "", only=only, anonymous=True)
            client.create_objs_from_rostopics(120, self._timeout)
            self._world = client.get_world_handle()
            self._pictures = CameraTopics(namespace or "")
            self._bodies = Named("observed body", {name: self._find(name, RigidBody) for name in bodies})
            self._sensors = {name: self._find(name, Sensor) for name in sensors}
            self._actuators = Named("observed actuator", {name: self._find(name, Actuator) for name in actuators})
            self._settle_names()
            # From now on states come with the steps; topics would only take time from the learner.
            used: List[Any] = [*self._bodies.values(), *self._sensors.values(), *self._actuators.values()]
            for handle in used:
                handle.stop_listening()
            # The first step tells where the count stands.
            self._sim_step = self._require_world().step(1, patience=self._patience, timeout=self._timeout).sim_step
        except ClientError as error:
            log = self._process.log() if self._process else ""
            self.close()
            if log:
                raise SimulatorFailed(f"{error}; the simulator printed:\n{log}") from error
            raise
        except BaseException:
            self.close()
            raise
        return {name: [plain(joint) for joint in body.get_joint_names()] for name, body in self._bodies.items()}

    def _find(self, name: str, kind: Any) -> Any:
        assert self._client is not None
        try:
            handle = self._client.wait_for_object(name, self._timeout)
        except ObjectNotFound as error:
            raise InvalidDescription(str(error)) from error
        if not isinstance(handle, kind):
            raise InvalidDescription(f'"{name}" is a {type(handle).__name__}, not a {kind.__name__}')
        return handle

    def _settle_names(self) -> None:
        """The names of joints come with the states, once they have been asked for."""
        world = self._require_world()
        world.step(0, commands=list(self._bodies.values()), patience=self._patience, timeout=self._timeout)
        for body in self._bodies.values():
            if len(body._state.joint_names) != len(body._state.joint_positions) or not body._state.joint_names:
                with contextlib.suppress(ClientError):
                    body.wait_for_state(lambda state: len(state.joint_names) > 0, 0.2)

    def _require_world(self) -> World:
        if self._world is None:
            raise SimulatorFailed("the environment is closed; reset() opens it again")
        return self._world

    def step(self, commands: Commands, steps: int, reset: bool = False) -> States:
        """See `Backend.step`. Raises what `World.step` raises too."""
        world = self._require_world()
        driven: List[Any] = []
        for name, command in commands.bodies.items():
            _command_body(self._bodies[name], command)
            driven.append(self._bodies[name])
        for name, hold in commands.actuators.items():
            _command_actuator(self._actuators[name], hold)
            driven.append(self._actuators[name])
        observed = [*self._bodies.values(), *self._sensors.values(), *self._actuators.values()]
        result = world.step(steps, driven, observed, reset=reset, patience=self._patience, timeout=self._timeout)
        expected, self._sim_step = (self._sim_step + steps) % 2**32, result.sim_step
        if result.sim_step != expected:
            raise StepMismatch(
                f"step {result.sim_step} was reached instead of {expected}: somebody else steps or resets the simulator, or it ran freely "
                f"because no step was asked for within {self._patience} s"
            )
        return States(
            sim_step=result.sim_step,
            sim_time=result.sim_time,
            bodies={name: _body_state(handle) for name, handle in self._bodies.items()},
            sensors={name: _sensor_state(handle) for name, handle in self._sensors.items()},
            actuators={name: handle.is_actuated() for name, handle in self._actuators.items()},
        )

    def render(
        self, camera: Optional[str], width: Optional[int], height: Optional[int], rgb: bool, depth: bool
    ) -> Picture:
        """See `Backend.render`: the picture that the simulator publishes of the step that was observed last.

        Only cameras with `publish image` (for depth `publish depth`) can do that, in the size that they publish. Raises SimulatorFailed
        if no picture comes within `timeout`.
        """
        self._require_world()
        if self._pictures is None:
            raise SimulatorFailed("the environment is closed; reset() opens it again")
        handles: List[Any] = [*self._bodies.values(), *self._sensors.values(), *self._actuators.values()]
        stamps = [handle._state.header.stamp for handle in handles]
        return self._pictures.take(camera, (width, height), rgb, depth, max(stamps, default=None), self._timeout)

    def show(self) -> None:
        """See `Backend.show`; a simulator that is attached to has the windows that it has."""
        if self._attach is not None:
            raise InvalidDescription(
                "a simulator that is attached to is shown by itself: leave render_mode='human' out"
            )
        self._is_shown = True

    def close(self) -> None:
        """See `Backend.close`. A simulator that was not started here runs freely afterwards."""
        world, self._world = self._world, None
        client, self._client = self._client, None
        process, self._process = self._process, None
        pictures, self._pictures = self._pictures, None
        if pictures is not None:
            pictures.close()
        if process is None and world is not None:
            with contextlib.suppress(ClientError):
                world.step(0, patience=0.01, timeout=1.0)
        if client is not None:
            client.clean_up()
        if process is not None:
            process.close()


def _command_body(body: RigidBody, command: BodyCommand) -> None:
    names = [plain(joint) for joint in body._state.joint_names]
    message = body._cmd
    message.cartesian_cmd_type = command.kind
    if command.kind == FORCE:
        message.wrench = Wrench(Vector3(*command.linear), Vector3(*command.angular))
    elif command.kind == POSITION:
        message.pose = Pose(Point(*command.linear), Quaternion(*command.angular))
    else:
        message.twist = Twist(Vector3(*command.linear), Vector3(*command.angular))
    if command.joints:
        values, kinds = [0.0] * len(names), [FORCE] * len(names)
        # The first of those of the same name.
        places = Named(f"joint of {body.get_name()}", {name: place for place, name in reversed(list(enumerate(names)))})
        for name, (kind, value) in command.joints.items():
            values[places[name]], kinds[places[name]] = float(value), kind
        last = max(places[name] for name in command.joints) + 1
        message.joint_cmds, message.joint_cmds_types = values[:last], kinds[:last]


def _command_actuator(actuator: Actuator, command: HoldCommand) -> None:
    if not command.hold:
        actuator.deactuate()
    elif command.sensor:
        actuator.actuate_from_sensor_data(command.sensor)
    else:
        actuator.actuate(command.body)


def _body_state(body: RigidBody) -> BodyState:
    state = body._state
    p, q, v, w = state.pose.position, state.pose.orientation, state.twist.linear, state.twist.angular
    names = [plain(joint) for joint in state.joint_names]
    return BodyState(
        position=array((p.x, p.y, p.z)),
        rotation=array((q.x, q.y, q.z, q.w)),
        linear_velocity=array((v.x, v.y, v.z)),
        angular_velocity=array((w.x, w.y, w.z)),
        joint_positions=dict(zip(names, state.joint_positions)),
        joint_velocities=dict(zip(names, state.joint_velocities)),
        joint_efforts=dict(zip(names, state.joint_efforts)),
    )


def _sensor_state(sensor: Sensor) -> SensorState:
    return SensorState(
        measurement=array(sensor.get_all_measurements()),
        sensed=tuple(str(seen.data) for seen in sensor._state.sensed_objects),
    )
