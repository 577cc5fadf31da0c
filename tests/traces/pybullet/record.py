"""Records what pybullet makes of the scenes in this folder; see docs/pybullet.md.

The scenes are the ADF files that ambf_batch reads; this reads the part of ADF that they use and refuses all else, so that nothing
is compared that one side has not seen.
"""

import csv
import gzip
import json
import math
import sys
from pathlib import Path

import pybullet as p
import yaml

FOLDER = Path(__file__).resolve().parent
BODY_KEYS = {
    "name", "mass", "inertia", "location", "damping", "friction", "restitution", "collision shape", "collision geometry",
    "collision mesh", "collision mesh type", "inertial offset",
}
JOINT_KEYS = {
    "name", "type", "parent", "child", "parent pivot", "child pivot", "parent axis", "child axis", "joint erp", "joint cfm",
}
MODEL_KEYS = {"bodies", "joints", "namespace", "ignore inter-collision"}
WORLD_KEYS = {"gravity", "max iterations", "physics"}
# What pybullet keeps for all joints alike: a scene has to ask for the same.
POINT_TO_POINT = {"joint erp": 0.2, "joint cfm": 0}


def load(path, allowed):
    content = yaml.safe_load(path.read_text())
    parts = content.get("bodies", []) + content.get("joints", [])
    unknown = set(content) - allowed - set(parts)
    assert not unknown, f"{path}: {unknown} cannot be given to pybullet"
    return content


def vector(value):
    return [float(value[axis]) for axis in "xyz"]


def position(value):
    assert set(value) == {"position"}, f"{value}: pybullet and ADF round rotations differently; set a velocity instead"
    return vector(value["position"])


def vertices(path):
    """Vertices of an OBJ file without faces."""
    lines = [line.split() for line in path.read_text().splitlines()]
    return [[float(number) for number in line[1:]] for line in lines if line and line[0] == "v"]


def collision_shape(body):
    if "collision mesh" in body:
        assert body["collision mesh type"] == "CONVEX_HULL"
        return p.createCollisionShape(p.GEOM_MESH, vertices=vertices(FOLDER / body["collision mesh"]))
    kind, geometry = body["collision shape"], body["collision geometry"]
    if kind == "Plane":
        assert geometry["offset"] == 0
        return p.createCollisionShape(p.GEOM_PLANE, planeNormal=vector(geometry["normal"]))
    if kind == "Box":
        return p.createCollisionShape(p.GEOM_BOX, halfExtents=[size / 2 for size in vector(geometry)])
    if kind == "Sphere":
        return p.createCollisionShape(p.GEOM_SPHERE, radius=geometry["radius"])
    radius, height = geometry["radius"], geometry["height"]
    assert geometry["axis"] == "Z"
    if kind == "Cylinder":
        return p.createCollisionShape(p.GEOM_CYLINDER, radius=radius, height=height)
    assert kind == "Capsule", kind
    return p.createCollisionShape(p.GEOM_CAPSULE, radius=radius, height=height - 2 * radius)


def set_dynamics(body, index, link):
    """Everything of a body that pybullet takes separately. ADF's defaults where the file says nothing."""
    damping, friction = body.get("damping", {}), body.get("friction", {})
    p.changeDynamics(
        index, link,
        lateralFriction=friction.get("static", 0.5), rollingFriction=friction.get("rolling", 0.01),
        restitution=body.get("restitution", 0.1),
        linearDamping=damping.get("linear", 0.04), angularDamping=damping.get("angular", 0.1),
    )
    if "inertia" in body:
        # With the mass again: pybullet divides by it, and by nothing when it is not given here.
        moments = [float(body["inertia"][axis]) for axis in ("ix", "iy", "iz")]
        p.changeDynamics(index, link, mass=body["mass"], localInertiaDiagonal=moments)


class Rigid:
    """Each body for itself (maximal coordinates)."""

    def __init__(self, scene):
        self.bodies = {}
        for key in scene["bodies"]:
            body = scene[key]
            assert set(body) <= BODY_KEYS, set(body) - BODY_KEYS
            index = p.createMultiBody(
                body["mass"], collision_shape(body), basePosition=position(body.get("location", {"position": dict(x=0, y=0, z=0)})),
                useMaximalCoordinates=1,
            )
            set_dynamics(body, index, -1)
            if scene.get("ignore inter-collision"):
                p.setCollisionFilterGroupMask(index, -1, 0, 0)
            self.bodies[key] = index
        for key in scene["joints"]:
            joint = scene[key]
            assert set(joint) <= JOINT_KEYS and joint["type"] == "p2p", key
            assert all(joint[name] == value for name, value in POINT_TO_POINT.items()), key
            p.createConstraint(
                self.bodies[joint["parent"]], -1, self.bodies[joint["child"]], -1, p.JOINT_POINT2POINT, [0, 0, 0],
                vector(joint["parent pivot"]), vector(joint["child pivot"]),
            )
        self.names = {key: scene[key]["name"] for key in scene["bodies"]}
        self.joints = {}

    def set_velocity(self, key, numbers):
        p.resetBaseVelocity(self.bodies[key], numbers[:3], numbers[3:])

    def state(self, key):
        place, rotation = p.getBasePositionAndOrientation(self.bodies[key])
        linear, angular = p.getBaseVelocity(self.bodies[key])
        return [*place, *rotation, *linear, *angular]


class Articulated:
    """One tree of links on a fixed base (reduced coordinates)."""

    def __init__(self, scene):
        base, *links = scene["bodies"]
        joint_to = {scene[key]["child"]: scene[key] for key in scene["joints"]}
        for key in [base, *links]:
            assert set(scene[key]) <= BODY_KEYS, set(scene[key]) - BODY_KEYS
        assert scene[base]["mass"] == 0 and len(joint_to) == len(links)
        number = {key: place for place, key in enumerate(scene["bodies"])}
        # A link's frame is its joint; the centre of mass of the base is its frame.
        from_joint = {base: [0.0, 0.0, 0.0]}
        places, kinds, axes, parents, centres = [], [], [], [], []
        for key in links:
            joint = joint_to[key]
            assert set(joint) <= JOINT_KEYS and joint["parent axis"] == joint["child axis"], key
            from_joint[key] = [-x for x in vector(joint["child pivot"])]
            centres.append(from_joint[key])
            pivot = vector(joint["parent pivot"])
            places.append([a + b for a, b in zip(from_joint[joint["parent"]], pivot)])
            kinds.append({"revolute": p.JOINT_REVOLUTE, "prismatic": p.JOINT_PRISMATIC}[joint["type"]])
            axes.append(vector(joint["parent axis"]))
            parents.append(number[joint["parent"]])
        n, still = len(links), [[0, 0, 0, 1]] * len(links)
        self.index = p.createMultiBody(
            0, -1, basePosition=position(scene[base]["location"]), linkMasses=[scene[key]["mass"] for key in links],
            linkCollisionShapeIndices=[-1] * n, linkVisualShapeIndices=[-1] * n, linkPositions=places, linkOrientations=still,
            linkInertialFramePositions=centres, linkInertialFrameOrientations=still, linkParentIndices=parents,
            linkJointTypes=kinds, linkJointAxis=axes,
        )
        for link, key in enumerate(links):
            set_dynamics(scene[key], self.index, link)
            # No joint damping or friction, and no motor, which pybullet gives to every joint.
            p.changeDynamics(self.index, link, jointDamping=0)
            p.setJointMotorControl2(self.index, link, p.VELOCITY_CONTROL, force=0)
        # Damping acts on the whole tree, here none.
        p.changeDynamics(self.index, -1, linearDamping=0, angularDamping=0)
        self.names = {key: scene[key]["name"] for key in scene["bodies"]}
        self.links = {key: link for link, key in enumerate(links)}
        self.joints = {joint_to[key]["name"]: link for link, key in enumerate(links)}
        for key in links:
            start, wanted = self.state(key)[:3], position(scene[key]["location"])
            assert max(abs(a - b) for a, b in zip(start, wanted)) < 1e-15, f"{key} starts at {start}, not at {wanted}"

    def set_velocity(self, key, numbers):
        raise ValueError(f"{key}: trees start at rest")

    def state(self, key):
        if key not in self.links:
            return [*p.getBasePositionAndOrientation(self.index)[0], 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]
        state = p.getLinkState(self.index, self.links[key], computeLinkVelocity=1, computeForwardKinematics=1)
        return [*state[0], *state[1], *state[6], *state[7]]

    def joint(self, link):
        return p.getJointState(self.index, link)[:2]


def commands(path):
    """Velocities at the start: lines `0|0|TW|body|vx vy vz wx wy wz`."""
    if not path.exists():
        return []
    lines = [line.split("|") for line in path.read_text().splitlines() if line and not line.startswith("#")]
    assert all(line[:3] == ["0", "0", "TW"] for line in lines), path
    return [(line[3], [float(number) for number in line[4].split()]) for line in lines]


def rows(path, heading):
    """Opens a compressed table; the same content gives the same bytes."""
    raw = gzip.GzipFile(path, "wb", 9, mtime=0)

    def write(cells):
        raw.write((",".join(cells) + "\n").encode())

    write(heading.split(","))
    return raw, write


def record(run):
    p.resetSimulation()
    world = load(FOLDER / "world.yaml", WORLD_KEYS)
    scene = load(FOLDER / f"{run['scene']}.yaml", MODEL_KEYS)
    p.setGravity(*vector(world["gravity"]))
    p.setTimeStep(float(run["dt"]))
    made = {"rigid": Rigid, "articulated": Articulated}[run["method"]](scene)
    keys = {name: key for key, name in made.names.items()}
    for name, numbers in commands(FOLDER / f"{run['scene']}.txt"):
        made.set_velocity(keys[name], numbers)
    bodies, write_body = rows(FOLDER / f"{run['run']}_bodies.csv.gz", "step,body,px,py,pz,qx,qy,qz,qw,vx,vy,vz,wx,wy,wz")
    joints = None
    if made.joints:
        joints, write_joint = rows(FOLDER / f"{run['run']}_joints.csv.gz", "step,joint,position,velocity")
    steps, every = int(run["steps"]), int(run["every"])
    for step in range(steps + 1):
        if step:
            p.stepSimulation()
        if step % every == 0 or step == steps:
            for key, name in made.names.items():
                assert all(map(math.isfinite, made.state(key))), f"{run['run']}: pybullet lost {name} in step {step}"
                write_body([str(step), name, *(f"{number:.17g}" for number in made.state(key))])
            for name, link in made.joints.items():
                write_joint([str(step), name, *(f"{number:.17g}" for number in made.joint(link))])
    bodies.close()
    if joints:
        joints.close()


def hull(points):
    """The vertices that pybullet makes of those of a hull: it leaves some out and rounds the others."""
    body = p.createMultiBody(1, p.createCollisionShape(p.GEOM_MESH, vertices=points), useMaximalCoordinates=1)
    return [list(vertex) for vertex in p.getMeshData(body, -1)[1]]


def print_hull(path):
    """Prints vertices of a hull that pybullet leaves as they are."""
    points = vertices(path)
    while (used := hull(points)) != points:
        points = used
    for point in points:
        print("v", *(repr(number) for number in point))


def main():
    p.connect(p.DIRECT)
    if sys.argv[1:2] == ["--hull"]:
        print_hull(Path(sys.argv[2]))
        return
    for path in FOLDER.glob("*.obj"):
        assert hull(vertices(path)) == vertices(path), f"{path}: pybullet moves its vertices; take those of --hull"
    settings = {
        "pybullet": "3.2.7", "api": p.getAPIVersion(), "engine": p.getPhysicsEngineParameters(),
        "python": sys.version.split()[0],
    }
    (FOLDER / "settings.json").write_text(json.dumps(settings, indent=2, sort_keys=True) + "\n")
    with open(FOLDER / "runs.csv", newline="") as table:
        for run in csv.DictReader(table):
            record(run)
            print(run["run"])


main()
