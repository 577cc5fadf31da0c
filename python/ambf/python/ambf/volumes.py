"""Volumes: voxels that are cut, measured and saved."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, List, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _ambf
from .names import find, place

if TYPE_CHECKING:
    from .simulation import Simulation


class Label(NamedTuple):
    """What voxels of one label have in common."""

    name: str
    """Empty: it has none."""
    color: Tuple[int, int, int]
    """Red, green, blue, 0 to 255."""
    hardness: float
    """Cost of cutting relative to other labels."""


class Carved(NamedTuple):
    """What a cut has removed, the nearest to the shape's way first."""

    indices: NDArray[np.uint32]
    """(voxels x 3) along x, y, z: column, row from below, picture."""
    colors: NDArray[np.uint8]
    """(voxels x 4) red, green, blue, alpha of before, 0 to 255."""
    labels: NDArray[np.uint8]
    """(voxels) labels of before."""
    volume: float
    """m³."""


class Volume:
    """A volume of a simulation. Voxels are cut between iterations; a reset and a restored state bring them back."""

    def __init__(self, simulation: Simulation, name: Union[str, int]) -> None:
        self._simulation = simulation
        names = simulation.volumes
        self.name = names[find(name, names, "volumes")]

    def __repr__(self) -> str:
        return f"<ambf.Volume {self.name}>"

    def _bind(self) -> Tuple[_ambf.World, int]:
        world = self._simulation._world
        return world, place(self.name, world.volumes, "volumes")

    @property
    def size(self) -> Tuple[int, int, int]:
        """Voxels along x, y and z."""
        world, volume = self._bind()
        x, y, z = world.volume_info(volume)[0]
        return x, y, z

    @property
    def spacing(self) -> NDArray[np.float64]:
        """(3) edges of a voxel, m."""
        world, volume = self._bind()
        return np.array(world.volume_info(volume)[1])

    @property
    def pose(self) -> NDArray[np.float64]:
        """(7) x, y, z, qx, qy, qz, qw of the centre of the box, in the world."""
        world, volume = self._bind()
        return np.array(world.volume_info(volume)[2])

    @property
    def labels(self) -> List[Label]:
        """What labels stand for; the first, 0, for nothing."""
        world, volume = self._bind()
        return [Label(name, (r, g, b), hardness) for name, (r, g, b), hardness in world.volume_info(volume)[3]]

    def carve(
        self,
        start: ArrayLike = (0.0, 0.0, 0.0),
        end: Optional[ArrayLike] = None,
        *,
        radius: Optional[float] = None,
        length: Optional[float] = None,
        edges: Optional[Sequence[float]] = None,
        voxels: Optional[ArrayLike] = None,
        rate: Optional[float] = None,
        interval: Optional[float] = None,
        count: Optional[int] = None,
        frame: str = "world",
    ) -> Carved:
        """Removes the solid voxels that a shape covers on its way from `start` to `end` (default: it stays).

        Both are places (3) or poses (7), m, in the frame "world" or "volume". The shape is a ball of `radius`; with `length`, a
        capsule along its x axis whose cylinder is so long; with `edges` (3), a box; or `voxels` are (voxels x 3) indices. All that
        is covered goes, unless `rate` (m³/s) and `interval` (s) or `count` say how much: the nearest to the way then, and voxels of
        a hardness above 1 cost more of the rate. `voxels` go as a whole. Raises ValueError, also for a stroke that would take
        too long: divide it. Nothing is cut then.
        """
        poses = _pose("start", start), _pose("end", start if end is None else end)
        if frame not in ("world", "volume"):
            raise ValueError(f'frame: expected "world" or "volume", not {frame!r}')
        indices: List[List[int]] = []
        if sum(given is not None for given in (radius, edges, voxels)) != 1:
            raise ValueError("expected one of radius, edges and voxels")
        if length is not None and radius is None:
            raise ValueError("length belongs to a radius")
        if radius is not None and length is not None:
            shape = ("capsule", [float(radius), 0.5 * float(length)])
        elif radius is not None:
            shape = ("sphere", [float(radius)])
        elif edges is not None:
            shape = ("box", [float(edge) for edge in edges])
        else:
            shape = ("voxels", [])
            listed = np.asarray(voxels)
            if listed.size and (listed.ndim != 2 or listed.shape[1] != 3 or listed.dtype.kind not in "iu"):
                raise ValueError(f"voxels: expected (voxels x 3) integers, not {listed.shape} of {listed.dtype}")
            indices = listed.tolist()
        rule: Tuple[str, List[float]] = ("all", [])
        if (rate is None) != (interval is None):
            raise ValueError("rate and interval belong together")
        if rate is not None and interval is not None:
            if count is not None:
                raise ValueError("expected a rate or a count, not both")
            rule = ("rate", [float(rate), float(interval)])
        elif count is not None:
            rule = ("count", [float(count)])
        world, volume = self._bind()
        return Carved(*world.carve(volume, shape, rule, poses, frame == "world", indices))

    def voxels(self) -> Tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Densities and labels as they are now, each (z x y x x): a copy."""
        world, volume = self._bind()
        return world.voxels(volume)

    def distance(
        self, points: ArrayLike, label: Union[str, int, None] = None, most: float = np.inf
    ) -> Tuple[NDArray[np.float64], NDArray[np.float64]]:
        """How far points are from all solid voxels, or from those of a label: `points` are (points x 3) or (3), world axes, m.

        Returns distances, negative inside and infinite where nothing is within `most`, m, and the directions in which they grow.
        They are those of the voxels of now, by their centres less half an edge. Raises ValueError, NotFoundError.
        """
        places = np.asarray(points, np.float64)
        if places.shape[-1:] != (3,) or places.ndim > 2 or not np.isfinite(places).all():
            raise ValueError(f"points: expected (points x 3) finite numbers or 3, not {places.shape}")
        if not most > 0:
            raise ValueError(f"most: expected a distance above 0, not {most}")
        number = None
        if isinstance(label, str):
            number = find(label, [name for name, _, _ in self.labels], "labels")
        elif label is not None:
            number = find(label, [str(i) for i in range(len(self.labels))], "labels")
        world, volume = self._bind()
        table = world.volume_distances(volume, places.reshape(-1, 3).tolist(), number, most).reshape(-1, 4)
        distances, gradients = table[:, 0], table[:, 1:]
        return distances.reshape(places.shape[:-1]), gradients.reshape(places.shape)

    def save(self, path: Union[str, os.PathLike[str]], prefix: str = "slice") -> None:
        """Writes the voxels: to a `.nrrd` file, the surface to `.stl` or `.ply`, or a picture a layer, `prefix<i>.png`, to a folder.

        Raises OSError.
        """
        world, volume = self._bind()
        world.save_volume(volume, os.fspath(path), prefix)

    def restore(self) -> None:
        """Brings the voxels of the start back, as a reset does."""
        world, volume = self._bind()
        world.restore_voxels(volume)


def _pose(what: str, values: ArrayLike) -> List[float]:
    numbers = np.asarray(values, np.float64)
    if numbers.shape == (3,):
        numbers = np.concatenate([numbers, [0.0, 0.0, 0.0, 1.0]])
    if numbers.shape != (7,) or not np.isfinite(numbers).all() or not numbers[3:].any():
        raise ValueError(f"{what}: expected 3 finite numbers, or 7 with a quaternion (x, y, z, w), not {numbers}")
    listed: List[float] = numbers.tolist()
    return listed
