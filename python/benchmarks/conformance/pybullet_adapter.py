"""pybullet with its defaults, by URDF: joints are Featherstone's, bodies without joints too."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from typing import Callable, Dict, Tuple

import numpy as np
import urdf
from scene import Scene, Simulator, Unsupported, Vector

# It prints to standard output as it likes.
ANSWERS = os.dup(1)
os.dup2(2, 1)
import pybullet  # noqa: E402

os.dup2(ANSWERS, 1)
sys.stdout.flush()


class PyBullet(Simulator):
    name = "pybullet"

    def __init__(self, scene: Scene, step: float) -> None:
        self.scene = scene
        self.client = client = pybullet.connect(pybullet.DIRECT)
        pybullet.setTimeStep(step, client)
        pybullet.setGravity(*scene.gravity, physicsClientId=client)
        self.files = tempfile.TemporaryDirectory(prefix="conformance_")
        folder = Path(self.files.name)
        # The base has the link −1; links are named after their joints' children.
        self.links: Dict[str, Tuple[int, int]] = {}
        self.joints: Dict[str, Tuple[int, int]] = {}
        self.acting: Dict[str, Callable[[], None]] = {}
        for root, path in urdf.robots(scene, folder, concave=' concave="yes"').items():
            fixed = scene.body(root).mass == 0
            robot = pybullet.loadURDF(
                str(path), useFixedBase=fixed, flags=pybullet.URDF_USE_INERTIA_FROM_FILE, physicsClientId=client
            )
            self.links[root] = (robot, -1)
            for index in range(pybullet.getNumJoints(robot, client)):
                info = pybullet.getJointInfo(robot, index, client)
                self.links[info[12].decode()] = self.joints[info[1].decode()] = (robot, index)
                pybullet.setJointMotorControl2(robot, index, pybullet.VELOCITY_CONTROL, force=0, physicsClientId=client)
                pybullet.enableJointForceTorqueSensor(robot, index, True, client)
        for body in scene.bodies:
            robot, index = self.links[body.name]
            pybullet.changeDynamics(
                robot,
                index,
                lateralFriction=body.friction**0.5,
                restitution=0,
                linearDamping=0,
                angularDamping=0,
                physicsClientId=client,
            )
        for joint in scene.joints:
            if not joint.closes_loop:
                # Its own largest rate is 100 rad/s.
                most = joint.speed or 1e9
                pybullet.changeDynamics(*self.joints[joint.name], maxJointVelocity=most, physicsClientId=client)
            if joint.mimics:
                self.couple(joint.mimics[0], joint.name, joint.mimics[1], joint.axis)
            if joint.closes_loop:
                self.close(joint.parent, joint.child, joint.anchor)

    def couple(self, leader: str, follower: str, ratio: float, axis: Vector) -> None:
        a, b = self.joints[leader], self.joints[follower]
        gear = pybullet.createConstraint(
            *a, *b, pybullet.JOINT_GEAR, axis, (0, 0, 0), (0, 0, 0), physicsClientId=self.client
        )
        pybullet.changeConstraint(gear, gearRatio=-1 / ratio, maxForce=1e4, erp=1, physicsClientId=self.client)

    def close(self, parent: str, child: str, anchor: Vector) -> None:
        places = []
        for name in (parent, child):
            position, rotation = self.frame(name)
            back = pybullet.invertTransform(position, rotation)
            places.append(pybullet.multiplyTransforms(*back, anchor, (0, 0, 0, 1))[0])
        pybullet.createConstraint(
            *self.links[parent],
            *self.links[child],
            pybullet.JOINT_POINT2POINT,
            (0, 0, 0),
            *places,
            physicsClientId=self.client,
        )

    def frame(self, body: str) -> Tuple[Vector, Vector]:
        robot, index = self.links[body]
        if index < 0:
            return pybullet.getBasePositionAndOrientation(robot, self.client)
        return pybullet.getLinkState(robot, index, computeForwardKinematics=1, physicsClientId=self.client)[:2]

    def run(self, steps: int) -> None:
        for _ in range(steps):
            for act in self.acting.values():
                act()
            pybullet.stepSimulation(self.client)

    def position(self, body: str) -> np.ndarray:
        return np.array(self.frame(body)[0])

    def rotation(self, body: str) -> np.ndarray:
        return np.array(self.frame(body)[1])

    def velocity(self, body: str) -> np.ndarray:
        robot, index = self.links[body]
        if index < 0:
            return np.concatenate(pybullet.getBaseVelocity(robot, self.client))
        state = pybullet.getLinkState(
            robot, index, computeLinkVelocity=1, computeForwardKinematics=1, physicsClientId=self.client
        )
        return np.concatenate(state[6:8])

    def set_velocity(self, body: str, velocity: Vector) -> None:
        pybullet.resetBaseVelocity(self.links[body][0], velocity[:3], velocity[3:], self.client)

    def coordinate(self, joint: str) -> float:
        return float(pybullet.getJointState(*self.joints[joint], self.client)[0])

    def rate(self, joint: str) -> float:
        return float(pybullet.getJointState(*self.joints[joint], self.client)[1])

    def apply_effort(self, joint: str, effort: float) -> None:
        robot, index = self.joints[joint]
        self.acting[joint] = lambda: pybullet.setJointMotorControl2(
            robot, index, pybullet.TORQUE_CONTROL, force=effort, physicsClientId=self.client
        )

    def largest(self, joint: str) -> float:
        return next(j.effort for j in self.scene.joints if j.name == joint) or 100.0

    def drive(self, joint: str, rate: float) -> None:
        pybullet.setJointMotorControl2(
            *self.joints[joint],
            pybullet.VELOCITY_CONTROL,
            targetVelocity=rate,
            force=self.largest(joint),
            physicsClientId=self.client,
        )

    def servo(self, joint: str, coordinate: float) -> None:
        pybullet.setJointMotorControl2(
            *self.joints[joint],
            pybullet.POSITION_CONTROL,
            targetPosition=coordinate,
            force=self.largest(joint),
            physicsClientId=self.client,
        )

    def push(self, body: str, force: Vector, torque: Vector) -> None:
        robot, index = self.links[body]

        def act() -> None:
            at = self.frame(body)[0]
            pybullet.applyExternalForce(robot, index, force, at, pybullet.WORLD_FRAME, self.client)
            pybullet.applyExternalTorque(robot, index, torque, pybullet.WORLD_FRAME, self.client)

        self.acting[body] = act

    def move(self, body: str, velocity: Vector) -> None:
        robot, index = self.links[body]
        if index >= 0:
            raise Unsupported("moving links")

        self.acting[body] = lambda: pybullet.resetBaseVelocity(robot, velocity, (0, 0, 0), self.client)

    def reaction(self, joint: str) -> float:
        return float(np.linalg.norm(pybullet.getJointState(*self.joints[joint], self.client)[2][:3]))
