"""A simulator elsewhere, over ROS 1 or ROS 2 (`ROS_VERSION`), with as much of `ambf.Simulation` as the scripted player uses: States of
bodies, topics of the arms, and time that passes. It needs the package `ambf_client`.
"""

from __future__ import annotations

import threading
import time
from typing import Any, Dict, NamedTuple

import numpy as np
from ambf_msgs.msg import RigidBodyState
from numpy.typing import ArrayLike, NDArray
from ros_abstraction_layer import ral
from sensor_msgs.msg import JointState

Array = NDArray[np.float64]
ENV = "/ambf/env"
PATIENCE = 30.0
"""So long a message may keep us waiting, s of the wall clock."""


class Silent(Exception):
    """Error when a topic says nothing for `PATIENCE` s."""


class Joints(NamedTuple):
    """What the player reads of a `sensor_msgs/JointState`."""

    position: Array
    """rad or m."""
    velocity: Array
    """rad/s or m/s."""


class RemoteBody:
    """A body by its States."""

    def __init__(self, simulation: RemoteSimulation, name: str) -> None:
        self._simulation = simulation
        self._topic = f"{ENV}/{name}/State"
        simulation.hear(self._topic, RigidBodyState)

    @property
    def pose(self) -> Array:
        """(7) position, m, and quaternion x, y, z, w. Raises Silent."""
        pose = self._simulation.newest(self._topic).pose
        at, turn = pose.position, pose.orientation
        return np.array([at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w])


class RemoteArm:
    """An arm by its CRTK topics."""

    def __init__(self, simulation: RemoteSimulation, name: str) -> None:
        """`name`: name space of its topics."""
        self._simulation = simulation
        self._name = name
        for topic in ("measured_js", "jaw/measured_js"):
            simulation.hear(f"{name}/{topic}", JointState)
        self._publishers = {
            topic: simulation.layer.publisher(f"{name}/{topic}", JointState, 1)
            for topic in ("servo_jp", "jaw/servo_jp")
        }

    def send(self, topic: str, value: ArrayLike) -> None:
        """Publishes positions of joints, or of the jaw."""
        self._publishers[topic].publish(JointState(position=np.asarray(value, np.float64).ravel().tolist()))

    def read(self, topic: str) -> Joints:
        """What a topic said last. Raises Silent."""
        message = self._simulation.newest(f"{self._name}/{topic}")
        return Joints(np.array(message.position, np.float64), np.array(message.velocity, np.float64))

    joints = read


class RemoteSimulation:
    """Time passes by itself: `step` waits until the States say that it has."""

    def __init__(self, step: float, clock: str = "phantom/block1", prefix: str = "/CRTK") -> None:
        """`step`: what one step of the player is, s of simulated time; `clock`: the body whose States tell the time; `prefix`: of the
        names of the arms.
        """
        self.layer: Any = ral("peg_transfer_player")
        self._step = step
        self._prefix = prefix
        self._heard = threading.Condition()
        self._newest: Dict[str, Any] = {}
        self._kept: Dict[str, Any] = {}
        self._clock = f"{ENV}/{clock}/State"
        self.hear(self._clock, RigidBodyState)
        self.layer.spin()
        self._next = self.sim_time

    def hear(self, topic: str, kind: Any) -> None:
        """Keeps the newest message of a topic."""

        def take(message: Any) -> None:
            with self._heard:
                self._newest[topic] = message
                self._heard.notify_all()

        if topic not in self._kept:
            self._kept[topic] = self.layer.subscriber(topic, kind, take, 1)

    def newest(self, topic: str) -> Any:
        """The newest message, or the first one. Raises Silent."""
        with self._heard:
            if not self._heard.wait_for(lambda: topic in self._newest, PATIENCE):
                raise Silent(f"{topic} says nothing: is the simulator running, with the scene of the peg transfer?")
            return self._newest[topic]

    @property
    def sim_time(self) -> float:
        """Simulated time, s."""
        return float(self.newest(self._clock).sim_time)

    def step(self, steps: int = 1) -> None:
        """Waits until so many steps have passed since the end of the last ones. Raises Silent."""
        # From the time that it is, if we are late: set points that pile up would be a jump.
        self._next = max(self._next, self.sim_time - self._step) + steps * self._step
        end = time.monotonic() + PATIENCE
        with self._heard:
            while float(self._newest[self._clock].sim_time) < self._next - 0.1 * self._step:
                if not self._heard.wait(max(0.0, end - time.monotonic())):
                    raise Silent(f"{self._clock} stands still: is the simulator paused?")

    def body(self, name: str) -> RemoteBody:
        """By its name below `/ambf/env`, or as `Simulation.body` takes it."""
        return RemoteBody(self, name if "/" in name else f"phantom/{name}")

    def arm(self, name: str) -> RemoteArm:
        """By its name without the prefix."""
        return RemoteArm(self, f"{self._prefix}/{name}")
