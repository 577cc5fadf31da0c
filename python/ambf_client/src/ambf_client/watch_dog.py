"""A dead man's switch."""

from __future__ import annotations

from typing import Optional

from .ros_abstraction_layer import now_msg, ral, ral_may_come_first, seconds


class WatchDog:
    """Says whether more than a time has passed since the last acknowledgement. It uses ROS time."""

    _ral: Optional[ral] = None

    @ral_may_come_first
    def __init__(self, time_out: float = 0.1) -> None:
        """`time_out` in s."""
        self._watch_dog_time_out = float(time_out)
        self._watch_dog_running = False
        self._watch_dog_deadline = 0.0

    def _now(self) -> float:
        """ROS time, s."""
        return seconds(now_msg(self._ral))

    def acknowledge_wd(self) -> None:
        """Starts it, or winds it up again."""
        self._watch_dog_running = True
        self._watch_dog_deadline = self._now() + self._watch_dog_time_out

    def is_wd_expired(self) -> bool:
        """Whether it was started and the time has passed. Stays so until the next `acknowledge_wd` or `console_print`."""
        return self._watch_dog_running and self._now() > self._watch_dog_deadline

    def console_print(self, class_name: str) -> None:
        """If it was started: says that it has expired, and stops it."""
        if self._watch_dog_running:
            print(f"WatchDog expired, resetting the command of {class_name}")
            self._watch_dog_running = False

    def set_timeout(self, time_out: float) -> None:
        """Changes the time (s) from the next acknowledgement on."""
        self._watch_dog_time_out = float(time_out)
