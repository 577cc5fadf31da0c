"""Rotations: quaternions (x, y, z, w) and angles about fixed axes."""

from __future__ import annotations

import math
from typing import Protocol, Tuple

Quaternion = Tuple[float, float, float, float]


class QuaternionLike(Protocol):
    """Anything with the fields of `geometry_msgs/Quaternion`."""

    x: float
    y: float
    z: float
    w: float


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """The rotation `b` followed by `a`, both about fixed axes."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def about(axis: int, angle: float) -> Quaternion:
    """The rotation by `angle` (rad) about axis 0 (x), 1 (y) or 2 (z)."""
    xyz = [0.0, 0.0, 0.0]
    xyz[axis] = math.sin(angle / 2)
    return xyz[0], xyz[1], xyz[2], math.cos(angle / 2)


def quaternion_from_rpy(roll: float, pitch: float, yaw: float) -> Quaternion:
    """The rotation about the fixed axes x, then y, then z (axes `sxyz` of `tf.transformations`); angles in rad."""
    return multiply(about(2, yaw), multiply(about(1, pitch), about(0, roll)))


def quaternion_from_zyx(first: float, second: float, third: float) -> Quaternion:
    """The rotation about the fixed axes z by `first`, then y by `second`, then x by `third` (axes `szyx`); angles in rad."""
    return multiply(about(0, third), multiply(about(1, second), about(2, first)))


def rpy_from_quaternion(q: QuaternionLike) -> Tuple[float, float, float]:
    """Angles (roll, pitch, yaw) in rad about the fixed axes x, y, z; (0, 0, 0) for the zero quaternion.

    At a pitch of ±π/2 only the difference of the others is defined: yaw is then 0.
    """
    x, y, z, w = q.x, q.y, q.z, q.w
    norm2 = x * x + y * y + z * z + w * w
    if norm2 < 1e-30:
        return 0.0, 0.0, 0.0
    s = 2.0 / norm2
    m00 = 1.0 - s * (y * y + z * z)
    m10 = s * (x * y + z * w)
    m20 = s * (x * z - y * w)
    cos_pitch = math.hypot(m00, m10)
    pitch = math.atan2(-m20, cos_pitch)
    if cos_pitch > 1e-12:
        roll = math.atan2(s * (y * z + x * w), 1.0 - s * (x * x + y * y))
        return roll, pitch, math.atan2(m10, m00)
    return math.atan2(-s * (y * z - x * w), 1.0 - s * (x * x + z * z)), pitch, 0.0
