"""Poses of messages as numbers: a position [x, y, z] and a quaternion [x, y, z, w]."""

import math


def pose_of(pose):
    """Position and quaternion of a `geometry_msgs/Pose`."""
    p, q = pose.position, pose.orientation
    return [p.x, p.y, p.z], [q.x, q.y, q.z, q.w]


def product(a, b):
    """The quaternion that turns as `b` and then as `a`."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by + ay * bw + az * bx - ax * bz,
        aw * bz + az * bw + ax * by - ay * bx,
        aw * bw - ax * bx - ay * by - az * bz,
    ]


def conjugate(q):
    """The opposite turn."""
    return [-q[0], -q[1], -q[2], q[3]]


def turned(q, vector):
    """`vector` turned by `q`."""
    return product(product(q, [*vector, 0.0]), conjugate(q))[:3]


def compose(a, b):
    """The pose `b`, given in the frame `a`, in the frame that `a` is given in."""
    offset = turned(a[1], b[0])
    return [x + d for x, d in zip(a[0], offset)], product(a[1], b[1])


def relative(a, b):
    """The pose `b` in the frame `a`, both given in the same frame."""
    back = conjugate(a[1])
    return turned(back, [y - x for x, y in zip(a[0], b[0])]), product(back, b[1])


def distance(a, b):
    """Between two points, m."""
    return math.dist(a, b)


def angle(a, b):
    """Between two orientations, rad."""
    x, y, z, w = product(conjugate(a), b)
    return 2.0 * math.atan2(math.hypot(x, y, z), abs(w))


def yaw(q):
    """Angle about z, rad, of a pose that is nearly level."""
    x, y, z, w = q
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
