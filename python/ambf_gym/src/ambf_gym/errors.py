"""What can go wrong in an environment; what comes from the simulator are the errors of `ambf_client`."""

from __future__ import annotations


class GymError(Exception):
    """Base of the errors of this package."""


class InvalidAction(GymError, ValueError):
    """Error when an action has the wrong shape or holds a number that is not finite. Nothing has moved."""


class InvalidDescription(GymError, ValueError):
    """Error when a description names what the scene does not have, or lacks bounds that the scene does not tell."""


class NotObserved(GymError, KeyError):
    """Error when a task asks for a body, joint, sensor or actuator that it does not observe, or that is not there."""

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""


class StepMismatch(GymError, RuntimeError):
    """Error when the simulator has made another number of iterations than was asked for: somebody else steps or resets it."""


class SimulatorFailed(GymError, RuntimeError):
    """Error when the environment's own simulator does not start; the message holds what it printed."""
