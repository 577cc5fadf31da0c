"""Small scenes for the tests: no gravity, so that only commands move things."""

import json
import math

NOWHERE = {"x": 0.0, "y": 0.0, "z": 0.0}
LIGHT = "/ambf/env/lights/lamp"
CAMERA = "/ambf/env/cameras/eye"
WORLD = "/ambf/env/World"


def box(name, mass, x=0.0, z=0.0, size=0.2):
    """A box at (x, 0, z) m with edges of `size` m; mass 0 (kg) makes it static."""
    edges = {"x": size, "y": size, "z": size}
    return {
        "name": name,
        "mesh": "",
        "mass": mass,
        "inertia": {"ix": 0.1, "iy": 0.1, "iz": 0.1} if mass else {"ix": 0.0, "iy": 0.0, "iz": 0.0},
        "location": {"position": {"x": x, "y": 0.0, "z": z}, "orientation": {"r": 0.0, "p": 0.0, "y": 0.0}},
        "inertial offset": {"position": NOWHERE, "orientation": {"r": 0.0, "p": 0.0, "y": 0.0}},
        "friction": {"static": 0.5, "rolling": 0.0},
        "restitution": 0.0,
        "damping": {"linear": 0.0, "angular": 0.0},
        "shape": "Box",
        "geometry": edges,
        "collision shape": "Box",
        "collision geometry": edges,
        "collision groups": [0],
        "publish children names": True,
        "publish joint names": True,
        "publish joint positions": True,
    }


def model(bodies, joints=None):
    """A model file's content from {key: data} of bodies and joints."""
    joints = joints or {}
    return {
        "bodies": list(bodies),
        "joints": list(joints),
        "high resolution path": "./",
        "low resolution path": "./",
        "ignore inter-collision": True,
        "namespace": "/ambf/env/",
        **bodies,
        **joints,
    }


def write(folder):
    """Writes launch.yaml and what it names. Index 0: pendulum, 1: boxes, 2: broken YAML, 3: missing mesh, 4: a grid."""
    folder.mkdir(parents=True)
    world = {
        "environment": "./ground.yaml",
        "namespace": "/ambf/env/",
        "max iterations": 50,
        "gravity": NOWHERE,
        "lights": ["LIGHT lamp"],
        "cameras": ["CAMERA eye"],
        "LIGHT lamp": {
            "namespace": "/ambf/env/lights/",
            "name": "lamp",
            "location": {"x": 0.0, "y": 0.5, "z": 2.5},
            "direction": {"x": 0.0, "y": 0.0, "z": -1.0},
            "spot exponent": 0.3,
            "shadow quality": 0,
            "cutoff angle": 0.7,
        },
        "CAMERA eye": {
            "namespace": "/ambf/env/cameras/",
            "name": "eye",
            "location": {"x": 4.0, "y": 0.0, "z": 1.0},
            "look at": {"x": 0.0, "y": 0.0, "z": 1.0},
            "up": {"x": 0.0, "y": 0.0, "z": 1.0},
            "clipping plane": {"near": 0.01, "far": 20.0},
            "field view angle": 0.8,
        },
    }
    ground = model({"BODY Ground": dict(box("Ground", 0.0, z=-50.0, size=1.0), passive=True)})
    hinge = {
        "name": "Base-Link",
        "parent": "BODY Base",
        "child": "BODY Link",
        "parent axis": {"x": 0.0, "y": 1.0, "z": 0.0},
        "parent pivot": NOWHERE,
        "child axis": {"x": 0.0, "y": 1.0, "z": 0.0},
        "child pivot": {"x": -0.25, "y": 0.0, "z": 0.0},
        "type": "revolute",
        "controller": {"P": 100.0, "I": 0.0, "D": 5.0},
        "enable feedback": True,
    }
    pendulum = model(
        {"BODY Base": box("Base", 0.0, z=3.0), "BODY Link": box("Link", 1.0, x=0.25, z=3.0)}, {"JOINT Base-Link": hinge}
    )
    boxes = model({"BODY Free": box("Free", 1.0), "BODY Wall": box("Wall", 0.0, x=5.0)})
    mesh = {key: value for key, value in box("Meshed", 1.0).items() if "shape" not in key and "geometry" not in key}
    mesh["mesh"] = "nothere.STL"
    side = math.ceil(math.sqrt(200))
    grid = model({f"BODY B{i}": dict(box(f"B{i}", 1.0, x=i % side, z=10.0 + i // side)) for i in range(200)})
    files = {
        "world.yaml": world,
        "ground.yaml": ground,
        "colors.yaml": {"red": {"r": 255, "g": 0, "b": 0, "a": 255}},
        "devices.yaml": {"input devices": []},
        "pendulum.yaml": pendulum,
        "boxes.yaml": boxes,
        "mesh.yaml": model({"BODY Meshed": mesh}),
        "grid.yaml": grid,
        "launch.yaml": {
            "world config": "./world.yaml",
            "color config": "./colors.yaml",
            "input devices config": "./devices.yaml",
            "multibody configs": ["./pendulum.yaml", "./boxes.yaml", "./broken.yaml", "./mesh.yaml", "./grid.yaml"],
        },
        "unfinished_launch.yaml": {"world config": "./world.yaml"},
    }
    for name, content in files.items():
        # JSON is YAML.
        (folder / name).write_text(json.dumps(content, indent=1))
    (folder / "broken.yaml").write_text("bodies: [BODY A\njoints: []\n")


def drill(folder, phantom):
    """A launch file that names the C++ drilling plugin, and what it is for: a drill at rest, two burrs, the voxels of `phantom`."""
    folder.mkdir(parents=True)
    places = {"position": {"x": 0.0, "y": 0.0, "z": 0.02}, "orientation": {"r": 0.0, "p": 0.0, "y": 0.0}}
    names = ("mastoidectomy_drill", "6mm", "4mm")
    bodies = {f"BODY {name}": {"name": name, "mass": 0.0, "location": places} for name in names}
    volume = {"name": "temporal_bone", "nrrd": str(phantom)}
    content = dict(model(bodies), volumes=["VOLUME temporal_bone"], **{"VOLUME temporal_bone": volume})
    launch = {
        "world config": "./world.yaml",
        "color config": "./colors.yaml",
        "input devices config": "./devices.yaml",
        "multibody configs": ["./drill.yaml"],
        "plugins": [{"name": "volumetric_drilling", "path": "../build", "filename": "libvolumetric_drilling.so"}],
    }
    world = {"namespace": "/ambf/env/", "max iterations": 50, "gravity": NOWHERE}
    files = {"launch": launch, "world": world, "drill": content, "devices": {"input devices": []}}
    files["colors"] = {"red": {"r": 255, "g": 0, "b": 0, "a": 255}}
    for name, data in files.items():
        (folder / f"{name}.yaml").write_text(json.dumps(data, indent=1))
