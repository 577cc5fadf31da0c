"""The cases: what is simulated, what is right and why, how far off it may be.

Each is a function of `make(scene, step)`, which builds a simulator, and of the step in s; it returns rows. `CASES` has all of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, List, Sequence, Tuple

import numpy as np
from scene import (
    Body,
    Joint,
    Scene,
    Shape,
    Simulator,
    Unsupported,
    box,
    box_inertia,
    closed_ring,
    flat_mesh,
    product,
    ring,
    rotate,
    sphere,
    turned,
)

G = 9.81
Make = Callable[[Scene, float], Simulator]


@dataclass
class Row:
    """`got` is right within `tolerance` of `right`."""

    what: str
    got: float
    right: float
    tolerance: float

    @property
    def passes(self) -> bool:
        return math.isfinite(self.got) and abs(self.got - self.right) <= self.tolerance


@dataclass
class Case:
    name: str
    text: str
    run: Callable[[Make, float], List[Row]]
    steps: Tuple[float, ...]


CASES: List[Case] = []


def case(
    name: str, *steps: float
) -> Callable[[Callable[[Make, float], List[Row]]], Callable[[Make, float], List[Row]]]:
    """Adds a function to the cases; its docstring is what the page says."""

    def add(run: Callable[[Make, float], List[Row]]) -> Callable[[Make, float], List[Row]]:
        CASES.append(Case(name, " ".join((run.__doc__ or "").split()), run, steps or (0.001,)))
        return run

    return add


def steps_in(time: float, step: float) -> int:
    return round(time / step)


# --- contacts ----------------------------------------------------------------------------------------------------------------------------


def mesh_floor(friction: float = 1.0) -> Body:
    return Body("floor", 0.0, shapes=[flat_mesh(60, 3.0)], friction=friction)


@case("A box slides on a mesh", 0.001, 0.005)
def slide_on_mesh(make: Make, step: float) -> List[Row]:
    """Box of 80 × 80 × 40 mm without friction, 1 m/s along a flat floor of triangles of 50 mm: as on a plane. No edge between triangles may
    be felt."""
    slider = box("slider", (0.08, 0.08, 0.04), 0.1, (-1.3, 0.013, 0.0205), friction=0.0)
    simulator = make(Scene([mesh_floor(), slider]), step)
    simulator.run(steps_in(0.2, step))
    simulator.set_velocity("slider", (1, 0, 0, 0, 0, 0))
    simulator.run(2)
    start, hop = simulator.position("slider"), 0.0
    for _ in range(steps_in(2, step)):
        simulator.run(1)
        hop = max(hop, abs(simulator.position("slider")[2] - start[2]))
    aside = simulator.position("slider")[1] - start[1]
    return [
        Row("speed after 2 s, m/s", simulator.velocity("slider")[0], 1, 0.01),
        Row("sideways, mm", 1e3 * aside, 0, 2),
        Row("greatest hop, mm", 1e3 * hop, 0, 0.05),
    ]


@case("Small parts rest on a mesh")
def rest_on_mesh(make: Make, step: float) -> List[Row]:
    """A cube of 10 mm and a rod of 30 × 1 × 1 mm fall onto the same floor. Speed and way from 3 to 5 s."""
    rows = []
    for what, size, mass in (("cube", (0.01, 0.01, 0.01), 1e-3), ("rod", (0.03, 0.001, 0.001), 2e-4)):
        tilt = product(turned((0, 0, 1), 0.3), product(turned((0, 1, 0), 0.1), turned((1, 0, 0), 0.2)))
        simulator = make(Scene([mesh_floor(), box("part", size, mass, (0.0131, 0.0071, 0.02), rotation=tilt)]), step)
        simulator.run(steps_in(3, step))
        start, speed = simulator.position("part"), 0.0
        for _ in range(steps_in(2, step)):
            simulator.run(1)
            speed = max(speed, float(np.abs(simulator.velocity("part")[:3]).max()))
        way = np.linalg.norm(simulator.position("part") - start)
        rows += [
            Row(f"{what}: greatest speed, mm/s", 1e3 * speed, 0, 1),
            Row(f"{what}: way, µm", 1e6 * float(way), 0, 20),
        ]
    return rows


def count_passed(make: Make, step: float, size: Sequence[float], mass: float, thickness: float, height: float) -> int:
    count, rng = 24, np.random.default_rng(7)
    length = 0.15 * count + 1
    bodies = [box("plate", (length, 0.5, thickness), 0, (0.075 * count, 0, -thickness / 2))]
    for i in range(count):
        r, p, y = rng.uniform(-1, 1, 3) * (0.6, 0.6, 3)
        rotation = product(turned((0, 0, 1), y), product(turned((0, 1, 0), p), turned((1, 0, 0), r)))
        bodies.append(box(f"b{i}", size, mass, (0.15 * i, 0, height + rng.uniform(0, 0.01)), rotation=rotation))
    simulator = make(Scene(bodies), step)
    simulator.run(steps_in(0.45, step))
    return sum(float(simulator.position(f"b{i}")[2]) < -thickness / 2 for i in range(count))


@case("Thin bodies and thin plates", 0.001, 0.005)
def thin_plates(make: Make, step: float) -> List[Row]:
    """24 rods of 30 × 1 × 1 mm, and 24 sheets of 30 × 30 × 1 mm, fall 0.2 m (0.02 m at 5 ms) onto a plate of 2 mm: how many pass."""
    height = 0.2 if step < 0.002 else 0.02
    return [
        Row(f"{what} that pass", count_passed(make, step, size, mass, 0.002, height), 0, 0)
        for what, size, mass in (("rods", (0.03, 0.001, 0.001), 2e-4), ("sheets", (0.03, 0.03, 0.001), 2e-3))
    ]


@case("First touch", 0.001, 0.01)
def first_touch(make: Make, step: float) -> List[Row]:
    """Two cubes of 0.2 m stand exactly on each other and on the floor: how far the upper one sinks within 50 steps."""
    size = 0.2
    bodies = [box("floor", (2, 2, 0.1), 0, (0, 0, -0.05))]
    bodies += [box(name, (size,) * 3, 1, (0, 0, (i + 0.5) * size)) for i, name in enumerate(("lower", "upper"))]
    simulator = make(Scene(bodies), step)
    low = 0.0
    for _ in range(50):
        simulator.run(1)
        low = min(low, simulator.position("upper")[2] - 1.5 * size)
    return [Row("dip, µm", 1e6 * low, 0, 10)]


@case("Critical friction")
def critical_friction(make: Make, step: float) -> List[Row]:
    """A box on a slope of tan α = 0.98 μ stays; on one of tan α = 1.02 μ it slides with g (sin α − μ cos α). Friction coefficients are
    products of those of both bodies, or the larger, as the simulator has it: here both come to μ."""
    rows = []
    for mu in (0.2, 0.5, 0.8):
        for share in (0.98, 1.02):
            angle = math.atan(share * mu)
            rotation = turned((0, 1, 0), angle)
            normal = rotate(rotation, (0, 0, 1))
            slope = box("slope", (20, 2, 1), 0, -0.5 * normal, rotation=rotation, friction=mu)
            slider = box("slider", (0.2, 0.2, 0.1), 1, 0.05 * normal, rotation=rotation, friction=mu)
            simulator = make(Scene([slope, slider]), step)
            simulator.run(steps_in(0.2, step))
            before, start = simulator.velocity("slider")[:3], simulator.position("slider")
            simulator.run(steps_in(1, step))
            if share < 1:
                way = np.linalg.norm(simulator.position("slider") - start)
                rows.append(Row(f"μ = {mu}, 0.98: way in 1 s, mm", 1e3 * float(way), 0, 0.1))
            else:
                right = G * (math.sin(angle) - mu * math.cos(angle))
                gained = float(np.linalg.norm(simulator.velocity("slider")[:3] - before))
                rows.append(Row(f"μ = {mu}, 1.02: acceleration, share of the right one", gained / right, 1, 0.02))
    return rows


@case("A ball rolls")
def rolling(make: Make, step: float) -> List[Row]:
    """Balls on slopes, with nothing said about rolling resistance, are at 5/7 g sin(α) t after 0.5 s."""
    rows = []
    for radius, degrees in ((0.1, 5), (0.005, 10)):
        angle = math.radians(degrees)
        rotation = turned((0, 1, 0), angle)
        normal = rotate(rotation, (0, 0, 1))
        slope = box("slope", (20, 4, 1), 0, -0.5 * normal, rotation=rotation)
        simulator = make(Scene([slope, sphere("ball", radius, 0.1, radius * normal)]), step)
        simulator.run(steps_in(0.5, step))
        speed = float(np.linalg.norm(simulator.velocity("ball")[:3]))
        rows.append(
            Row(
                f"r = {1e3 * radius:.0f} mm, {degrees}°: speed, share of the right one",
                speed / (5 / 7 * G * math.sin(angle) * 0.5),
                1,
                0.03,
            )
        )
    return rows


def pads(held: Body, half: float, friction: float) -> Scene:
    """Something between two pads on slides, whose efforts press them together; held at the height 0.1 m."""
    bodies = [Body("base", 0.0, shapes=[Shape("box", (0.001, 0.001, 0.001))], position=(0, 0, 0.2))]
    joints = []
    for name, side in (("left", -1), ("right", 1)):
        at = (side * (half + 0.005), 0, 0.1)
        bodies.append(box(name, (0.01, 0.03, 0.03), 0.1, at, friction=friction))
        joints.append(Joint(f"{name} slide", "prismatic", "base", name, at, (-side, 0, 0), (-0.05, 0.05)))
    return Scene([*bodies, held], joints)


@case("A grip holds")
def grip(make: Make, step: float) -> List[Row]:
    """A box and a capsule of 45 g are pinched by two pads with 60 N, μ = 0.7, for 60 s: they don't creep, and nothing turns them."""
    rows = []
    mass, radius = 0.045, 0.004
    moments = box_inertia(mass, (0.008, 0.008, 0.058))
    lying = turned((1, 0, 0), -math.pi / 2)
    for what, shape in (("box", Shape("box", (0.008, 0.008, 0.058))), ("capsule", Shape("capsule", (radius, 0.05)))):
        held = Body("held", mass, moments, [shape], (0, 0, 0.1), lying, friction=0.7)
        simulator = make(pads(held, radius, 0.7), step)
        for name in ("left slide", "right slide"):
            simulator.apply_effort(name, 60)
        simulator.run(steps_in(1, step))
        start, rotation = simulator.position("held"), simulator.rotation("held")
        simulator.run(steps_in(60, step))
        creep = abs(float(simulator.position("held")[2] - start[2])) / 60
        turn = 2 * float(
            np.linalg.norm(
                product(simulator.rotation("held"), (-rotation[0], -rotation[1], -rotation[2], rotation[3]))[:3]
            )
        )
        rows += [Row(f"{what}: creep, µm/s", 1e6 * creep, 0, 1), Row(f"{what}: turn, mrad", 1e3 * turn, 0, 0.1)]
    return rows


@case("A ring falls over a peg")
def ring_on_peg(make: Make, step: float) -> List[Row]:
    """A ring of 5 g with a hole of 5.5 mm above a peg of 5 mm, written as twelve hulls and as one closed mesh: it falls to the floor, 38 mm
    below."""
    rows = []
    for what, shapes in (
        ("hulls", ring(0.0055, 0.009, 0.004, 12)),
        ("closed mesh", [closed_ring(0.0055, 0.009, 0.004, 32)]),
    ):
        bodies = [
            Body("floor", 0.0, shapes=[Shape("box", (0.2, 0.2, 0.01))], position=(0, 0, -0.045)),
            Body("peg", 0.0, shapes=[Shape("cylinder", (0.005, 0.03))], position=(0, 0, -0.025)),
            Body("ring", 0.005, (1.5e-7, 1.5e-7, 2.8e-7), shapes),
        ]
        simulator = make(Scene(bodies), step)
        simulator.run(steps_in(2, step))
        rows.append(Row(f"{what}: height, mm", 1e3 * float(simulator.position("ring")[2]), -38, 1.2))
    return rows


@case("A platform carries", 0.001, 0.005)
def platform(make: Make, step: float) -> List[Row]:
    """A body without mass that is moved at 0.3 m/s carries the box that lies on it by friction."""
    ground = box("platform", (4, 1, 0.1), 0, (0, 0, -0.05), friction=0.8, moved=True)
    simulator = make(Scene([ground, box("load", (0.1, 0.1, 0.1), 1, (0, 0, 0.05), friction=0.8)]), step)
    simulator.run(steps_in(0.2, step))
    simulator.move("platform", (0.3, 0, 0))
    simulator.run(steps_in(1, step))
    return [
        Row("speed of the load, m/s", float(simulator.velocity("load")[0]), 0.3, 0.01),
        Row("load less platform, m", float(simulator.position("load")[0] - simulator.position("platform")[0]), 0, 0.01),
    ]


# --- joints ------------------------------------------------------------------------------------------------------------------------------


def hinged(mass: float, moment: float, **more) -> Scene:  # type: ignore[no-untyped-def]
    """A body on a hinge about the vertical through its centre of mass."""
    base = Body("base", 0.0)
    return Scene(
        [base, Body("rotor", mass, (moment,) * 3)], [Joint("hinge", "revolute", "base", "rotor", (0, 0, 0), **more)]
    )


@case("A joint beyond half a turn")
def wide_range(make: Make, step: float) -> List[Row]:
    """A hinge with limits of −0.5 and 5.5 rad goes where its position controller is told to."""
    simulator = make(hinged(1, 0.01, limits=(-0.5, 5.5)), step)
    rows = []
    for goal in (1.0, 3.5, 5.4, 1.0):
        simulator.servo("hinge", goal)
        simulator.run(steps_in(5, step))
        rows.append(Row(f"command {goal} rad: coordinate", simulator.coordinate("hinge"), goal, 5e-3))
    return rows


@case("A follower", 0.001, 0.005)
def mimic(make: Make, step: float) -> List[Row]:
    """Two fingers of 0.1 kg on slides; the second mimics the first with the factor −1. 5 N on the first move both masses: 0.125 m in
    0.1 s."""
    bodies = [Body("base", 0.0), *(Body(name, 0.1, (1e-4,) * 3) for name in ("first", "second"))]
    joints = [
        Joint(f"{name} slide", "prismatic", "base", name, (0, 0, 0), (1, 0, 0), (-1, 1), 50)
        for name in ("first", "second")
    ]
    joints[1].mimics = ("first slide", -1)
    simulator = make(Scene(bodies, joints), step)
    simulator.apply_effort("first slide", 5)
    simulator.run(steps_in(0.1, step))
    first, second = simulator.coordinate("first slide"), simulator.coordinate("second slide")
    return [
        Row("sum of both, mm", 1e3 * (first + second), 0, 1),
        Row("way of the first, m", first, 0.125, 0.02 if step > 0.002 else 0.01),
    ]


@case("Effort against damping")
def damping(make: Make, step: float) -> List[Row]:
    """A joint with damping c = 1e-4 N·m·s and an effort limit of 1e-4 N·m ends at 1 rad/s, whatever effort is asked for; without
    effort, one with c = 0.05 and I = 0.02 has exp(−c t / I) of its rate left."""
    limited = make(hinged(1, 1e-5, damping=1e-4, effort=1e-4, speed=100), step)
    limited.apply_effort("hinge", 1e-3)
    limited.run(steps_in(2, step))
    free = make(hinged(1, 0.02, damping=0.05), step)
    free.apply_effort("hinge", 1)
    free.run(steps_in(0.1, step))
    free.apply_effort("hinge", 0)
    free.run(2)
    before = free.rate("hinge")
    free.run(steps_in(0.5, step))
    return [
        Row("end rate, rad/s", limited.rate("hinge"), 1, 0.02),
        Row("share left after 0.5 s", free.rate("hinge") / before, math.exp(-0.05 / 0.02 * 0.5), 0.02),
    ]


@case("A largest speed", 0.001, 1 / 240)
def largest_speed(make: Make, step: float) -> List[Row]:
    """50 N·m drive a hinge of 0.5 kg·m² that may turn at 2.175 rad/s at most, within limits of ±2.9 rad."""
    simulator = make(hinged(3, 0.5, limits=(-2.9, 2.9), effort=87, speed=2.175), step)
    simulator.apply_effort("hinge", 50)
    top = 0.0
    for _ in range(steps_in(0.6, step)):
        simulator.run(1)
        top = max(top, abs(simulator.rate("hinge")))
    return [Row("greatest rate, rad/s", top, 2.175, 0.05)]


@case("A fast wheel", 0.001, 0.005)
def fast_wheel(make: Make, step: float) -> List[Row]:
    """A wheel of 0.05 kg·m² under a torque M turns at M t / I, also by more than half a turn a step (5000 rad/s; 1000 rad/s at 5 ms)."""
    torque = 500.0 if step < 0.002 else 100.0
    simulator = make(hinged(3, 0.05, effort=900), step)
    simulator.apply_effort("hinge", torque)
    simulator.run(steps_in(0.5, step))
    return [Row("rate, share of the right one", simulator.rate("hinge") / (torque / 0.05 * 0.5), 1, 0.04)]


@case("A motor at its limit", 0.001, 0.01)
def motor_at_limit(make: Make, step: float) -> List[Row]:
    """A motor that goes on driving into a limit of 0.5 rad at 30 rad/s: largest distance from the limit from 1.5 to 3.5 s."""
    bar = box("bar", (0.4, 0.02, 0.02), 1, (0.2, 0, 0))
    joint = Joint("hinge", "revolute", "base", "bar", (0, 0, 0), limits=(-0.5, 0.5), effort=100)
    simulator = make(Scene([Body("base", 0.0), bar], [joint], (0, 0, 0)), step)
    simulator.drive("hinge", 30)
    simulator.run(steps_in(1.5, step))
    worst = 0.0
    for _ in range(steps_in(2, step)):
        simulator.run(1)
        worst = max(worst, abs(simulator.coordinate("hinge") - 0.5))
    return [Row("unrest, mrad", 1e3 * worst, 0, 1)]


@case("A closed loop")
def closed_loop(make: Make, step: float) -> List[Row]:
    """A parallelogram of cranks of 0.3 m and a coupler of 0.5 m swings under gravity for 1 s: greatest gap of the pin that closes it."""
    angle = 1.2
    crank, moments = np.array([math.cos(angle), 0, math.sin(angle)]) * 0.3, (0.001, 0.02, 0.02)
    lifted, across = turned((0, 1, 0), -angle), np.array([0.5, 0, 0])
    bodies = [
        Body("base", 0.0),
        Body("left", 1, moments, position=crank / 2, rotation=lifted),
        Body("right", 1, moments, position=crank / 2 + across, rotation=lifted),
        Body("coupler", 1, moments, position=crank + across / 2),
    ]
    joints = [
        Joint("left pin", "revolute", "base", "left", (0, 0, 0), (0, 1, 0)),
        Joint("right pin", "revolute", "base", "right", (0.5, 0, 0), (0, 1, 0)),
        Joint("upper left pin", "revolute", "left", "coupler", crank, (0, 1, 0)),
        Joint("upper right pin", "revolute", "right", "coupler", crank + across, (0, 1, 0), closes_loop=True),
    ]
    simulator = make(Scene(bodies, joints), step)
    gap = 0.0
    for _ in range(20):
        simulator.run(steps_in(0.05, step))
        right = simulator.position("right") + rotate(simulator.rotation("right"), (0.15, 0, 0))
        end = simulator.position("coupler") + rotate(simulator.rotation("coupler"), (0.25, 0, 0))
        gap = max(gap, float(np.linalg.norm(right - end)))
    return [Row("gap, µm", 1e6 * gap, 0, 10)]


@case("Links without mass")
def massless_links(make: Make, step: float) -> List[Row]:
    """A base of 12 kg on two slides at right angles, whose carriages have no mass: 12 N along each give 1 m/s²."""
    bodies = [Body("ground", 0.0), Body("x", 0.0), Body("y", 0.0), Body("base", 12, (0.5, 0.5, 0.5))]
    joints = [
        Joint("along x", "prismatic", "ground", "x", (0, 0, 0), (1, 0, 0), (-99, 99), 1000),
        Joint("along y", "prismatic", "x", "y", (0, 0, 0), (0, 1, 0), (-99, 99), 1000),
        Joint("yaw", "revolute", "y", "base", (0, 0, 0)),
    ]
    simulator = make(Scene(bodies, joints), step)
    for name in ("along x", "along y"):
        simulator.apply_effort(name, 12)
    simulator.run(steps_in(0.1, step))
    velocity = simulator.velocity("base")
    return [Row(f"acceleration along {axis}, m/s²", float(velocity[i]) / 0.1, 1, 0.01) for i, axis in enumerate("xy")]


@case("A moment of zero")
def zero_moment(make: Make, step: float) -> List[Row]:
    """A slender rod whose file gives principal moments of 0, 0.2 and 0.2 kg·m²: 1 N·m about the last axis gives 5 rad/s²."""
    rod = Body("rod", 5, (0, 0.2, 0.2), [Shape("box", (2, 2, 2))])
    simulator = make(Scene([rod], gravity=(0, 0, 0)), step)
    simulator.push("rod", (0, 0, 0), (0, 0, 1))
    simulator.run(10)
    return [Row("angular acceleration, rad/s²", float(simulator.velocity("rod")[5]) / (10 * step), 5, 0.01)]


@case("Forces in joints", 0.001, 0.005)
def joint_forces(make: Make, step: float) -> List[Row]:
    """A load of 1.001 kg on a joint: the force that it transmits, 0.2 s after the start."""
    rows = []
    for kind in ("prismatic", "fixed", "revolute"):
        axis = (0, 1, 0) if kind == "revolute" else (0, 0, 1)
        limits = None if kind == "fixed" else (0.0, 0.0)
        joint = Joint("tab", kind, "base", "load", (0, 0, 0.1), axis, limits)
        base = Body("base", 0.0, shapes=[Shape("box", (0.05, 0.05, 0.05))])
        simulator = make(Scene([base, box("load", (0.05, 0.05, 0.05), 1.001, (0, 0, 0.1))], [joint]), step)
        simulator.run(steps_in(0.2, step))
        try:
            rows.append(Row(f"{kind}: force, N", simulator.reaction("tab"), 1.001 * G, 0.05))
        except Unsupported:
            rows.append(Row(f"{kind}: force, N", math.nan, 1.001 * G, 0.05))
    return rows


@case("Energy of a light arm")
def light_arm(make: Make, step: float) -> List[Row]:
    """A double pendulum of links of 0.1 m and 5 g swings for 10 s from the horizontal: greatest change of the total energy, as a share
    of the drop."""
    length, mass = 0.1, 0.005
    moments = box_inertia(mass, (length, 0.01, 0.01))
    bodies = [Body("base", 0.0)]
    bodies += [
        Body(name, mass, moments, position=((i + 0.5) * length, 0, 0)) for i, name in enumerate(("upper", "lower"))
    ]
    joints = [
        Joint("shoulder", "revolute", "base", "upper", (0, 0, 0), (0, 1, 0)),
        Joint("elbow", "revolute", "upper", "lower", (length, 0, 0), (0, 1, 0)),
    ]
    scene = Scene(bodies, joints)
    simulator = make(scene, step)

    def energy() -> float:
        total = 0.0
        for body in scene.bodies[1:]:
            velocity, rotation = simulator.velocity(body.name), simulator.rotation(body.name)
            local = rotate((-rotation[0], -rotation[1], -rotation[2], rotation[3]), velocity[3:])
            total += body.mass * (G * simulator.position(body.name)[2] + velocity[:3] @ velocity[:3] / 2)
            total += float(local @ (np.array(body.inertia) * local)) / 2
        return total

    simulator.run(1)
    start, worst = energy(), 0.0
    for _ in range(100):
        simulator.run(steps_in(0.1, step))
        worst = max(worst, abs(energy() - start))
    return [Row("greatest change, %", 100 * worst / (2 * mass * G * length), 0, 0.1)]
