"""What can go wrong with a simulation in this process."""

from __future__ import annotations

from typing import Any, List, Optional, Tuple, Type


class AmbfError(Exception):
    """Base of the errors of this package."""


class LoadError(AmbfError, ValueError):
    """Error when a scene can't be loaded: a file that is missing or no scene, a name that is not known."""

    def __init__(self, problems: List[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems
        """One sentence a problem; those of files begin with file:line:column."""

    def __reduce__(self) -> Tuple[Type[LoadError], Tuple[List[str]]]:
        return LoadError, (self.problems,)


class RecordingError(AmbfError, RuntimeError):
    """Error when a recording can't be written, read or replayed, or when a replay is another motion than the recording."""


class NonFiniteError(AmbfError, ArithmeticError):
    """Error when a state became infinite or not a number. Nothing moves until the simulation is reset or restored."""

    def __init__(self, message: str, body: str, joint: Optional[str], step: int, command: str) -> None:
        super().__init__(message)
        self.body = body
        """Qualified identifier of the body."""
        self.joint = joint
        """A joint that holds it."""
        self.step = step
        """Iteration in which it was seen."""
        self.command = command
        """What the body was last told."""
        self.index = 0
        """Which of the simulations it was, in `step_all`."""

    def __reduce__(self) -> Tuple[Any, ...]:
        return NonFiniteError, (str(self), self.body, self.joint, self.step, self.command), {"index": self.index}


class InvalidCommand(AmbfError, ValueError):
    """Error when a command is not finite or of no known kind. Nothing has moved."""


class NotFoundError(AmbfError, LookupError):
    """Error when a name is that of no object, or part of the names of several."""


class ClosedError(AmbfError, RuntimeError):
    """Error when a closed simulation is used."""


class BusyError(AmbfError, RuntimeError):
    """Error when a simulation is used while another thread steps it."""


class StateError(AmbfError, RuntimeError):
    """Error when a state can't be saved, because the simulation was not made for it, or restored, because it is another's."""


class TreeError(AmbfError, ValueError):
    """Error when bodies are no tree of revolute, prismatic and fixed joints."""


class RenderError(AmbfError, RuntimeError):
    """Error when no picture can be drawn: OpenGL is missing or fails, or the process was forked from one that has drawn."""


class ExportError(AmbfError, ValueError):
    """Error when recordings can't be exported: a mapping that names what isn't there, a package that is missing, a folder that is there."""
