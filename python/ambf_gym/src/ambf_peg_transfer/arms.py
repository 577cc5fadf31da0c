"""Kinematics of the arms of resources/peg_transfer, in their bases: a da Vinci PSM with the instrument 420006 of the challenge."""

from __future__ import annotations

import functools
import math
from typing import Optional

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

WRIST = 0.0508
"""From the remote centre to the wrist's pitch axis while the insertion is 0, m."""
GAP = 0.009
"""From the pitch axis to the yaw axis, m."""
TOOL = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
"""Axes of the tool's yaw link in the base while all joints are at 0. Its fingers point along -y and turn about z."""
LOWER = np.array([-1.605, -1.0472, 0.0, -3.054, -1.5708, -1.48353])
UPPER = np.array([1.599, 1.0472, 0.24, 3.054, 1.5708, 1.48353])
"""Limits of yaw, pitch, insertion, roll, wrist pitch, wrist yaw; rad, m."""

JOINTS = (
    "baselink-yawlink",
    "yawlink-pitchendlink",
    "pitchendlink-maininsertionlink",
    "maininsertionlink-toolrolllink",
    "toolrolllink-toolpitchlink",
    "toolpitchlink-toolyawlink",
)
BASES = {
    "psm1": ((0.1313066, 0.3967149, 0.8777097), (0.6974314, -0.5187393, -3.1391723)),
    "psm2": ((-0.0713554, 0.3969891, 0.876246), (0.7141681, 0.5087572, -3.0877876)),
}
"""Where arms of the scene stand: position, m, and roll, pitch, yaw about fixed axes, rad."""
FINGERS = ("toolyawlink-toolgripperleftlink", "toolyawlink-toolgripperrightlink")


def about(axis: int, angle: float) -> Array:
    """Rotation matrix about x (0), y (1) or z (2)."""
    c, s = math.cos(angle), math.sin(angle)
    matrix = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


@functools.cache
def base(arm: str) -> tuple[Array, Array]:
    """Origin, m, and axes of an arm's base in the world."""
    position, (roll, pitch, yaw) = BASES[arm]
    return np.array(position), about(2, yaw) @ about(1, pitch) @ about(0, roll)


def matrix_of(quaternion: ArrayLike) -> Array:
    """Rotation matrix of a quaternion x, y, z, w."""
    x, y, z, w = np.asarray(quaternion, np.float64) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_of(axes: Array) -> Array:
    """The quaternion x, y, z, w of a rotation matrix."""
    # The largest of the squares of the four numbers is well conditioned (Shepperd 1978).
    trace = float(np.trace(axes))
    squares = np.array([*(1.0 + 2.0 * np.diag(axes) - trace), 1.0 + trace])
    i = int(np.argmax(squares))
    a, b, c = axes[2, 1] - axes[1, 2], axes[0, 2] - axes[2, 0], axes[1, 0] - axes[0, 1]
    if i == 3:
        q = np.array([a, b, c, squares[3]])
    else:
        q = np.append(axes[:, i] + axes[i, :], (a, b, c)[i])
        q[i] = squares[i]
    quaternion: Array = q / np.linalg.norm(q)
    return quaternion


def forward(q: ArrayLike) -> tuple[Array, Array]:
    """Origin, m, and axes of the tool's yaw link in the base."""
    q1, q2, q3, q4, q5, q6 = np.asarray(q, np.float64)
    arm = about(1, -q1) @ about(0, -q2)
    wrist = arm @ np.array([0.0, 0.0, -WRIST - q3])
    bent = arm @ about(2, -q4) @ about(0, -q5)
    turned = bent @ about(1, -q6)
    return wrist + bent @ np.array([0.0, 0.0, -GAP]), turned @ TOOL


def inverse(position: ArrayLike, axes: Array) -> Optional[Array]:
    """Joints for an origin, m, and axes of the tool's yaw link in the base; None: out of reach, or beyond limits."""
    q = unlimited(position, axes)
    return q if q is not None and (q >= LOWER - 1e-9).all() and (q <= UPPER + 1e-9).all() else None


def unlimited(position: ArrayLike, axes: Array) -> Optional[Array]:
    """As `inverse`, whatever the limits are; None: the hinge of the fingers points at the remote centre."""
    p = np.asarray(position, np.float64)
    hinge = axes[:, 2]
    # The yaw axis, the wrist and the remote centre are in one plane.
    level = p - (p @ hinge) * hinge
    length = float(np.linalg.norm(level))
    if length < 1e-6:
        return None
    wrist = p - GAP * level / length
    depth = float(np.linalg.norm(wrist))
    x, y, z = wrist / depth
    q1, q2 = math.atan2(x, -z), -math.asin(max(-1.0, min(1.0, y)))
    rest = (about(1, -q1) @ about(0, -q2)).T @ axes @ TOOL.T
    q5 = -math.asin(max(-1.0, min(1.0, rest[2, 1])))
    q4 = -math.atan2(-rest[0, 1], rest[1, 1])
    q6 = -math.atan2(-rest[2, 0], rest[2, 2])
    return np.array([q1, q2, depth - WRIST, q4, q5, q6])


def matrices_of(quaternions: Array) -> Array:
    """(… x 3 x 3) rotation matrices of unit quaternions (… x 4) x, y, z, w."""
    u, w = quaternions[..., :3], quaternions[..., 3]
    x, y, z = np.moveaxis(u, -1, 0)
    zero = np.zeros_like(w)
    across = np.stack((zero, -z, y, z, zero, -x, -y, x, zero), axis=-1).reshape(*w.shape, 3, 3)
    matrices: Array = np.eye(3) + 2.0 * (w[..., None, None] * across + across @ across)
    return matrices


def unlimited_all(positions: Array, axes: Array) -> Array:
    """(… x 6) as `unlimited`, for many places: origins (… x 3), m, and axes (… x 3 x 3) of the tool's yaw link in the base."""
    hinge = axes[..., 2]
    level = positions - np.sum(positions * hinge, axis=-1, keepdims=True) * hinge
    wrist = positions - GAP * level / np.linalg.norm(level, axis=-1, keepdims=True)
    depth = np.linalg.norm(wrist, axis=-1)
    x, y, z = np.moveaxis(wrist, -1, 0) / depth
    q1, q2 = np.arctan2(x, -z), -np.arcsin(np.clip(y, -1.0, 1.0))
    c1, s1, c2, s2 = np.cos(q1), np.sin(q1), np.cos(q2), np.sin(q2)
    # about(1, -q1) @ about(0, -q2)
    arm = np.stack((c1, s1 * s2, -s1 * c2, 0.0 * c1, c2, s2, s1, -c1 * s2, c1 * c2), axis=-1).reshape(*c1.shape, 3, 3)
    rest = np.swapaxes(arm, -1, -2) @ axes @ TOOL.T
    q5 = -np.arcsin(np.clip(rest[..., 2, 1], -1.0, 1.0))
    q4 = -np.arctan2(-rest[..., 0, 1], rest[..., 1, 1])
    q6 = -np.arctan2(-rest[..., 2, 0], rest[..., 2, 2])
    return np.stack((q1, q2, depth - WRIST, q4, q5, q6), axis=-1)
