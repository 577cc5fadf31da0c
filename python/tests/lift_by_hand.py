"""A policy for the task of lifting and placing that was written, not learnt."""

import numpy as np

_SPEED = 0.5
_HEIGHT = -1.2


class Hand:
    """Goes down to the block, takes it up, carries it, puts it down, lets go."""

    def __init__(self):
        self._phase = 0

    def __call__(self, observation):
        """The action: velocity of the palm as a share of its largest one, and whether to hold."""
        palm, block, goal = (
            np.asarray(observation[part], dtype=float) for part in (slice(0, 3), slice(3, 6), slice(-3, None))
        )
        holds = observation[16] > 0.5
        away = [
            block + np.array([0.0, 0.0, 0.09]) - palm,
            np.zeros(3),
            [0.0, 0.0, _HEIGHT - palm[2]],
            [*(goal - block)[:2], 0.0],
            [0.0, 0.0, (goal - block)[2]],
            np.zeros(3),
        ][self._phase]
        arrived = holds if self._phase == 1 else np.linalg.norm(away) < 0.005
        hold = 1.0 if 1 <= self._phase <= 4 else -1.0
        if arrived and self._phase < 5:
            self._phase += 1
        return np.append(np.clip(10.0 * np.asarray(away) / _SPEED, -1.0, 1.0), hold)
