"""Scenes of the conformance cases, in words that every simulator has, and what a simulator has to do with them.

SI units. Quaternions are (x, y, z, w). The frame of a body is at its centre of mass, and its axes are the principal ones. All poses,
axes and anchors are in world coordinates at the start, where the coordinates of all joints are 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import List, Optional, Sequence, Tuple

import numpy as np

Vector = Sequence[float]
UNTURNED = (0.0, 0.0, 0.0, 1.0)


@dataclass
class Shape:
    """`box`: size (x, y, z). `sphere`: (radius). `capsule`: (radius, length between the centres of its caps), along z. `hull`: the
    convex hull of points. `mesh`: triangles as they are, of a body that does not move. `hollow`: a closed mesh of a body
    that moves, with a hole."""

    kind: str
    size: Tuple[float, ...] = ()
    position: Vector = (0.0, 0.0, 0.0)
    points: Sequence[Vector] = ()
    faces: Sequence[Tuple[int, ...]] = ()


@dataclass
class Body:
    """A rigid body. With mass 0 it stands still, or is moved by `move` where `moved` is true. `inertia` holds the principal moments."""

    name: str
    mass: float
    inertia: Vector = ()
    shapes: List[Shape] = field(default_factory=list)
    position: Vector = (0.0, 0.0, 0.0)
    rotation: Vector = UNTURNED
    friction: float = 0.5
    moved: bool = False


@dataclass
class Joint:
    """`kind`: revolute, prismatic or fixed. `limits` of the coordinate, rad or m; `effort`: largest one of its motor and of commands,
    N m or N; `speed`: largest rate; `damping`: N m s/rad or N s/m. `mimics`: (joint, ratio): this coordinate is ratio times that of the
    joint."""

    name: str
    kind: str
    parent: str
    child: str
    anchor: Vector
    axis: Vector = (0.0, 0.0, 1.0)
    limits: Optional[Tuple[float, float]] = None
    effort: Optional[float] = None
    speed: Optional[float] = None
    damping: float = 0.0
    mimics: Optional[Tuple[str, float]] = None
    closes_loop: bool = False


@dataclass
class Scene:
    """Bodies without a joint above them come first. The joint that closes a loop is the last of its child's."""

    bodies: List[Body]
    joints: List[Joint] = field(default_factory=list)
    gravity: Vector = (0.0, 0.0, -9.81)

    def body(self, name: str) -> Body:
        return next(body for body in self.bodies if body.name == name)

    def joint_above(self, name: str) -> Optional[Joint]:
        return next((joint for joint in self.joints if joint.child == name and not joint.closes_loop), None)

    def below(self, name: str) -> List[Joint]:
        return [joint for joint in self.joints if joint.parent == name and not joint.closes_loop]


class Unsupported(Exception):
    """This simulator has no such thing; the text says what."""


class Simulator:
    """What a simulator does with a scene: the adapter of a simulator is a class that has all this. Methods that it
    lacks raise Unsupported."""

    # How it is called in tables.
    name = ""

    def __init__(self, scene: Scene, step: float) -> None:
        """Builds the scene, to be integrated with steps of `step` s. Bodies are at rest, joints without motors."""

    def run(self, steps: int) -> None:
        """Makes steps."""
        raise Unsupported("steps")

    def position(self, body: str) -> np.ndarray:
        """Of the centre of mass, m."""
        raise Unsupported("positions")

    def rotation(self, body: str) -> np.ndarray:
        """Quaternion (x, y, z, w)."""
        raise Unsupported("rotations")

    def velocity(self, body: str) -> np.ndarray:
        """Linear, m/s, and angular velocity, rad/s, of the centre of mass, world axes."""
        raise Unsupported("velocities")

    def set_velocity(self, body: str, velocity: Vector) -> None:
        """Of a free body, at once: linear and angular."""
        raise Unsupported("setting velocities")

    def coordinate(self, joint: str) -> float:
        """Of a revolute joint, rad, or a prismatic one, m."""
        raise Unsupported("coordinates of joints")

    def rate(self, joint: str) -> float:
        """Rate of the coordinate."""
        raise Unsupported("rates of joints")

    def apply_effort(self, joint: str, effort: float) -> None:
        """From now on, N m or N."""
        raise Unsupported("efforts")

    def drive(self, joint: str, rate: float) -> None:
        """A motor keeps this rate from now on, as strong as `effort` of the joint allows."""
        raise Unsupported("motors that keep a rate")

    def servo(self, joint: str, coordinate: float) -> None:
        """A position controller goes to this coordinate."""
        raise Unsupported("position controllers")

    def push(self, body: str, force: Vector, torque: Vector) -> None:
        """Force at the centre of mass and torque from now on, world axes."""
        raise Unsupported("forces on bodies")

    def move(self, body: str, velocity: Vector) -> None:
        """A body of mass 0 moves with this linear velocity from now on."""
        raise Unsupported("bodies that are moved")

    def reaction(self, joint: str) -> float:
        """Length of the force that a joint transmits, N."""
        raise Unsupported("forces in joints")


def box_inertia(mass: float, size: Vector) -> Tuple[float, float, float]:
    """Principal moments of a solid box."""
    x, y, z = (value * value for value in size)
    return mass / 12 * (y + z), mass / 12 * (x + z), mass / 12 * (x + y)


def box(name: str, size: Vector, mass: float = 0.0, position: Vector = (0.0, 0.0, 0.0), **more) -> Body:
    """A solid box."""
    return Body(name, mass, box_inertia(mass, size), [Shape("box", tuple(size))], position, **more)


def sphere(name: str, radius: float, mass: float, position: Vector, **more) -> Body:
    """A solid sphere."""
    return Body(name, mass, (0.4 * mass * radius**2,) * 3, [Shape("sphere", (radius,))], position, **more)


def turned(axis: Vector, angle: float) -> Tuple[float, float, float, float]:
    """Quaternion of a rotation about a unit vector."""
    x, y, z = (math.sin(angle / 2) * value for value in axis)
    return x, y, z, math.cos(angle / 2)


def product(a: Vector, b: Vector) -> Tuple[float, float, float, float]:
    """Of two quaternions: the rotation b, then a."""
    u, v = np.array(a[:3]), np.array(b[:3])
    x, y, z = a[3] * v + b[3] * u + np.cross(u, v)
    return float(x), float(y), float(z), float(a[3] * b[3] - u @ v)


def rotate(rotation: Vector, vector: Vector) -> np.ndarray:
    """A vector, turned by a quaternion."""
    u, w = np.array(rotation[:3]), rotation[3]
    return np.asarray(vector) + 2 * np.cross(u, np.cross(u, vector) + w * np.asarray(vector))


def conjugate(rotation: Vector) -> Tuple[float, float, float, float]:
    """The inverse rotation."""
    return -rotation[0], -rotation[1], -rotation[2], rotation[3]


def roll_pitch_yaw(rotation: Vector) -> Tuple[float, float, float]:
    """Angles about the fixed axes x, y, z, in this order, as URDF has them."""
    x, y, z, w = rotation
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    return (
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        pitch,
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )


def write_obj(path: Path, shapes: Sequence[Shape], by_material: bool = False) -> None:
    """A file of meshes; with `by_material` each shape has a material of its own, in a library beside it."""
    lines, first = [], 1
    if by_material:
        path.with_suffix(".mtl").write_text("".join(f"newmtl m{i}\nKd 1 0 0\n" for i in range(len(shapes))))
        lines.append(f"mtllib {path.with_suffix('.mtl').name}")
    for i, shape in enumerate(shapes):
        lines += ["v {:.9g} {:.9g} {:.9g}".format(*point) for point in shape.points]
        lines += [f"usemtl m{i}"] if by_material else []
        lines += ["f " + " ".join(str(first + k) for k in face) for face in shape.faces]
        first += len(shape.points)
    path.write_text("\n".join(lines) + "\n")


def flat_mesh(squares: int, length: float) -> Shape:
    """A square floor of triangles, whose diagonals alternate."""
    n = squares + 1
    points = [((i / squares - 0.5) * length, (j / squares - 0.5) * length, 0.0) for j in range(n) for i in range(n)]
    faces: List[Tuple[int, ...]] = []
    for j in range(squares):
        for i in range(squares):
            a = j * n + i
            b, c = a + 1, a + n
            faces += [(a, b, c + 1), (a, c + 1, c)] if (i + j) % 2 else [(a, b, c), (b, c + 1, c)]
    return Shape("mesh", points=points, faces=faces)


def ring(inner: float, outer: float, height: float, parts: int) -> List[Shape]:
    """Convex segments of a ring; its hole has the radius `inner` at least."""
    corner = inner / math.cos(math.pi / parts)
    faces = [
        (0, 1, 2),
        (0, 2, 3),
        (4, 7, 6),
        (4, 6, 5),
        (0, 4, 5),
        (0, 5, 1),
        (1, 5, 6),
        (1, 6, 2),
        (2, 6, 7),
        (2, 7, 3),
        (3, 7, 4),
        (3, 4, 0),
    ]
    shapes = []
    for i in range(parts):
        points = []
        for j in (i, i + 1):
            c, s = math.cos(2 * math.pi * j / parts), math.sin(2 * math.pi * j / parts)
            low, high = -height / 2, height / 2
            points += [
                (corner * c, corner * s, low),
                (outer * c, outer * s, low),
                (outer * c, outer * s, high),
                (corner * c, corner * s, high),
            ]
        shapes.append(Shape("hull", points=points, faces=faces))
    return shapes


def closed_ring(inner: float, outer: float, height: float, corners: int) -> Shape:
    """The same ring as one closed mesh."""
    corner = inner / math.cos(math.pi / corners)
    points, faces = [], []
    for i in range(corners):
        c, s = math.cos(2 * math.pi * i / corners), math.sin(2 * math.pi * i / corners)
        points += [
            (r * c, r * s, z)
            for r, z in ((corner, -height / 2), (outer, -height / 2), (outer, height / 2), (corner, height / 2))
        ]
        j = (i + 1) % corners
        for q in range(4):
            a, b, c_, d = 4 * i + q, 4 * i + (q + 1) % 4, 4 * j + (q + 1) % 4, 4 * j + q
            faces += [(a, d, c_), (a, c_, b)]
    return Shape("hollow", points=points, faces=faces)
