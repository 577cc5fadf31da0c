"""MuJoCo by MJCF: its defaults, but the integrator `implicitfast` and elliptic friction cones."""

from __future__ import annotations

from typing import Dict

import mujoco
import numpy as np
from scene import Body, Joint, Scene, Shape, Simulator, Unsupported, Vector, conjugate, product, rotate


def words(values: Vector) -> str:
    return " ".join(f"{value:.12g}" for value in values)


def quaternion(rotation: Vector) -> str:
    return words((rotation[3], *rotation[:3]))


class MuJoCo(Simulator):
    name = "MuJoCo"
    rate_gain = 100.0
    """Of motors that drive a rate, N s/m or N m s/rad."""

    def __init__(self, scene: Scene, step: float) -> None:
        self.scene = scene
        self.assets = ""
        bodies = "".join(self.body(body) for body in scene.bodies if not scene.joint_above(body.name))
        actuators = equalities = ""
        for joint in scene.joints:
            if joint.closes_loop:
                child = scene.body(joint.child)
                at = rotate(conjugate(child.rotation), np.subtract(joint.anchor, child.position))
                equalities += f'<connect body1="{joint.child}" body2="{joint.parent}" anchor="{words(at)}"/>'
            elif joint.kind != "fixed":
                bound = f' forcerange="{-joint.effort} {joint.effort}"' if joint.effort else ""
                actuators += f'<general name="{joint.name}" joint="{joint.name}"{bound}/>'
            if joint.mimics:
                leader, ratio = joint.mimics
                equalities += f'<joint joint1="{joint.name}" joint2="{leader}" polycoef="0 {ratio} 0 0 0"/>'
        text = (
            f'<mujoco><compiler angle="radian"/><option timestep="{step:.12g}" gravity="{words(scene.gravity)}"'
            f' integrator="implicitfast" cone="elliptic"/><asset>{self.assets}</asset><worldbody>{bodies}</worldbody>'
            f"<equality>{equalities}</equality><actuator>{actuators}</actuator></mujoco>"
        )
        try:
            self.model = mujoco.MjModel.from_xml_string(text)
        except ValueError as error:
            raise Unsupported(str(error).splitlines()[0]) from error
        self.data = mujoco.MjData(self.model)
        self.moving: Dict[int, np.ndarray] = {}

    def body(self, body: Body) -> str:
        joint = self.scene.joint_above(body.name)
        parent = self.scene.body(joint.parent) if joint else Body("world", 0.0)
        back = conjugate(parent.rotation)
        position = rotate(back, np.subtract(body.position, parent.position))
        flag = ' mocap="true"' if body.moved else ""
        text = (
            f'<body name="{body.name}" pos="{words(position)}" quat="{quaternion(product(back, body.rotation))}"{flag}>'
        )
        if body.mass > 0:
            text += f'<inertial pos="0 0 0" mass="{body.mass}" diaginertia="{words(body.inertia)}"/>'
        if joint is None and body.mass > 0:
            text += "<freejoint/>"
        elif joint is not None and joint.kind != "fixed":
            text += self.joint(joint, body)
        for i, shape in enumerate(body.shapes):
            text += self.geom(shape, f"{body.name} {i}", body.friction)
        text += "".join(self.body(self.scene.body(below.child)) for below in self.scene.below(body.name))
        return text + "</body>"

    def joint(self, joint: Joint, body: Body) -> str:
        back = conjugate(body.rotation)
        at, axis = rotate(back, np.subtract(joint.anchor, body.position)), rotate(back, joint.axis)
        kind = "hinge" if joint.kind == "revolute" else "slide"
        text = (
            f'<joint name="{joint.name}" type="{kind}" pos="{words(at)}" axis="{words(axis)}" damping="{joint.damping}"'
        )
        if joint.limits:
            # A range has to have a width.
            low, high = joint.limits
            text += f' limited="true" range="{low} {max(high, low + 1e-6)}"'
        return text + "/>"

    def geom(self, shape: Shape, name: str, friction: float) -> str:
        text = f'<geom pos="{words(shape.position)}" friction="{friction} 0.005 0.0001" type='
        if shape.kind == "box":
            return text + f'"box" size="{words(np.divide(shape.size, 2))}"/>'
        if shape.kind == "sphere":
            return text + f'"sphere" size="{shape.size[0]}"/>'
        if shape.kind in ("capsule", "cylinder"):
            return text + f'"{shape.kind}" size="{shape.size[0]} {shape.size[1] / 2}"/>'
        if shape.kind == "mesh":
            raise Unsupported("meshes collide as their convex hulls")
        points = words([value for point in shape.points for value in point])
        self.assets += f'<mesh name="{name}" vertex="{points}"/>'
        return text + f'"mesh" mesh="{name}"/>'

    def run(self, steps: int) -> None:
        for _ in range(steps if self.moving else 1):
            for index, velocity in self.moving.items():
                self.data.mocap_pos[index] += velocity * self.model.opt.timestep
            mujoco.mj_step(self.model, self.data, 1 if self.moving else steps)

    def now(self) -> None:
        """Brings poses and velocities of bodies up to date."""
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_comVel(self.model, self.data)

    def position(self, body: str) -> np.ndarray:
        self.now()
        return self.data.body(body).xipos.copy()

    def rotation(self, body: str) -> np.ndarray:
        self.now()
        return np.roll(self.data.body(body).xquat, -1)

    def velocity(self, body: str) -> np.ndarray:
        self.now()
        twist = np.zeros(6)
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_XBODY, self.model.body(body).id, twist, 0)
        return np.roll(twist, 3)

    def set_velocity(self, body: str, velocity: Vector) -> None:
        at = self.model.body(body).dofadr[0]
        self.data.qvel[at : at + 3] = velocity[:3]
        # Angular velocities of free bodies are in their own axes.
        self.data.qvel[at + 3 : at + 6] = rotate(conjugate(self.rotation(body)), velocity[3:])

    def coordinate(self, joint: str) -> float:
        return float(self.data.joint(joint).qpos[0])

    def rate(self, joint: str) -> float:
        return float(self.data.joint(joint).qvel[0])

    def actuate(self, joint: str, control: float, gain: float, bias: Vector) -> None:
        actuator = self.model.actuator(joint)
        actuator.gainprm[0], actuator.biastype[0] = gain, mujoco.mjtBias.mjBIAS_AFFINE
        actuator.biasprm[:3] = bias
        self.data.actuator(joint).ctrl[0] = control

    def apply_effort(self, joint: str, effort: float) -> None:
        self.actuate(joint, effort, 1, (0, 0, 0))

    def drive(self, joint: str, rate: float) -> None:
        self.actuate(joint, rate, self.rate_gain, (0, 0, -self.rate_gain))

    def servo(self, joint: str, coordinate: float) -> None:
        self.actuate(joint, coordinate, 100, (0, -100, -10))

    def push(self, body: str, force: Vector, torque: Vector) -> None:
        self.data.body(body).xfrc_applied[:] = (*force, *torque)

    def move(self, body: str, velocity: Vector) -> None:
        self.moving[int(self.model.body(body).mocapid[0])] = np.asarray(velocity, dtype=float)

    def reaction(self, joint: str) -> float:
        mujoco.mj_rnePostConstraint(self.model, self.data)
        child = next(j.child for j in self.scene.joints if j.name == joint)
        return float(np.linalg.norm(self.data.body(child).cfrc_int[3:]))


class MuJoCo3(MuJoCo):
    name = "MuJoCo 3"
