"""Poses with plain lists: ROS has no library for that which Debian's Python brings along without NumPy."""

import copy
import math


def distance(a, b):
    """Between two poses, m."""
    return math.dist(point(a), point(b))


def point(pose):
    """Position as a tuple."""
    return (pose.position.x, pose.position.y, pose.position.z)


def quaternion(pose):
    """Orientation as a tuple x, y, z, w."""
    q = pose.orientation
    return (q.x, q.y, q.z, q.w)


def angle(a, b):
    """Between two poses, rad; the sine of the half, which is exact for small angles too."""
    ax, ay, az, aw = quaternion(a)
    bx, by, bz, bw = quaternion(b)
    x = aw * bx - ax * bw - ay * bz + az * by
    y = aw * by - ay * bw - az * bx + ax * bz
    z = aw * bz - az * bw - ax * by + ay * bx
    w = aw * bw + ax * bx + ay * by + az * bz
    return 2.0 * math.atan2(math.hypot(x, y, z), abs(w))


def psm_point(q):
    """Place of a PSM's control point in its base, m, for joints in rad and m: the wrist-yaw axis by dVRK's modified
    Denavit-Hartenberg table, D - L = 0.0156 m, a = 0.0091 m."""
    half = math.pi / 2.0
    rows = [
        (half, 0.0, q[0] + half, 0.0),
        (-half, 0.0, q[1] - half, 0.0),
        (half, 0.0, 0.0, q[2] - 0.0156),
        (0.0, 0.0, q[3], 0.0),
        (-half, 0.0, q[4] - half, 0.0),
        (-half, 0.0091, q[5] - half, 0.0),
    ]
    place = (0.0, 0.0, 0.0)
    for alpha, a, theta, d in reversed(rows):
        x, y, z = place
        x, y = math.cos(theta) * x - math.sin(theta) * y, math.sin(theta) * x + math.cos(theta) * y
        x, z = x + a, z + d
        y, z = math.cos(alpha) * y - math.sin(alpha) * z, math.sin(alpha) * y + math.cos(alpha) * z
        place = (x, y, z)
    return place


def moved(pose, x=0.0, y=0.0, z=0.0):
    """The pose at another place."""
    other = copy.deepcopy(pose)
    other.position.x += x
    other.position.y += y
    other.position.z += z
    return other
