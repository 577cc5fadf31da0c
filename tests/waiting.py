"""Waits for conditions instead of for time to pass: for tests with ROS 1, with ROS 2 and with both."""

import time

# Every wait ends as soon as its condition holds; this only bounds a failing test, on a busy machine too.
PATIENCE_S = 60.0


def wait_for(condition, what, seconds=PATIENCE_S, pause=lambda: time.sleep(0.02)):
    """Polls `condition`, with `pause` between, until it is true and returns its value; fails after `seconds` with `what`, a
    text or what returns one."""
    end = time.monotonic() + seconds
    while True:
        value = condition()
        if value:
            return value
        if time.monotonic() > end:
            said = what() if callable(what) else what
            raise AssertionError(f"not within {seconds:.0f} s: {said}; last value {value!r}")
        pause()
