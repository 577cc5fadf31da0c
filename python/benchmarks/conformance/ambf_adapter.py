"""This simulator: URDF where joints have what ADF has no words for, else ADF."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Dict, List

import ambf
import numpy as np
import urdf
from scene import Body, Joint, Scene, Shape, Simulator, Vector, conjugate, product, roll_pitch_yaw, rotate, write_obj


def mapping(keys: str, values: Vector) -> str:
    return "{" + ", ".join(f"{key}: {value:.12g}" for key, value in zip(keys, values)) + "}"


class Ambf(Simulator):
    def __init__(self, scene: Scene, step: float, profile: str) -> None:
        self.files = tempfile.TemporaryDirectory(prefix="conformance_")
        folder = Path(self.files.name)
        self.scene = scene
        self.is_urdf = (
            any(j.damping or j.effort or j.speed or j.mimics or j.closes_loop for j in scene.joints)
            or urdf.has_massless_links(scene)
            or any(body.mass > 0 and 0.0 in body.inertia for body in scene.bodies)
        )
        if self.is_urdf:
            files: List[Path] = list(urdf.robots(scene, folder, loops=True).values())
        else:
            files = [folder / "scene.yaml"]
            files[0].write_text(adf(scene, folder))
        world = folder / "world.yaml"
        gravity = mapping("xyz", scene.gravity)
        world.write_text(
            f"namespace: /ambf/env/\nmax iterations: 1000\ngravity: {gravity}\nphysics: {{sub step: {step:.12g}}}\n"
        )
        self.sim = ambf.Simulation([str(file) for file in files], world=str(world), profile=profile, step=step)
        self.bodies: Dict[str, ambf.Body] = {}

    def run(self, steps: int) -> None:
        self.sim.step(steps)

    def handle(self, body: str) -> ambf.Body:
        if body not in self.bodies:
            self.bodies[body] = self.sim.body(f"/{body}")
        return self.bodies[body]

    def pose(self, body: str) -> np.ndarray:
        return np.array(self.handle(body).pose)

    def position(self, body: str) -> np.ndarray:
        pose = self.pose(body)
        if not self.is_urdf:
            return pose[:3]
        return pose[:3] + rotate(pose[3:], urdf.place_of(self.scene, self.scene.body(body))[0])

    def rotation(self, body: str) -> np.ndarray:
        rotation = self.pose(body)[3:]
        return np.array(product(rotation, self.scene.body(body).rotation)) if self.is_urdf else rotation

    def velocity(self, body: str) -> np.ndarray:
        twist = np.array(self.handle(body).twist)
        twist[:3] += np.cross(twist[3:], self.position(body) - self.pose(body)[:3])
        return twist

    def set_velocity(self, body: str, velocity: Vector) -> None:
        self.sim.set_state(twists={self.handle(body).name: tuple(velocity)})

    def joint(self, name: str) -> Joint:
        return next(joint for joint in self.scene.joints if joint.name == name)

    def index(self, name: str) -> int:
        # Names have no blanks.
        return list(self.handle(self.joint(name).parent).joints).index(name.replace(" ", ""))

    def coordinate(self, joint: str) -> float:
        return float(self.handle(self.joint(joint).parent).joint_positions[self.index(joint)])

    def rate(self, joint: str) -> float:
        return float(self.handle(self.joint(joint).parent).joint_velocities[self.index(joint)])

    def command(self, joint: str, kind: int, value: float) -> None:
        body = self.handle(self.joint(joint).parent)
        body.joint_kinds[self.index(joint)], body.joint_commands[self.index(joint)] = kind, value
        # A command acts from the second iteration on.
        self.sim.step(1)

    def apply_effort(self, joint: str, effort: float) -> None:
        self.command(joint, ambf.EFFORT, effort)

    def drive(self, joint: str, rate: float) -> None:
        self.command(joint, ambf.VELOCITY, rate)

    def servo(self, joint: str, coordinate: float) -> None:
        self.command(joint, ambf.POSITION, coordinate)

    def push(self, body: str, force: Vector, torque: Vector) -> None:
        handle = self.handle(body)
        handle.kind = ambf.FORCE
        handle.wrench[:] = (*force, *torque)
        # A command acts from the second iteration on.
        self.sim.step(1)

    def move(self, body: str, velocity: Vector) -> None:
        handle = self.handle(body)
        handle.kind = ambf.VELOCITY
        handle.target_twist[:] = (*velocity, 0, 0, 0)

    def reaction(self, joint: str) -> float:
        index = next(i for i, name in enumerate(self.sim.joints) if name.endswith(joint.replace(" ", "")))
        return float(np.linalg.norm(self.sim.joint_wrenches[index, :3]))


class Legacy(Ambf):
    name = "legacy"

    def __init__(self, scene: Scene, step: float) -> None:
        super().__init__(scene, step, "legacy")


class Accurate(Ambf):
    name = "accurate"

    def __init__(self, scene: Scene, step: float) -> None:
        super().__init__(scene, step, "accurate")


def adf(scene: Scene, folder: Path) -> str:
    names = ", ".join(f"BODY {body.name}" for body in scene.bodies)
    joints = ", ".join(f"JOINT {joint.name}" for joint in scene.joints)
    text = f"bodies: [{names}]\njoints: [{joints}]\nnamespace: /ambf/env/\n"
    text += "".join(adf_body(body, folder) for body in scene.bodies)
    return text + "".join(adf_joint(scene, joint) for joint in scene.joints)


def adf_body(body: Body, folder: Path) -> str:
    friction = f"{{static: {body.friction**0.5:.12g}, rolling: 0}}"
    place = (
        f"{{position: {mapping('xyz', body.position)}, orientation: {mapping('rpy', roll_pitch_yaw(body.rotation))}}}"
    )
    text = f"BODY {body.name}:\n  name: {body.name}\n  mass: {body.mass}\n  location: {place}\n"
    text += f"  friction: {friction}\n  restitution: 0\n  damping: {{linear: 0, angular: 0}}\n"
    text += "  inertial offset: {position: {x: 0, y: 0, z: 0}, orientation: {r: 0, p: 0, y: 0}}\n"
    if body.inertia:
        ix, iy, iz = body.inertia
        text += f"  inertia: {{ix: {ix:.12g}, iy: {iy:.12g}, iz: {iz:.12g}}}\n"
    if body.shapes and body.shapes[0].points:
        path = folder / f"{body.name}.obj"
        write_obj(path, body.shapes, by_material=len(body.shapes) > 1)
        text += f"  high resolution path: {folder}/\n  low resolution path: {folder}/\n"
        text += f"  mesh: {path.name}\n  collision mesh: {path.name}\n"
        if body.shapes[0].kind == "hull":
            text += "  collision mesh type: CONVEX_HULL\n"
        return text
    return text + "".join(adf_shape(shape) for shape in body.shapes[:1])


def adf_shape(shape: Shape) -> str:
    if shape.kind == "box":
        kind, geometry = "BOX", mapping("xyz", shape.size)
    elif shape.kind == "sphere":
        kind, geometry = "SPHERE", f"{{radius: {shape.size[0]}}}"
    elif shape.kind == "capsule":
        # Its height is that between the tips.
        kind, geometry = "CAPSULE", f"{{radius: {shape.size[0]}, height: {shape.size[1] + 2 * shape.size[0]}, axis: z}}"
    else:
        kind, geometry = "CYLINDER", f"{{radius: {shape.size[0]}, height: {shape.size[1]}, axis: z}}"
    return f"  shape: {kind}\n  geometry: {geometry}\n  collision shape: {kind}\n  collision geometry: {geometry}\n"


def adf_joint(scene: Scene, joint: Joint) -> str:
    text = f"JOINT {joint.name}:\n  name: {joint.name}\n  type: {joint.kind}\n"
    for role, name in (("parent", joint.parent), ("child", joint.child)):
        body = scene.body(name)
        back = conjugate(body.rotation)
        pivot = rotate(back, np.subtract(joint.anchor, body.position))
        text += f"  {role}: BODY {name}\n  {role} pivot: {mapping('xyz', pivot)}\n"
        text += f"  {role} axis: {mapping('xyz', rotate(back, joint.axis))}\n"
    if joint.limits:
        text += f"  joint limits: {{low: {joint.limits[0]}, high: {joint.limits[1]}}}\n"
    return text
