"""Recordings that are replayed."""

from __future__ import annotations

import math
import os
from typing import Callable, Dict, Iterator, List, Optional, Sequence, Tuple, Union

import numpy as np
from numpy.typing import NDArray

from . import _ambf
from .errors import RecordingError
from .simulation import Array, Path, Simulation

Quantity = Union[str, Callable[[Simulation], object]]
"""The name of an array of states of a `Simulation`, or what a function makes of the simulation."""

_MOST_UPDATES = 2**63


class Recording:
    """A recording, and a simulation that follows it.

    `simulation` is at the beginning at first; `advance`, `seek` and iteration move it as it was moved when it was recorded, bit for bit on
    the same build and processor; otherwise RecordingError says after which iteration it differs. Whoever steps the simulation goes on from
    there alone, with commands of their own.
    """

    def __init__(self, path: Path, *, changed_files: bool = False) -> None:
        """Opens a recording and loads its scene; `changed_files`: also if files of the scene have changed since.

        Raises RecordingError.
        """
        self.path = os.fspath(path)
        self._changed_files = changed_files
        self._over = False
        self._open()
        self.program, self.processor, self.updates, self.interval, self.end = self._replay.about()
        """Program and processor that recorded; number of updates, their mean interval, s, and simulated time at the end, s."""
        self.ended, self.problem = self._replay.ended()
        """How the recording ended: `stopped`, as it was to; `overflow`, `too large`, `went back`, `cut off` or `damaged`, before that. A
        sentence where it is not whole, else None; it is replayed as far as it goes."""
        self.world, self.models, self.files = self._replay.files()
        """World file, model files, and all files with the SHA-256 of what was in them."""
        self.notes: List[Tuple[float, str]] = self._replay.notes()
        """Simulated times, s, and texts of what was noted."""

    def _open(self) -> None:
        self._replay, world = _ambf.Replay.open(self.path, self._changed_files)
        self.simulation = Simulation._of(world)
        self._over = False

    def __repr__(self) -> str:
        return f"<ambf.Recording: {self.path}, {self.updates} updates to {self.end:.3f} s, at {self.simulation.sim_time:.3f} s>"

    def advance(self, updates: int = 1) -> int:
        """Replays so many updates, or as many as there still are; how many were made. Raises RecordingError."""
        if updates < 0:
            raise ValueError(f"{updates} updates: expected 0 or more")
        made, self._over = self._replay.advance(self.simulation._world, updates, math.inf)
        return made

    def seek(self, time: float) -> None:
        """Replays until simulated time is `time` s or later, or the recording is over. Backwards it begins anew, with a new `simulation`:
        states cannot be loaded from a recording. Raises RecordingError.
        """
        if not math.isfinite(time):
            raise ValueError(f"{time} is no time")
        if time < self.simulation.sim_time:
            self.simulation.close()
            self._open()
        _, self._over = self._replay.advance(self.simulation._world, _MOST_UPDATES, time)

    def restart(self) -> Simulation:
        """Begins anew, with a new `simulation`, which is returned; the one before stays where it is, for its user."""
        self._open()
        return self.simulation

    def __iter__(self) -> Iterator[Simulation]:
        """The simulation after each further update."""
        while self.advance():
            yield self.simulation

    def sample(self, rate: Optional[float] = None, begin: Optional[float] = None) -> Iterator[Simulation]:
        """The simulation as it is at the simulated time `begin`, s (None: at the beginning), and then `rate` times a simulated second
        (None: after each update): after the first update that is not before the time. Begins anew.
        """
        if rate is not None and not (math.isfinite(rate) and rate > 0):
            raise ValueError(f"rate {rate}: expected a number above 0")
        self.restart()
        if begin is not None:
            self.seek(max(begin - 1e-9, self.simulation.sim_time))
        begin = self.simulation.sim_time
        yield self.simulation
        count = 0
        while True:
            if rate is None:
                if not self.advance():
                    return
            else:
                count += 1
                # Sums of intervals are not exact.
                time = begin + count / rate - 1e-9
                self.seek(max(time, self.simulation.sim_time))
                if self.simulation.sim_time < time:
                    return
            yield self.simulation

    def arrays(
        self,
        quantities: Sequence[str] = ("poses", "twists", "joint_positions", "joint_velocities", "joint_efforts"),
        rate: Optional[float] = None,
        **functions: Callable[[Simulation], object],
    ) -> Dict[str, NDArray[np.float64]]:
        """Quantities over time, with the time as `time`: (samples x the shape of the quantity). `quantities` are names of arrays of states;
        `functions` are further quantities by their names, made of the simulation. See `sample`.
        """
        for name in quantities:
            if not isinstance(getattr(self.simulation, name, None), np.ndarray):
                raise RecordingError(f"{name!r} is no array of a simulation")
        found: Dict[str, List[Array]] = {name: [] for name in ("time", *quantities, *functions)}
        for simulation in self.sample(rate):
            found["time"].append(np.float64(simulation.sim_time))
            for name in quantities:
                found[name].append(np.array(getattr(simulation, name), dtype=np.float64))
            for name, function in functions.items():
                found[name].append(np.array(function(simulation), dtype=np.float64))
        return {name: np.array(values) for name, values in found.items()}

    @property
    def joint_targets(self) -> Array:
        """(joints) position that each joint was commanded to last, rad or m; NaN: it is commanded otherwise, or was not at all."""
        return np.array(self._replay.targets(self.simulation._world)[0], dtype=np.float64)

    @property
    def target_poses(self) -> Array:
        """(bodies x 7) pose that each body was commanded to last; NaN: it is commanded otherwise, or was not at all."""
        return np.array(self._replay.targets(self.simulation._world)[1], dtype=np.float64).reshape(-1, 7)

    def close(self) -> None:
        """Frees the simulation."""
        self.simulation.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
