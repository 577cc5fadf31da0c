"""Runs cases of the accuracy benchmark in pybullet and MuJoCo.

Reads a request a line from standard input (JSON: peer, system, step, times, most) and answers each with a line: cpu (s, of the steps
alone), tail (of the last interval), samples (for each time and body: position, quaternion x y z w, velocity, angular velocity; world axes, SI units), or late, or
problem. Control laws are computed here and are not part of the time.
"""

import json
import math
import os
import sys
import time

# The answers own standard output; pybullet prints to it as it likes.
ANSWERS = os.fdopen(os.dup(1), "w", buffering=1)
os.dup2(2, 1)

import mujoco  # noqa: E402
import numpy as np  # noqa: E402
import pybullet  # noqa: E402


def set_point(drive, now):
    """Set point of all joints and its rate."""
    phase = drive["rate"] * now
    return drive["amplitude"] * (1 - math.cos(phase)), drive["amplitude"] * drive["rate"] * math.sin(phase)


def rotation(quaternion):
    x, y, z, w = quaternion
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


def conjugate(quaternion):
    x, y, z, w = quaternion
    return [-x, -y, -z, w]


def local(body, point):
    """A point of the world in a body's frame."""
    return rotation(body["quaternion"]).T @ (np.array(point) - np.array(body["position"]))


class Bullet:
    """pybullet: trees as multi-bodies, single bodies as multi-bodies or in maximal coordinates."""

    def __init__(self, system, step, maximal):
        self.p, self.drive = pybullet, system["drive"]
        self.client = pybullet.connect(pybullet.DIRECT)
        pybullet.setPhysicsEngineParameter(fixedTimeStep=step, numSubSteps=0, deterministicOverlappingPairs=1)
        if system["restitution"] > 0:
            pybullet.setPhysicsEngineParameter(restitutionVelocityThreshold=0)
        pybullet.setGravity(*system["gravity"])
        bodies, joints = system["bodies"], system["joints"]
        if joints:
            self.build_tree(system)
        else:
            self.places = [(self.build_body(body, system, maximal), -1) for body in bodies]
        for closure in system["closures"]:
            self.close(closure, bodies)

    def build_body(self, body, system, maximal):
        p = self.p
        shape = body["shape"] or {}
        collision = -1
        if "box" in shape:
            collision = p.createCollisionShape(p.GEOM_BOX, halfExtents=[x / 2 for x in shape["box"]])
        elif "sphere" in shape:
            collision = p.createCollisionShape(p.GEOM_SPHERE, radius=shape["sphere"])
        elif "ground" in shape:
            collision = p.createCollisionShape(p.GEOM_PLANE, planeNormal=[0, 0, 1])
        elif maximal:
            # Without a shape it would not be made.
            collision = p.createCollisionShape(p.GEOM_SPHERE, radius=0.01)
        made = p.createMultiBody(body["mass"], collision, -1, body["position"], body["quaternion"],
                                 useMaximalCoordinates=int(maximal))
        # Bullet multiplies the coefficients of the two bodies.
        p.changeDynamics(made, -1, lateralFriction=math.sqrt(system["friction"]), rollingFriction=0, spinningFriction=0,
                         restitution=math.sqrt(system["restitution"]), linearDamping=0, angularDamping=0)
        if body["mass"] > 0:
            # A body in maximal coordinates loses its mass when only its inertia is set.
            p.changeDynamics(made, -1, mass=body["mass"], localInertiaDiagonal=body["inertia"],
                             activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING)
            p.resetBaseVelocity(made, body["velocity"], body["spin"])
        return made

    def build_tree(self, system):
        p, bodies, joints = self.p, system["bodies"], system["joints"]
        link_of = {joint["child"]: index for index, joint in enumerate(joints)}
        positions, orientations, frames, turns, parents, kinds, axes = [], [], [], [], [], [], []
        for joint in joints:
            parent, child = bodies[joint["parent"]], bodies[joint["child"]]
            # Link frames lie at the pivots, turned as the children are; the base's lies in its centre.
            relative = p.multiplyTransforms([0, 0, 0], conjugate(parent["quaternion"]), [0, 0, 0], child["quaternion"])[1]
            above = link_of.get(joint["parent"])
            origin = 0 if above is None else local(parent, joints[above]["pivot"])
            positions.append(list(local(parent, joint["pivot"]) - origin))
            orientations.append(relative)
            frames.append(list(-local(child, joint["pivot"])))
            turns.append([0, 0, 0, 1])
            parents.append(link_of.get(joint["parent"], -1) + 1)
            kinds.append(p.JOINT_PRISMATIC if joint["slider"] else p.JOINT_REVOLUTE)
            axes.append(list(rotation(child["quaternion"]).T @ np.array(joint["axis"])))
        count = len(joints)
        tree = p.createMultiBody(
            0, -1, -1, bodies[0]["position"], bodies[0]["quaternion"],
            linkMasses=[bodies[joint["child"]]["mass"] for joint in joints],
            linkCollisionShapeIndices=[-1] * count, linkVisualShapeIndices=[-1] * count,
            linkPositions=positions, linkOrientations=orientations,
            linkInertialFramePositions=frames, linkInertialFrameOrientations=turns,
            linkParentIndices=parents, linkJointTypes=kinds, linkJointAxis=axes)
        for index in range(-1, count):
            p.changeDynamics(tree, index, linearDamping=0, angularDamping=0, jointDamping=0, maxJointVelocity=1e6)
        for index, joint in enumerate(joints):
            p.changeDynamics(tree, index, localInertiaDiagonal=bodies[joint["child"]]["inertia"])
            p.setJointMotorControl2(tree, index, p.VELOCITY_CONTROL, force=0)
            p.resetJointState(tree, index, 0, rate(joint, bodies))
        self.tree, self.count = tree, count
        self.places = [(tree, link_of.get(body, -1)) for body in range(len(bodies))]

    def close(self, closure, bodies):
        for point in closure["points"]:
            (a, link_a), (b, link_b) = self.places[closure["a"]], self.places[closure["b"]]
            held = self.p.createConstraint(a, link_a, b, link_b, self.p.JOINT_POINT2POINT, [0, 0, 0],
                                           list(local(bodies[closure["a"]], point)), list(local(bodies[closure["b"]], point)))
            self.p.changeConstraint(held, maxForce=1e12)

    def control(self, now):
        angle, speed = set_point(self.drive, now)
        states = self.p.getJointStates(self.tree, range(self.count))
        efforts = [p * (angle - state[0]) + d * (speed - state[1]) for (p, d), state in zip(self.drive["gains"], states)]
        self.p.setJointMotorControlArray(self.tree, range(self.count), self.p.TORQUE_CONTROL, forces=efforts)

    def steps(self, count):
        step = self.p.stepSimulation
        for _ in range(count):
            step()

    def states(self):
        found = []
        for body, link in self.places:
            if link < 0:
                position, quaternion = self.p.getBasePositionAndOrientation(body)
                velocity, spin = self.p.getBaseVelocity(body)
            else:
                state = self.p.getLinkState(body, link, computeLinkVelocity=1, computeForwardKinematics=1)
                position, quaternion, velocity, spin = state[0], state[1], state[6], state[7]
            found.append([*position, *quaternion, *velocity, *spin])
        return found

    def close_down(self):
        self.p.disconnect(self.client)


def rate(joint, bodies):
    """Rate of a joint from the initial velocities of its two bodies."""
    parent, child = bodies[joint["parent"]], bodies[joint["child"]]
    axis = np.array(joint["axis"])
    if not joint["slider"]:
        return float(axis @ (np.array(child["spin"]) - np.array(parent["spin"])))
    carried = np.array(parent["velocity"]) + np.cross(parent["spin"], np.array(child["position"]) - np.array(parent["position"]))
    return float(axis @ (np.array(child["velocity"]) - carried))


class Mujoco:
    """MuJoCo: trees in joint coordinates, loops by soft point constraints, contacts as it makes them by default."""

    def __init__(self, system, step, integrator):
        self.drive = system["drive"]
        self.model = mujoco.MjModel.from_xml_string(self.text(system, step, integrator))
        self.data = mujoco.MjData(self.model)
        bodies = system["bodies"]
        if system["joints"]:
            self.data.qvel[:] = [rate(joint, bodies) for joint in system["joints"]]
        else:
            moving = [body for body in bodies if body["mass"] > 0]
            for index, body in enumerate(moving):
                # Free joints turn in their own axes.
                self.data.qvel[6 * index:6 * index + 3] = body["velocity"]
                self.data.qvel[6 * index + 3:6 * index + 6] = rotation(body["quaternion"]).T @ np.array(body["spin"])
        mujoco.mj_forward(self.model, self.data)
        self.ids = [0 if index == 0 and body["mass"] == 0 else self.model.body(f"b{index}").id
                    for index, body in enumerate(bodies)]

    @staticmethod
    def text(system, step, integrator):
        bodies, joints = system["bodies"], system["joints"]
        numbers = lambda values: " ".join(repr(float(value)) for value in values)  # noqa: E731
        wxyz = lambda q: numbers([q[3], q[0], q[1], q[2]])  # noqa: E731
        friction = f'condim="3" friction="{max(system["friction"], 1e-5)!r} 0 0"'
        if system["friction"] == 0:
            friction = 'condim="1"'

        def geom(body):
            shape = body["shape"] or {}
            if "box" in shape:
                return f'<geom type="box" size="{numbers(x / 2 for x in shape["box"])}" {friction}/>'
            if "sphere" in shape:
                return f'<geom type="sphere" size="{shape["sphere"]!r}" {friction}/>'
            if "ground" in shape:
                return f'<geom type="plane" size="0 0 1" {friction}/>'
            return ""

        def element(index, parent, joint):
            body = bodies[index]
            # A body's frame in its parent's, which for the world is the world's.
            place, turn = body["position"], body["quaternion"]
            if parent is not None:
                place = local(bodies[parent], body["position"])
                turn = pybullet.multiplyTransforms([0, 0, 0], conjugate(bodies[parent]["quaternion"]), [0, 0, 0], turn)[1]
            inside = f'<inertial pos="0 0 0" mass="{body["mass"]!r}" diaginertia="{numbers(body["inertia"])}"/>{geom(body)}'
            if joint is None:
                freedom = "<freejoint/>"
            else:
                kind = "slide" if joint["slider"] else "hinge"
                axis = rotation(body["quaternion"]).T @ np.array(joint["axis"])
                freedom = (f'<joint name="j{joints.index(joint)}" type="{kind}" pos="{numbers(local(body, joint["pivot"]))}" '
                           f'axis="{numbers(axis)}"/>')
            children = "".join(element(j["child"], index, j) for j in joints if j["parent"] == index)
            return f'<body name="b{index}" pos="{numbers(place)}" quat="{wxyz(turn)}">{freedom}{inside}{children}</body>'

        if joints:
            content = "".join(element(j["child"], None, j) for j in joints if j["parent"] == 0)
        else:
            content = "".join(geom(body) if body["mass"] == 0 else element(index, None, None)
                              for index, body in enumerate(bodies))
        ties = "".join(
            f'<connect body1="b{closure["a"]}" body2="b{closure["b"]}" anchor="{numbers(local(bodies[closure["a"]], point))}"/>'
            for closure in system["closures"] for point in closure["points"])
        drives = ""
        if system["drive"]:
            drives = "".join(
                f'<general joint="j{index}" gainprm="{p!r}" biastype="affine" biasprm="0 {-p!r} {-d!r}"/>'
                for index, (p, d) in enumerate(system["drive"]["gains"]))
        return (f'<mujoco><compiler angle="radian"/><option timestep="{step!r}" integrator="{integrator}" cone="elliptic" '
                f'gravity="{numbers(system["gravity"])}"/><worldbody>{content}</worldbody>'
                f'<equality>{ties}</equality><actuator>{drives}</actuator></mujoco>')

    def control(self, now):
        angle, speed = set_point(self.drive, now)
        # The D part acts on the rate alone; its share of the set point's rate goes into the set point.
        self.data.ctrl[:] = [angle + d / p * speed for p, d in self.drive["gains"]]

    def steps(self, count):
        mujoco.mj_step(self.model, self.data, nstep=count)

    def states(self):
        mujoco.mj_forward(self.model, self.data)
        found, velocity = [], np.zeros(6)
        for index in self.ids:
            mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_BODY, index, velocity, 0)
            w, x, y, z = self.data.xquat[index]
            found.append([*self.data.xipos[index], x, y, z, w, *velocity[3:], *velocity[:3]])
        return found

    def close_down(self):
        pass


def build(peer, system, step):
    if peer.startswith("pybullet"):
        return Bullet(system, step, peer.endswith("maximal"))
    integrator = {"Euler": "Euler", "implicit": "implicit", "RK4": "RK4"}[peer.split()[-1]]
    return Mujoco(system, step, integrator)


def run(request):
    system, step = request["system"], request["step"]
    simulator = build(request["peer"], system, step)
    try:
        cpu, tail, done, samples = 0.0, 0.0, 0, []
        for now in request["times"]:
            until, before = round(now / step), cpu
            if system["drive"]:
                for index in range(done, until):
                    simulator.control(index * step)
                    begin = time.thread_time_ns()
                    simulator.steps(1)
                    cpu += time.thread_time_ns() - begin
            else:
                # In parts, so that what takes too long can be given up.
                for index in range(done, until, 20):
                    begin = time.thread_time_ns()
                    simulator.steps(min(20, until - index))
                    cpu += time.thread_time_ns() - begin
                    if cpu > request["most"] * 1e9:
                        return {"late": True}
            done, tail = until, cpu - before
            states = np.array(simulator.states(), dtype=float)
            if not np.isfinite(states).all():
                break
            samples.append(states.tolist())
            if cpu > request["most"] * 1e9:
                return {"late": True}
        return {"cpu": cpu * 1e-9, "tail": tail * 1e-9, "samples": samples}
    finally:
        simulator.close_down()


def main():
    versions = f"pybullet 3.2.7 (API {pybullet.getAPIVersion()}), MuJoCo {mujoco.__version__}"
    print(json.dumps({"versions": versions}), file=ANSWERS)
    for line in sys.stdin:
        try:
            answer = run(json.loads(line))
        except Exception as problem:  # The benchmark goes on with the next request.
            answer = {"problem": f"{type(problem).__name__}: {problem}"}
        print(json.dumps(answer), file=ANSWERS)


if __name__ == "__main__":
    main()
