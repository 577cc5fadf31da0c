"""Arms for CRTK clients, in this process: topics with the names and contents that they have over ROS, without ROS."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Optional, Tuple, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InvalidCommand, NotFoundError

if TYPE_CHECKING:
    from .simulation import Simulation

Array = NDArray[np.float64]
_TEXTS = ("crtk_msgs/StringStamped", "std_msgs/String")
_JOINTS = ("sensor_msgs/JointState",)


class Joints(NamedTuple):
    """A `sensor_msgs/JointState`; arrays are empty where nothing is known."""

    names: Tuple[str, ...]
    position: Array
    """rad or m."""
    velocity: Array
    """rad/s or m/s."""
    effort: Array
    """N·m or N."""
    stamp: float
    """Simulated time, s."""


class Cartesian(NamedTuple):
    """A stamped pose, twist, wrench or Jacobian."""

    value: Array
    """(7) position, m, and quaternion x, y, z, w; (6) linear, then angular; or (6 x joints)."""
    frame: str
    """Name of the frame that it is in."""
    stamp: float
    """Simulated time, s; 0: not valid now."""


class OperatingState(NamedTuple):
    """A `crtk_msgs/OperatingState`."""

    state: str
    """ENABLED, DISABLED, PAUSED or FAULT."""
    is_homed: bool
    is_busy: bool
    """Whether a move of arm or jaw is not finished."""


Message = Union[Joints, Cartesian, OperatingState]


class Arm:
    """An arm that a file given as `crtk` configures. What is sent acts in the next step; what is read is of the last one. Commands and
    states are those of docs/crtk.md, by the dialect of the arm; sentences about refused commands are in `Simulation.notices`.
    """

    def __init__(self, simulation: Simulation, name: str) -> None:
        """Use `Simulation.arm`."""
        self.simulation = simulation
        self.name = name
        """Name space of its topics, such as "/CRTK/psm1"."""
        topics = {
            topic.removeprefix(f"{name}/"): (topic, kind, is_input)
            for space, topic, kind, is_input in simulation._world.crtk_topics()
            if space == name
        }
        self._topics = topics
        self.inputs: Tuple[str, ...] = tuple(topic for topic, (_, _, is_input) in topics.items() if is_input)
        """Topics that `send` takes, such as "servo_jp" and "jaw/servo_jp"; those outside the name space by their full names."""
        self.outputs: Tuple[str, ...] = tuple(topic for topic, (_, _, is_input) in topics.items() if not is_input)
        """Topics that the arm publishes. `read` knows those that say a state, not those that tell events."""

    def __repr__(self) -> str:
        return f"<ambf.Arm: {self.name}>"

    def send(self, topic: str, value: Union[ArrayLike, str] = (), frame: str = "") -> None:
        """Publishes on a topic: `value` is as many numbers as the arm has joints (1 for a jaw), a pose (7: m and a quaternion x, y, z, w),
        a twist or wrench (6), one number or truth, a text, or nothing. `frame`: that in which a pose is; "": the arm's default.

        Raises NotFoundError; InvalidCommand if it is nothing for this topic; ClosedError, BusyError. What the arm refuses, such as a
        pose out of reach, is a notice.
        """
        full, kind, _ = self._find(topic)
        if (kind in _TEXTS) != isinstance(value, str):
            wanted = "a text" if kind in _TEXTS else "numbers"
            raise InvalidCommand(f"{full}: expected {wanted}, got {value!r}")
        numbers = [] if isinstance(value, str) else np.asarray(value, np.float64).ravel().tolist()
        self.simulation._world.crtk_send(full, numbers, value if isinstance(value, str) else frame)

    def read(self, topic: str) -> Optional[Message]:
        """What a topic says after the last step; None before the first one. Raises NotFoundError."""
        full, kind, _ = self._find(topic)
        found = self.simulation._world.crtk_read(full)
        if found is None:
            return None
        frame, stamp, names, numbers = found
        if kind in _JOINTS:
            position, velocity, effort = (np.array(values, np.float64) for values in numbers)
            return Joints(tuple(names), position, velocity, effort, stamp)
        if names:
            is_homed, is_busy = numbers[0]
            return OperatingState(names[0], is_homed != 0.0, is_busy != 0.0)
        value = np.array(numbers, np.float64)
        return Cartesian(value[0] if len(value) == 1 else value, frame, stamp)

    def _find(self, topic: str) -> Tuple[str, str, bool]:
        try:
            return self._topics[topic]
        except KeyError:
            raise NotFoundError(f"{self.name} has no topic {topic}; it has {', '.join(self._topics)}") from None

    def joints(self, topic: str) -> Joints:
        """`read`, where it is joints or a jaw. Raises NotFoundError otherwise, and before the first step."""
        message = self.read(topic)
        if not isinstance(message, Joints):
            raise NotFoundError(
                f"{self.name}/{topic}: no joints are there to be read; step first, or read another topic"
            )
        return message

    def cartesian(self, topic: str) -> Cartesian:
        """`read`, where it is a pose, a twist or a wrench. Raises NotFoundError otherwise, and before the first step."""
        message = self.read(topic)
        if not isinstance(message, Cartesian):
            raise NotFoundError(f"{self.name}/{topic}: no pose is there to be read; step first, or read another topic")
        return message
