"""Model files with one mistake each, and what the simulator has to say about it."""

import json

from scenes import NOWHERE, box, model


def hinge(parent, child, changes):
    """A revolute joint between two bodies."""
    joint = {
        "name": f"{parent}-{child}",
        "parent": parent,
        "child": child,
        "parent axis": {"x": 0.0, "y": 1.0, "z": 0.0},
        "parent pivot": NOWHERE,
        "child axis": {"x": 0.0, "y": 1.0, "z": 0.0},
        "child pivot": NOWHERE,
        "type": "revolute",
    }
    return {**joint, **changes}


def pair(name, **changes):
    """Two bodies and a joint between them that differs by `changes`."""
    first, second = f"BODY {name}A", f"BODY {name}B"
    bodies = {first: box(f"{name}A", 0.0, z=20.0), second: box(f"{name}B", 1.0, z=20.5)}
    return model(bodies, {f"JOINT {name}": hinge(first, second, changes)})


def single(name, **changes):
    """One body that differs by `changes`."""
    return model({f"BODY {name}": {**box(name, 1.0, z=30.0), **changes}})


def meshed(name, file):
    """One body that collides with a mesh."""
    body = {key: value for key, value in box(name, 1.0).items() if "shape" not in key and "geometry" not in key}
    return model({f"BODY {name}": {**body, "mesh": file}})


TWIN = json.dumps(single("Twin"))

# File → (content, words of which each is in the file's lines of the log).
FILES = {
    "wrong_type.yaml": (single("WrongType", mass="heavy"), ["mass", "heavy"]),
    "negative_mass.yaml": (single("NegativeMass", mass=-1.0), ["mass", "-1"]),
    "nan_mass.yaml": (single("NanMass", mass=".nan"), ["mass", ".nan"]),
    "nan_position.yaml": (
        single("NanPlace", location={"position": {"x": ".nan", "y": 0.0, "z": 0.0}}),
        ["position", ".nan"],
    ),
    "infinite_damping.yaml": (single("Damped", damping={"linear": ".inf", "angular": 0.0}), ["damping", ".inf"]),
    "missing_mesh.yaml": (meshed("MissingMesh", "nothere.STL"), ["nothere.STL"]),
    "garbage_mesh.yaml": (meshed("GarbageMesh", "garbage.STL"), ["garbage.STL"]),
    "empty_mesh.yaml": (meshed("EmptyMesh", "empty.OBJ"), ["empty.OBJ"]),
    "dangling_parent.yaml": (pair("Dangling", parent="BODY Nobody"), ["parent", "BODY Nobody", "not found"]),
    "own_parent.yaml": (pair("Selfish", parent="BODY SelfishB"), ["SelfishB", "itself"]),
    "zero_axis.yaml": (pair("ZeroAxis", **{"parent axis": NOWHERE}), ["parent axis"]),
    "nan_axis.yaml": (pair("NanAxis", **{"child axis": {"x": 0.0, "y": ".nan", "z": 0.0}}), ["child axis", ".nan"]),
    "unknown_joint.yaml": (pair("Odd", type="elastic"), ["elastic"]),
    "undefined_body.yaml": ({**single("Defined"), "bodies": ["BODY Defined", "BODY Undefined"]}, ["BODY Undefined"]),
    "wrong_rates.yaml": (single("Rates", **{"publish frequency": {"low": 900, "high": 100}}), ["900", "100"]),
    # The first of two equal keys counts.
    "same_key.yaml": (TWIN[:-1] + ', "BODY Twin": {"mass": "nonsense"}}', ["BODY Twin"]),
    "same_name.yaml": (
        model({f"BODY Same{i}": dict(box("Same", 1.0, x=3.0 * i, z=40.0)) for i in range(2)}),
        ["/ambf/env/Same"],
    ),
}


def write(folder):
    """Writes all files, and the meshes that some of them name."""
    folder.mkdir(parents=True)
    for name, (content, _) in FILES.items():
        text = content if isinstance(content, str) else json.dumps(content, indent=1)
        # JSON has no such numbers, YAML has.
        for number in (".nan", ".inf"):
            text = text.replace(f'"{number}"', number)
        (folder / name).write_text(text)
    (folder / "garbage.STL").write_bytes(bytes(range(256)) * 4)
    (folder / "empty.OBJ").write_text("")
