"""Kinematics and dynamics of trees of bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING, List, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .names import find, place

if TYPE_CHECKING:
    from . import _ambf
    from .simulation import Simulation

Array = NDArray[np.float64]


class Reached(NamedTuple):
    """What inverse kinematics found."""

    joint_positions: Array
    """(joints of the tree) rad or m, within the limits."""
    position_error: float
    """Distance that is left, m; 0 if no position was wanted."""
    rotation_error: float
    """Angle that is left, rad; 0 if no orientation was wanted."""
    reached: bool
    """Whether both are within the tolerance."""


class Tree:
    """Bodies that revolute, prismatic and fixed joints hold together: Jacobians, mass matrix, forces, inverse kinematics.

    They follow from masses, inertias, frames and coordinates, not from the solver, and are the same in every profile. Joints have no
    gap. The inertia of rotors (armature) is part of them. What joints lose (damping, friction), springs, motors, limits, contacts and
    what actuators hold is not, nor are couplings: they are rows of `coupling_rows`.

    **Rates** (n) are, if the base is free, its twist as in `Simulation.twists` (velocity of its centre of mass, m/s; angular velocity,
    rad/s; world axes), and then those of the joints in the order of `joints`, which is that of `Simulation.joints` (rad/s or m/s).
    Accelerations are the derivatives of these numbers. **Forces** (n) go with them: force, N, at the base's centre of mass and torque,
    N·m, as in `Simulation.wrenches`; then torque, N·m, or force, N, of each joint.

    Every method asks for the present state of the arrays of the simulation, unless `joint_positions` (joints), `rates` (n) or
    `base_pose` (7: position, m, and quaternion x, y, z, w of the base's body frame, world) are given. Numbers of the wrong shape, or
    that are not finite, are a ValueError. A base that is not free counts as at rest.

    Sources: Featherstone, Rigid Body Dynamics Algorithms, 2008 (recursive Newton-Euler, composite rigid bodies); Nakamura and Hanafusa,
    1986 (damped least squares).
    """

    def __init__(self, simulation: Simulation, body: int) -> None:
        self.simulation = simulation
        self._body = simulation.bodies[body]
        self._bind()

    def _bind(self) -> None:
        self._revision = self.simulation._world.revision
        self._inside = inside = self.simulation._world.tree(place(self._body, self.simulation.bodies, "bodies"))
        self.bodies: Tuple[str, ...] = tuple(inside.bodies_by_name)
        """Names of the bodies; the first is the base, each other one comes after what it hangs on."""
        self.joint_indices: NDArray[np.intp] = np.array(inside.joints, dtype=np.intp)
        """(joints) where they stand in the simulation's arrays."""
        self.joints: Tuple[str, ...] = tuple(self.simulation.joints[index] for index in inside.joints)
        """Names of the joints with a coordinate, in the order of the simulation."""
        self.is_free: bool = inside.is_free
        """Whether no body of it stands still."""

    @property
    def size(self) -> int:
        """n: number of rates."""
        return len(self.joints) + (6 if self.is_free else 0)

    @property
    def joint_positions(self) -> Array:
        """(joints) present ones, rad or m: a copy."""
        self._current()
        return self.simulation.joint_positions[self.joint_indices]

    @property
    def rates(self) -> Array:
        """(n) present ones: a copy."""
        self._current()
        joints = self.simulation.joint_velocities[self.joint_indices]
        return np.concatenate([self._state()[1], joints]) if self.is_free else joints

    def poses(self, *, joint_positions: Optional[ArrayLike] = None, base_pose: Optional[ArrayLike] = None) -> Array:
        """(bodies x 7) forward kinematics: position, m, and quaternion of the body frames, world, in the order of `bodies`."""
        return self._current().poses(*self._place(joint_positions, base_pose)).reshape(-1, 7)

    def jacobian(
        self,
        body: Union[str, int],
        point: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        joint_positions: Optional[ArrayLike] = None,
        base_pose: Optional[ArrayLike] = None,
    ) -> Array:
        """(6 x n) what rates do to a point that is fixed to a body, given in its body frame, m: rows 0 to 2 are the velocity of the point,
        m/s, rows 3 to 5 the angular velocity of the body, rad/s, world axes.

        `body`: a name or the end of one, or an index in `bodies`. Raises NotFoundError, ValueError, ClosedError, BusyError.
        """
        link = self._link(body)
        inside = self._current()
        return inside.jacobian(*self._place(joint_positions, base_pose), link, _three(point)).reshape(6, -1)

    def mass_matrix(
        self, *, joint_positions: Optional[ArrayLike] = None, base_pose: Optional[ArrayLike] = None
    ) -> Array:
        """(n x n) M, symmetric and positive: rates · M · rates / 2 is the kinetic energy, J; forces = M · accelerations + bias forces.

        Rotors add their inertia to the diagonal, as in MuJoCo.
        """
        return self._current().mass_matrix(*self._place(joint_positions, base_pose)).reshape(self.size, self.size)

    def coupling_rows(self) -> Array:
        """(couplings of the tree x n) C, with C · rates = 0: 1 for a joint that follows others, minus its ratio for each of those.

        With them accelerations a and forces λ of the couplings follow from M · a + bias forces = forces + Cᵀ · λ and C · a = 0. A joint
        that follows one of another tree has no row.
        """
        return self._current().coupling_rows().reshape(-1, self.size)

    def inverse_dynamics(
        self,
        accelerations: Optional[ArrayLike] = None,
        *,
        rates: Optional[ArrayLike] = None,
        joint_positions: Optional[ArrayLike] = None,
        base_pose: Optional[ArrayLike] = None,
    ) -> Array:
        """(n) forces that give the tree these accelerations (none: 0), against gravity."""
        wanted = np.zeros(self.size) if accelerations is None else _numbers(accelerations)
        place = self._place(joint_positions, base_pose)
        return self._current().inverse_dynamics(*place, self._rates(rates), wanted)

    def gravity_forces(
        self, *, joint_positions: Optional[ArrayLike] = None, base_pose: Optional[ArrayLike] = None
    ) -> Array:
        """(n) forces that hold the tree at rest against gravity."""
        return self._current().gravity_forces(*self._place(joint_positions, base_pose))

    def coriolis_forces(
        self,
        *,
        rates: Optional[ArrayLike] = None,
        joint_positions: Optional[ArrayLike] = None,
        base_pose: Optional[ArrayLike] = None,
    ) -> Array:
        """(n) forces that keep the rates as they are without gravity: Coriolis, centrifugal and gyroscopic effects."""
        place = self._place(joint_positions, base_pose)
        return self._current().coriolis_forces(*place, self._rates(rates))

    def bias_forces(
        self,
        *,
        rates: Optional[ArrayLike] = None,
        joint_positions: Optional[ArrayLike] = None,
        base_pose: Optional[ArrayLike] = None,
    ) -> Array:
        """(n) `gravity_forces` + `coriolis_forces`: what MuJoCo calls `qfrc_bias`."""
        return self.inverse_dynamics(rates=rates, joint_positions=joint_positions, base_pose=base_pose)

    def inverse_kinematics(
        self,
        body: Union[str, int],
        position: Optional[Sequence[float]] = None,
        orientation: Optional[Sequence[float]] = None,
        *,
        point: Sequence[float] = (0.0, 0.0, 0.0),
        start: Optional[ArrayLike] = None,
        tolerance: Tuple[float, float] = (1e-6, 1e-6),
        iterations: int = 200,
        base_pose: Optional[ArrayLike] = None,
    ) -> Reached:
        """Joint positions with which a point of a body (in its frame, m) is at `position` (3, m, world), and the body turned as
        `orientation` (quaternion x, y, z, w, world) says; one of the two may be missing. The base stays where it is.

        Damped least squares within the limits of the joints, from `start` (joints; None: the present ones): it finds what is near. What
        is not reached is not an error: see `Reached`. `tolerance`: m and rad. Raises NotFoundError, ValueError, ClosedError, BusyError.
        """
        if position is None and orientation is None:
            raise ValueError("give a position, an orientation or both")
        if not (len(tolerance) == 2 and all(most >= 0 for most in tolerance)):
            raise ValueError(f"tolerance: expected two numbers of at least 0, m and rad, not {tolerance}")
        if iterations < 0:
            raise ValueError(f"iterations={iterations}: expected 0 or more")
        link = self._link(body)
        inside = self._current()
        base, begin = self._place(start, base_pose)
        return Reached(
            *inside.inverse_kinematics(
                base,
                begin,
                link,
                _three(point),
                None if position is None else _three(position),
                None if orientation is None else _list(orientation, 4, "orientation"),
                tolerance,
                iterations,
            )
        )

    def _link(self, body: Union[str, int]) -> int:
        self._current()
        return find(body, self.bodies, "bodies of the tree")

    def _current(self) -> _ambf.Tree:
        # Masses, limits, gravity or the scene were changed.
        if self.simulation._world.revision != self._revision:
            self._bind()
        return self._inside

    def _state(self) -> Tuple[List[float], List[float]]:
        return self.simulation._world.tree_base(self._current())

    def _place(self, positions: Optional[ArrayLike], base: Optional[ArrayLike]) -> Tuple[List[float], Array]:
        pose = self._state()[0] if base is None else _list(base, 7, "base_pose")
        return pose, self.joint_positions if positions is None else _numbers(positions)

    def _rates(self, rates: Optional[ArrayLike]) -> Array:
        return self.rates if rates is None else _numbers(rates)

    def __repr__(self) -> str:
        base = "free base" if self.is_free else "base"
        return f"<ambf.Tree: {base} {self.bodies[0]}, {len(self.bodies)} bodies, {len(self.joints)} joints>"


def _numbers(values: ArrayLike) -> Array:
    return np.ascontiguousarray(values, dtype=np.float64).reshape(-1)


def _three(point: ArrayLike) -> List[float]:
    return _list(point, 3, "a point")


def _list(values: ArrayLike, count: int, what: str) -> List[float]:
    numbers = np.asarray(values, dtype=np.float64)
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise ValueError(f"{what}: expected {count} finite numbers, not {values!r}")
    listed: List[float] = numbers.tolist()
    return listed
