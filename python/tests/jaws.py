"""Scenes of the tests of the client, without ROS: a gripper with ghosts in its jaws, and what it can grasp; models side by side."""

import json
import pathlib
import shutil

import yaml
from scenes import NOWHERE, box, model

RESOURCES = pathlib.Path(__file__).resolve().parents[2] / "resources"

# A model that is added later.
ADDED = RESOURCES / "models/pendulum.yaml"

LEVEL = {"r": 0.0, "p": 0.0, "y": 0.0}


def xyz(x, y, z):
    return {"x": x, "y": y, "z": z}


def at(x, y, z):
    return {"position": xyz(x, y, z), "orientation": LEVEL}


def block(name, mass, size, x, z, **more):
    """A box with edges `size` (m) at (x, 0, z)."""
    edges = xyz(*size)
    return {**box(name, mass, x=x, z=z), "geometry": edges, "collision geometry": edges, **more}


def ghost(name, parent, size, x, z, **more):
    """A ghost object of that size; (x, 0, z) is in the frame of the parent, or in the world."""
    edges = xyz(*size)
    shape = {"shape": "Box", "geometry": edges, "collision shape": "Box", "collision geometry": edges}
    return {"name": name, "parent": parent, "location": at(x, 0.0, z), **shape, **more}


def joint(name, kind, parent, child, axis, low, high, controller, **pivots):
    """A joint whose axis is the same in both bodies."""
    return {
        "name": name,
        "type": kind,
        "parent": parent,
        "child": child,
        "parent axis": xyz(*axis),
        "child axis": xyz(*axis),
        "parent pivot": xyz(*pivots["parent_pivot"]),
        "child pivot": xyz(*pivots["child_pivot"]),
        "joint limits": {"low": low, "high": high},
        "controller": controller,
    }


def arm():
    """A gripper of two jaws that a slide lifts, as the Blender add-on writes it: a ghost in each jaw feels what is graspable."""
    weightless = {"gravity": NOWHERE}
    bodies = {
        "BODY baselink": block("baselink", 0.0, (0.1, 0.1, 0.04), 0.0, -0.9),
        "BODY toollink": block("toollink", 0.5, (0.12, 0.04, 0.04), 0.0, -1.385, **weightless),
    }
    joints = {
        "JOINT lift": joint(
            "lift",
            "prismatic",
            "BODY baselink",
            "BODY toollink",
            (0.0, 0.0, 1.0),
            -0.01,
            0.3,
            {"P": 1000.0, "I": 0.0, "D": 60.0},
            parent_pivot=(0.0, 0.0, -0.485),
            child_pivot=(0.0, 0.0, 0.0),
        )
    }
    ghosts = {}
    for side, sign in (("left", -1.0), ("right", 1.0)):
        finger = f"BODY {side} finger"
        bodies[finger] = block(f"{side} finger", 0.05, (0.01, 0.03, 0.08), 0.04 * sign, -1.455, **weightless)
        joints[f"JOINT {side}_jaw"] = joint(
            f"{side}_jaw",
            "revolute",
            "BODY toollink",
            finger,
            # Positive closes.
            (0.0, sign, 0.0),
            -0.1,
            0.8,
            {"P": 5.0, "I": 0.0, "D": 1.0},
            parent_pivot=(0.04 * sign, 0.0, -0.03),
            child_pivot=(0.0, 0.0, 0.04),
        )
        # In front of the finger's inner side.
        key = f"GHOST {side} finger ghost"
        name = f"{side}_finger_ghost"
        ghosts[key] = ghost(name, finger, (0.008, 0.02, 0.03), -0.01 * sign, -0.022, **{"collision groups": [1]})
    actuators = {"ACTUATOR Actuator0": {"name": "Actuator0", "type": "Constraint", "parent": "BODY toollink"}}
    return {
        **model(bodies, joints),
        **ghosts,
        **actuators,
        "namespace": "/ambf/env/psm1/",
        "ghost objects": list(ghosts),
        "actuators": list(actuators),
    }


def things():
    """What lies about: a needle to grasp, an entry with a ghost around it, two exits and a ghost, a cup on a table that feels."""
    light = {"inertia": {"ix": 1e-4, "iy": 1e-4, "iz": 1e-4}}
    bodies = {
        "BODY Needle": block("Needle", 0.1, (0.04, 0.04, 0.04), 0.0, -1.48, **light, **{"collision groups": [0, 1]}),
        "BODY Entry1": block("Entry1", 0.0, (0.1, 0.1, 0.1), 1.0, -1.0, **{"collision groups": [2]}),
        "BODY Exit1": block("Exit1", 0.0, (0.1, 0.1, 0.1), 1.5, -1.0),
        "BODY Exit1b": block("Exit1b", 0.0, (0.1, 0.1, 0.1), 2.0, -1.0),
        "BODY table": block("table", 0.0, (0.4, 0.4, 0.1), 3.0, -1.0),
        "BODY cup": block("cup", 0.5, (0.1, 0.1, 0.1), 3.0, -0.9),
    }
    ghosts = {
        f"GHOST {name}": ghost(name, "", (0.2, 0.2, 0.2), x, -1.0, **{"collision groups": [2]})
        for name, x in (("ghostEntry1", 1.0), ("ghostExit1", 1.5))
    }
    scale = {"name": "scale", "type": "Contact", "parent": "BODY table", "distance threshold": 0.001}
    sensors = {
        "SENSOR scale": {**scale, "process contact details": True},
        "SENSOR feeler": {**scale, "name": "feeler"},
    }
    return {
        **model(bodies),
        **ghosts,
        **sensors,
        "ignore inter-collision": False,
        "ghost objects": list(ghosts),
        "sensors": list(sensors),
    }


def write(folder):
    """Writes the gripper and the things to files; their paths."""
    files = []
    for name, scene in (("arm", arm()), ("things", things())):
        files.append(folder / f"{name}.yaml")
        files[-1].write_text(json.dumps(scene, indent=1))
    return files


def moved(name, x, folder):
    """The model of that name in resources/models, `x` m aside, so that several find place side by side; its path below `folder`."""
    # Aliases in the file would move twice.
    scene = json.loads(json.dumps(yaml.safe_load((RESOURCES / "models" / f"{name}.yaml").read_text())))
    keys = [key for kind in ("bodies", "soft bodies", "ghost objects") for key in scene.get(kind) or ()]
    for key in keys:
        if not scene[key].get("parent"):
            scene[key].setdefault("location", {}).setdefault("position", {"x": 0, "y": 0, "z": 0})["x"] += x
    folder = folder / "moved"
    path = folder / "models" / f"{name}_{x}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(scene, indent=1))
    shutil.copytree(RESOURCES / "meshes", folder / "meshes", dirs_exist_ok=True)
    return path


def everything(folder):
    """Arguments for a simulator with an object of each kind, among them those of `write`."""
    files = write(folder) + [moved(name, 6.0 + 5.0 * i, folder) for i, name in enumerate(("gripper", "cloth", "car"))]
    return ("-g", "0", "-t", "1", "--launch_file", RESOURCES / "launch.yaml", "-a", ",".join(map(str, files)))
