"""What can go wrong between a client and the simulator."""

from __future__ import annotations


class ClientError(Exception):
    """Base of all errors of this package."""


class MasterNotFound(ClientError):
    """Error when no master of ROS 1 answers in time."""


class SimulatorNotFound(ClientError):
    """Error when ROS is there, but no simulator speaks in time."""


class ObjectNotFound(ClientError, LookupError):
    """Error when no object of that name, or more than one, is there in time."""


class SimulatorTimeout(ClientError, TimeoutError):
    """Error when the simulator was there, but an expected answer or state does not come in time: it ended, hangs or is paused."""


class StepRefused(ClientError):
    """Error when the simulator does not carry out a step; the message is its reason. Nothing has moved."""


class SimulationLost(ClientError):
    """Error when the simulator has paused because its state became non-finite or implausible; the message says where and why.

    `World.reset` resumes.
    """


class UnsupportedRos(ClientError, ImportError):
    """Error when the environment asks for a version of ROS that does not exist, or whose Python packages are missing."""


class UnsupportedCommand(ClientError, AttributeError):
    """Error when an object has no such command, for example a pose for a sensor."""
