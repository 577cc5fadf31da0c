"""Rotations and transforms with the names and conventions of ROS' `tf.transformations`.

Quaternions are arrays [x, y, z, w]. Transforms are (4 x 4) arrays that multiply column vectors. Angles are in rad. The order of Euler
angles is a text: `s` for fixed or `r` for turning axes, then the axes in the order in which the turns are made; `sxyz` by default.
"""

from __future__ import annotations

import math
from typing import Any, Tuple

import numpy as np

__all__ = [
    "concatenate_matrices",
    "euler_from_matrix",
    "euler_from_quaternion",
    "euler_matrix",
    "identity_matrix",
    "inverse_matrix",
    "quaternion_about_axis",
    "quaternion_conjugate",
    "quaternion_from_euler",
    "quaternion_from_matrix",
    "quaternion_inverse",
    "quaternion_matrix",
    "quaternion_multiply",
    "quaternion_slerp",
    "rotation_matrix",
    "translation_from_matrix",
    "translation_matrix",
    "unit_vector",
    "vector_norm",
]

_EPSILON = 1e-12


def _order(axes: str) -> Tuple[bool, int, int, int]:
    """Whether the axes turn, and the three of them. Raises ValueError for a text that is no order."""
    if len(axes) == 4 and axes[0] in "sr" and set(axes[1:]) <= set("xyz") and axes[2] not in (axes[1], axes[3]):
        i, j, k = ("xyz".index(axis) for axis in axes[1:])
        return axes[0] == "r", i, j, k
    raise ValueError(f"{axes!r} is no order of axes; one is 'sxyz'")


# --- vectors --------------------------------------------------------------------------------------------------------------------


def vector_norm(data: Any) -> float:
    """Length of a vector."""
    return float(np.linalg.norm(np.asarray(data, dtype=float)))


def unit_vector(data: Any) -> Any:
    """A vector of length 1 in the direction of `data`, which is not zero."""
    data = np.asarray(data, dtype=float)
    return data / np.linalg.norm(data)


# --- quaternions ----------------------------------------------------------------------------------------------------------------


def quaternion_about_axis(angle: float, axis: Any) -> Any:
    """The rotation by `angle` about `axis`, whose length does not matter."""
    return np.array([*(math.sin(angle / 2) * unit_vector(axis)), math.cos(angle / 2)])


def quaternion_multiply(quaternion1: Any, quaternion0: Any) -> Any:
    """The rotation `quaternion0` followed by `quaternion1`, both about fixed axes."""
    v1, w1 = np.asarray(quaternion1[:3], dtype=float), quaternion1[3]
    v0, w0 = np.asarray(quaternion0[:3], dtype=float), quaternion0[3]
    return np.array([*(w1 * v0 + w0 * v1 + np.cross(v1, v0)), w1 * w0 - v1 @ v0])


def quaternion_conjugate(quaternion: Any) -> Any:
    """The quaternion with its vector turned round."""
    x, y, z, w = quaternion
    return np.array([-x, -y, -z, w], dtype=float)


def quaternion_inverse(quaternion: Any) -> Any:
    """The rotation back."""
    return quaternion_conjugate(quaternion) / np.dot(quaternion, quaternion)


def quaternion_from_euler(ai: float, aj: float, ak: float, axes: str = "sxyz") -> Any:
    """The rotation of three turns."""
    turning, *order = _order(axes)
    total = np.array([0.0, 0.0, 0.0, 1.0])
    for angle, axis in zip((ai, aj, ak), order):
        turn = quaternion_about_axis(angle, np.eye(3)[axis])
        total = quaternion_multiply(total, turn) if turning else quaternion_multiply(turn, total)
    return total


def quaternion_matrix(quaternion: Any) -> Any:
    """(4 x 4) transform of a rotation; the identity for the zero quaternion."""
    x, y, z, w = (float(part) for part in quaternion)
    matrix = np.eye(4)
    norm2 = x * x + y * y + z * z + w * w
    if norm2 > _EPSILON * _EPSILON:
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        matrix[:3, :3] += (2.0 / norm2) * (w * cross + cross @ cross)
    return matrix


def quaternion_from_matrix(matrix: Any) -> Any:
    """The rotation of a transform, (4 x 4) or (3 x 3)."""
    m = np.asarray(matrix, dtype=float)[:3, :3]
    trace = np.trace(m)
    # The squares of all four, times 4: the largest is divided by.
    squares = np.array(
        [1.0 - trace + 2.0 * m[0, 0], 1.0 - trace + 2.0 * m[1, 1], 1.0 - trace + 2.0 * m[2, 2], 1.0 + trace]
    )
    largest = 3 if trace > 0.0 else int(np.argmax(squares[:3]))
    twist = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    if largest == 3:
        quaternion = np.array([*twist, squares[3]])
    else:
        quaternion = np.array([*(m[:, largest] + m[largest, :]), twist[largest]])
        quaternion[largest] = squares[largest]
    return quaternion / np.linalg.norm(quaternion)


def quaternion_slerp(quat0: Any, quat1: Any, fraction: float) -> Any:
    """The rotation at `fraction` (0 … 1) of the shortest way from one to the other, at constant speed."""
    q0, q1 = unit_vector(quat0), unit_vector(quat1)
    if q0 @ q1 < 0.0:
        q1 = -q1
    angle = 2.0 * math.atan2(vector_norm(q1 - q0), vector_norm(q1 + q0))
    if angle < _EPSILON:
        return q0
    return (math.sin((1.0 - fraction) * angle) * q0 + math.sin(fraction * angle) * q1) / math.sin(angle)


# --- Euler angles ---------------------------------------------------------------------------------------------------------------


def euler_matrix(ai: float, aj: float, ak: float, axes: str = "sxyz") -> Any:
    """(4 x 4) transform of three turns."""
    return quaternion_matrix(quaternion_from_euler(ai, aj, ak, axes))


def euler_from_matrix(matrix: Any, axes: str = "sxyz") -> Tuple[float, float, float]:
    """Angles of the three turns of a transform, (4 x 4) or (3 x 3). Where only a sum of two is defined, the last of fixed axes is 0."""
    turning, i, j, k = _order(axes)
    if turning:
        # Turns about turning axes are those about fixed ones in reverse.
        i, k = k, i
    m = np.asarray(matrix, dtype=float)[:3, :3]
    third = 3 - i - j
    first, middle, last = 0.0, 0.0, 0.0
    if i == k:
        sine = math.hypot(m[i, j], m[i, third])
        middle = math.atan2(sine, m[i, i])
        if sine > _EPSILON:
            first, last = math.atan2(m[i, j], m[i, third]), math.atan2(m[j, i], -m[third, i])
        else:
            first = math.atan2(-m[j, third], m[j, j])
    else:
        cosine = math.hypot(m[i, i], m[j, i])
        middle = math.atan2(-m[k, i], cosine)
        if cosine > _EPSILON:
            first, last = math.atan2(m[k, j], m[k, k]), math.atan2(m[j, i], m[i, i])
        else:
            first = math.atan2(-m[j, k], m[j, j])
    if (j - i) % 3 != 1:
        # The axes are a left-handed system.
        first, middle, last = -first, -middle, -last
    return (last, middle, first) if turning else (first, middle, last)


def euler_from_quaternion(quaternion: Any, axes: str = "sxyz") -> Tuple[float, float, float]:
    """Angles of the three turns of a rotation; see `euler_from_matrix`."""
    return euler_from_matrix(quaternion_matrix(quaternion), axes)


# --- transforms -----------------------------------------------------------------------------------------------------------------


def identity_matrix() -> Any:
    """(4 x 4) transform that changes nothing."""
    return np.eye(4)


def translation_matrix(direction: Any) -> Any:
    """(4 x 4) transform that moves by `direction`."""
    matrix = np.eye(4)
    matrix[:3, 3] = direction[:3]
    return matrix


def translation_from_matrix(matrix: Any) -> Any:
    """[x, y, z] of what a transform moves the origin to."""
    return np.array(np.asarray(matrix, dtype=float)[:3, 3])


def rotation_matrix(angle: float, direction: Any, point: Any = None) -> Any:
    """(4 x 4) transform that turns by `angle` about the axis `direction` through `point`, by default the origin."""
    matrix = quaternion_matrix(quaternion_about_axis(angle, direction[:3]))
    if point is not None:
        centre = np.asarray(point[:3], dtype=float)
        matrix[:3, 3] = centre - matrix[:3, :3] @ centre
    return matrix


def concatenate_matrices(*matrices: Any) -> Any:
    """The product of transforms: the last is done first."""
    total = np.eye(4)
    for matrix in matrices:
        total = total @ matrix
    return total


def inverse_matrix(matrix: Any) -> Any:
    """The transform back."""
    return np.linalg.inv(matrix)
