"""What objects and the world have in common: the newest state, and a command that the client publishes."""

from __future__ import annotations

import threading
import time
from typing import Any, Callable, Optional

from .errors import SimulationLost, SimulatorTimeout
from .watch_dog import WatchDog

# Between two looks whether the simulation is lost while a state is waited for, s.
_LOOK_S = 0.1

# A state that is more than this older than the last step comes from a simulator that was started again.
_LATE_STEPS = 5000


class Health:
    """Whether the simulation's state is to be trusted: one for all handles of a client."""

    def __init__(self) -> None:
        self.lost = ""
        """Where and why the state was lost; empty while all is well."""

    def check(self) -> None:
        """Raises SimulationLost while the simulation is lost."""
        if self.lost:
            raise SimulationLost(self.lost)


class Handle(WatchDog):
    """A topic of states and a topic of commands."""

    def __init__(self, a_name: str, time_out: float, state: Any, command: Any, topic: str) -> None:
        """`a_name`: name of the handle; `time_out` of the watch dog in s; `state` and `command`: empty messages; `topic`: what its topics
        begin with.
        """
        super().__init__(time_out)
        self.pub_flag = True
        self._name = a_name
        self._topic = topic
        self._newest = state
        self._cmd = command
        self._pub: Any = None
        self._sub: Any = None
        self._active = False
        self._count = 0
        # Older states than that of the last step may still be on their way.
        self._stepped: Optional[int] = None
        self._health = Health()
        # Guards the command: it is published in another thread.
        self._lock = threading.RLock()
        self._arrived = threading.Condition()

    @property
    def _state(self) -> Any:
        """The newest state; raises SimulationLost while the simulation is lost."""
        self._health.check()
        return self._newest

    @_state.setter
    def _state(self, state: Any) -> None:
        self._newest = state

    def ros_cb(self, data: Any) -> None:
        """Takes a state; the subscriber's callback."""
        with self._arrived:
            if self._is_late(data):
                return
            self._stepped = None
            self._state = data
            self._count += 1
            self._arrived.notify_all()

    def _close(self, end: Any) -> None:
        """Ends a publisher or subscriber, if it is one."""
        if end is not None and self._ral is not None:
            self._ral.close(end)

    def _is_late(self, state: Any) -> bool:
        """Whether a state is older than that of the last step."""
        return self._stepped is not None and 0 < self._stepped - state.sim_step < _LATE_STEPS

    def get_name(self) -> str:
        """Name of this handle."""
        return self._name

    def set_name(self, name: str) -> None:
        """Renames this handle."""
        self._name = name

    def is_active(self) -> bool:
        """Whether the client's thread publishes the command."""
        return self._active

    def get_sim_step(self) -> int:
        """Physics iterations since the simulator started."""
        return int(self._state.sim_step)

    def wait_for_state(self, is_there: Callable[[Any], bool], timeout: float = 5.0) -> Any:
        """Waits until a state has arrived for which `is_there` is true; the state.

        Raises SimulatorTimeout after `timeout` s, SimulationLost as soon as the simulation is lost.
        """

        def found() -> bool:
            state = self._state
            return self._count > 0 and is_there(state)

        end = time.monotonic() + timeout
        with self._arrived:
            while not self._arrived.wait_for(found, max(0.0, min(_LOOK_S, end - time.monotonic()))):
                if time.monotonic() >= end:
                    spoke = "the last one does not do" if self._count else "none has come at all"
                    raise SimulatorTimeout(f"{self._name}: no such state within {timeout} s; {spoke}")
            return self._newest

    def wait_for_step(self, step: int, timeout: float = 5.0) -> int:
        """Waits until the state is of step `step` or later; its step.

        Raises SimulatorTimeout after `timeout` s, SimulationLost as soon as the simulation is lost.
        """
        return int(self.wait_for_state(lambda state: state.sim_step >= step, timeout).sim_step)
