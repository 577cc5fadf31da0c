"""A scene as URDF: a robot for each body without a joint above it, with its frame at the origin of the world."""

from __future__ import annotations

from pathlib import Path
from typing import Dict, List, Tuple

import numpy as np
from scene import Body, Joint, Scene, Vector, roll_pitch_yaw, rotate, write_obj


def words(values: Vector) -> str:
    return " ".join(f"{value:.12g}" for value in values)


def frame_of(scene: Scene, name: str) -> np.ndarray:
    """Where the frame of a link is: it is not turned."""
    above = scene.joint_above(name)
    return np.asarray(above.anchor if above else (0.0, 0.0, 0.0), dtype=float)


def link(scene: Scene, body: Body, folder: Path, concave: str) -> str:
    frame, rpy = frame_of(scene, body.name), words(roll_pitch_yaw(body.rotation))
    text = f'<link name="{body.name}">'
    if body.mass > 0:
        xx, yy, zz = body.inertia
        text += f'<inertial><origin xyz="{words(body.position - frame)}" rpy="{rpy}"/><mass value="{body.mass}"/>'
        text += f'<inertia ixx="{xx}" ixy="0" ixz="0" iyy="{yy}" iyz="0" izz="{zz}"/></inertial>'
    for i, shape in enumerate(body.shapes):
        origin = body.position - frame + rotate(body.rotation, shape.position)
        if shape.kind == "box":
            geometry = f'<box size="{words(shape.size)}"/>'
        elif shape.kind == "sphere":
            geometry = f'<sphere radius="{shape.size[0]}"/>'
        elif shape.kind in ("capsule", "cylinder"):
            geometry = f'<{shape.kind} radius="{shape.size[0]}" length="{shape.size[1]}"/>'
        else:
            path = folder / f"{body.name} {i}.obj"
            write_obj(path, [shape])
            geometry = f'<mesh filename="{path}"/>'
        flag = concave if shape.kind == "mesh" else ""
        text += (
            f'<collision{flag}><origin xyz="{words(origin)}" rpy="{rpy}"/><geometry>{geometry}</geometry></collision>'
        )
    return text + "</link>"


def joint_element(scene: Scene, joint: Joint) -> str:
    origin = np.asarray(joint.anchor, dtype=float) - frame_of(scene, joint.parent)
    kind = "continuous" if joint.kind == "revolute" and joint.limits is None else joint.kind
    text = f'<joint name="{joint.name}" type="{kind}"><origin xyz="{words(origin)}"/><parent link="{joint.parent}"/>'
    text += f'<child link="{joint.child}"/><axis xyz="{words(joint.axis)}"/>'
    if joint.limits or joint.effort or joint.speed:
        low, high = joint.limits or (0, 0)
        text += f'<limit lower="{low}" upper="{high}" effort="{joint.effort or 0}" velocity="{joint.speed or 0}"/>'
    if joint.damping:
        text += f'<dynamics damping="{joint.damping}"/>'
    if joint.mimics:
        text += f'<mimic joint="{joint.mimics[0]}" multiplier="{joint.mimics[1]}"/>'
    return text + "</joint>"


def robots(scene: Scene, folder: Path, loops: bool = False, concave: str = "") -> Dict[str, Path]:
    """Writes the robots into a folder; returns the file of each root. With `loops` a frame with two parents closes a loop. `concave` is an
    attribute of collisions with meshes of triangles."""
    files: Dict[str, Path] = {}
    for root in scene.bodies:
        if scene.joint_above(root.name):
            continue
        names: List[str] = [root.name]
        for name in names:
            names += [joint.child for joint in scene.below(name)]
        text = f'<robot name="{root.name}">' + "".join(link(scene, scene.body(name), folder, concave) for name in names)
        for joint in (joint for joint in scene.joints if joint.parent in names):
            if not joint.closes_loop:
                text += joint_element(scene, joint)
            elif loops:
                at = np.asarray(joint.anchor, dtype=float) - frame_of(scene, joint.child)
                pin = f"{joint.name} frame"
                text += f'<link name="{pin}"/><joint name="{pin} joint" type="fixed"><origin xyz="{words(at)}"/>'
                text += f'<parent link="{joint.child}"/><child link="{pin}"/></joint>'
                closing = Joint(joint.name, joint.kind, joint.parent, pin, joint.anchor, joint.axis)
                text += joint_element(scene, closing)
        files[root.name] = folder / f"{root.name}.urdf"
        files[root.name].write_text(text + "</robot>\n")
    return files


def has_massless_links(scene: Scene) -> bool:
    return any(body.mass == 0 and scene.joint_above(body.name) for body in scene.bodies)


def place_of(scene: Scene, body: Body) -> Tuple[np.ndarray, Vector]:
    """Centre of mass and axes of a body in the frame of its link."""
    return np.asarray(body.position, dtype=float) - frame_of(scene, body.name), body.rotation
