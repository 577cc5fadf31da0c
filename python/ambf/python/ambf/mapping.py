"""Mappings: what a data set holds of each moment of a recording. See docs/recordings.md."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import ArrayLike

from .errors import ExportError, NotFoundError, TreeError
from .names import find
from .recording import Recording
from .scenes import resources
from .simulation import Array, Simulation
from .tree import Tree

Read = Callable[[Recording], Sequence[float]]
"""Numbers of the present moment of a replay."""
Place = Callable[[Recording], Array]
"""A pose of the present moment, world: (7) position, m, and quaternion x, y, z, w."""
Note = Tuple[float, str]
"""Simulated time, s, and a text."""

_KEYS = ("rate", "robot type", "task", "begin", "features", "texts", "images")
_AXES = {3: ("x", "y", "z"), 4: ("x", "y", "z", "w"), 6: ("fx", "fy", "fz", "tx", "ty", "tz")}
_TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
_KEYS_OF = {
    "joint position": ("offset",),
    "joint velocity": ("offset",),
    "joint effort": ("offset",),
    "joint target": ("offset",),
    "joint wrench": (),
    "twist": ("in",),
    "note": ("count",),
    "position": ("in", "offset"),
    "orientation": ("in", "offset"),
    "target position": ("in", "offset"),
    "target orientation": ("in", "offset"),
}
"""Keys that an entry of each quantity may have beside `from`, `of` and `name`."""
_IDENTITY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


@dataclass
class Column:
    """Numbers that are written side by side."""

    names: List[str]
    read: Read


@dataclass
class Picture:
    """Pictures of a camera of the scene, or of one that only the data set has."""

    camera: Optional[str]
    """Camera of the scene; None: the first."""
    width: int
    height: int
    parent: Optional[str] = None
    """Body to which a camera of the data set alone is fixed; None: the picture is taken from where `camera` is."""
    offset: Array = field(default_factory=_IDENTITY.copy)
    """(7) the camera's frame in that of the parent: it looks along -x, +z is up in the picture."""
    field_view_angle: Optional[float] = None
    """Vertical, rad; None: that of `camera`."""

    def viewpoint(self, name: str, simulation: Simulation) -> Optional[Place]:
        """Where it is taken from; None: from the camera. Raises ExportError."""
        if self.parent is None:
            return None
        place = place_of(simulation, self.parent, f"mapping, `images / {name}`")
        return lambda recording: compose(place(recording), self.offset)


@dataclass
class MappingOf:
    """What is written of each moment."""

    rate: float = 30.0
    robot_type: str = "ambf"
    task: str = "simulated"
    begin: str = ""
    """Name of a note, what stands before its colon: frames begin with the first of it. Empty: with the recording."""
    features: Dict[str, List[Dict[str, Any]]] = field(default_factory=dict)
    """Entries of `observation.state`, `action` and others, as they stand in the file; empty: all joints."""
    texts: Dict[str, str] = field(default_factory=dict)
    """Features that are the same text in each frame."""
    images: Dict[str, Picture] = field(default_factory=dict)

    @classmethod
    def load(cls, path: Optional[str]) -> MappingOf:
        """Reads a mapping: a file, or one of `shipped` by its name. None: joint positions of all joints, and the positions that they were
        commanded to. Raises ExportError.
        """
        if path is None:
            return cls()
        try:
            import yaml
        except ImportError as error:
            raise ExportError("a mapping needs the package PyYAML: pip install pyyaml") from error
        path = _file_of(path)
        try:
            with open(path, encoding="utf-8") as file:
                read = yaml.safe_load(file)
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise ExportError(f"{path}: {error}") from error
        if not isinstance(read, dict):
            raise ExportError(f"{path}: expected keys such as `rate` and `features`")
        _check_keys(path, read, _KEYS)
        made = cls()
        rate = read.get("rate", made.rate)
        if not isinstance(rate, (int, float)) or not 0 < rate <= 10_000:
            raise ExportError(f"{path}: `rate`: {rate!r}; expected a frequency above 0, Hz")
        made.rate = float(rate)
        made.robot_type = str(read.get("robot type", made.robot_type))
        made.task = str(read.get("task", made.task))
        made.begin = str(read.get("begin", made.begin))
        features = read.get("features", {})
        if not isinstance(features, dict) or not all(isinstance(entries, list) for entries in features.values()):
            raise ExportError(f"{path}: `features`: expected names, each with a list of entries")
        made.features = {str(name): entries for name, entries in features.items()}
        texts = read.get("texts", {})
        if not isinstance(texts, dict) or not all(isinstance(text, str) for text in texts.values()):
            raise ExportError(f"{path}: `texts`: expected names, each with a text")
        made.texts = {str(name): text for name, text in texts.items()}
        images = read.get("images", {})
        if not isinstance(images, dict):
            raise ExportError(f"{path}: `images`: expected names, each with a camera")
        made.images = {str(name): _picture(f"{path}: `images / {name}`", image) for name, image in images.items()}
        return made

    def columns(self, simulation: Simulation, notes: Sequence[Note] = ()) -> Dict[str, List[Column]]:
        """What it means in a scene, and for a recording with these notes, in order. Raises ExportError."""
        if self.features:
            return {
                name: [_column(simulation, name, entry, notes) for entry in entries]
                for name, entries in self.features.items()
            }
        names = joint_names(simulation)
        short = [
            name.rsplit("/", 2 if simulation.joints.count(joint) > 1 else 1)
            for name, joint in zip(names, simulation.joints)
        ]
        joints = [
            (full, "/".join(parts[1:]) or full)
            for full, parts, kind in zip(names, short, simulation.joint_types)
            if kind in ("revolute", "prismatic")
        ]
        of = [("observation.state", "joint position"), ("action", "joint target")]
        return {
            feature: [
                _column(simulation, feature, {"from": what, "of": full, "name": name}, ()) for full, name in joints
            ]
            for feature, what in of
        }


def joint_names(simulation: Simulation) -> List[str]:
    """Names of joints with the name space of the body that they are below, which tells those of several models of one kind apart."""
    names = list(simulation.joints)
    for row, body in enumerate(simulation.bodies):
        below = simulation.body(row)
        for name, index in zip(below.joints, below.joint_indices):
            names[index] = f"{body.rsplit('/', 1)[0]}/{name}"
    return names


def shipped() -> Dict[str, Path]:
    """The mappings that are used by a name."""
    try:
        return {path.stem: path for path in sorted((resources() / "mappings").glob("*.yaml"))}
    except NotFoundError:
        return {}


def _file_of(path: str) -> str:
    """A file by its path, else one of the shipped ones by its name."""
    known = shipped()
    if Path(path).exists() or path not in known:
        if Path(path).suffix == "" and not Path(path).exists():
            raise ExportError(
                f"mapping {path}: there is no such file, and it is none of {', '.join(known) or 'the shipped'}"
            )
        return path
    return str(known[path])


def _check_keys(where: str, read: Mapping[Any, Any], known: Sequence[str]) -> None:
    unknown = sorted(str(key) for key in set(read) - set(known))
    if unknown:
        raise ExportError(f"{where}: unknown key `{unknown[0]}`; expected {', '.join(known)}")


def _three(where: str, read: Mapping[Any, Any], key: str, default: ArrayLike) -> Array:
    """Numbers x, y, z."""
    numbers = read.get(key, dict(zip("xyz", np.asarray(default).tolist())))
    if not isinstance(numbers, dict) or set(numbers) != set("xyz") or not _are_numbers(numbers.values()):
        raise ExportError(f"{where}: `{key}`: {numbers!r}; expected {{x: NUMBER, y: NUMBER, z: NUMBER}}")
    return np.array([float(numbers[axis]) for axis in "xyz"])


def _are_numbers(values: Any) -> bool:
    return all(isinstance(value, (int, float)) and math.isfinite(value) for value in values)


def _picture(where: str, image: Any) -> Picture:
    """An entry of `images`."""
    keys = ("camera", "width", "height", "parent", "location", "look at", "up", "field view angle")
    if not isinstance(image, dict) or not {"camera", "parent"} & set(image):
        raise ExportError(f"{where}: expected {{camera: NAME, width: PIXELS, height: PIXELS}}, or a parent: NAME")
    _check_keys(where, image, keys)
    width, height = image.get("width", 640), image.get("height", 480)
    if not all(isinstance(pixels, int) and 2 <= pixels <= 16384 and pixels % 2 == 0 for pixels in (width, height)):
        raise ExportError(f"{where}: width and height must be even numbers of pixels, 2 to 16384")
    angle = image.get("field view angle")
    if angle is not None and not (isinstance(angle, (int, float)) and 0.0 < angle < math.pi):
        raise ExportError(f"{where}: `field view angle`: {angle!r}; expected an angle above 0 and below pi, rad")
    camera, parent = (None if image.get(key) is None else str(image[key]) for key in ("camera", "parent"))
    if parent is None:
        misplaced = [key for key in ("location", "look at", "up") if key in image]
        if misplaced:
            raise ExportError(f"{where}: `{misplaced[0]}` is of a camera with a parent: {{parent: NAME}}")
        return Picture(camera, width, height, field_view_angle=angle)
    location = _three(where, image, "location", (0.0, 0.0, 0.0))
    forward = _three(where, image, "look at", location - [1.0, 0.0, 0.0]) - location
    up = _three(where, image, "up", (0.0, 0.0, 1.0))
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9 * np.linalg.norm(forward) * np.linalg.norm(up) or not forward.any():
        raise ExportError(f"{where}: `look at` must be away from `location`, and `up` across that direction")
    x, y = -forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    rotation = quaternion_of(np.column_stack((x, y, np.cross(x, y))))
    return Picture(camera, width, height, parent=parent, offset=np.append(location, rotation), field_view_angle=angle)


def _column(simulation: Simulation, feature: str, entry: Any, notes: Sequence[Note]) -> Column:
    """The numbers that an entry of a mapping asks for; `notes` in order."""
    where = f"mapping, `features / {feature}`"
    if not isinstance(entry, dict) or "from" not in entry:
        raise ExportError(f"{where}: expected {{from: QUANTITY, of: NAME}}, not {entry!r}")
    what, of = str(entry["from"]), entry.get("of", "")
    if what not in _KEYS_OF:
        raise ExportError(f"{where}: `from: {what}` is not known; expected one of {', '.join(_KEYS_OF)}")
    _check_keys(f"{where}, `from: {what}`", entry, ("from", "of", "name", *_KEYS_OF[what]))
    joints: Dict[str, Callable[[Recording], Array]] = {
        "joint position": lambda r: r.simulation.joint_positions,
        "joint velocity": lambda r: r.simulation.joint_velocities,
        "joint effort": lambda r: r.simulation.joint_efforts,
        "joint target": lambda r: np.where(np.isnan(r.joint_targets), r.simulation.joint_positions, r.joint_targets),
    }
    if what in joints:
        # Of several joints the mean: the angle of jaws whose fingers turn apart.
        listed = of if isinstance(of, list) else [of]
        if not listed:
            raise ExportError(f"{where}: `of` is an empty list; expected a joint or several")
        places, read = [_joint(simulation, where, str(name)) for name in listed], joints[what]
        offset = entry.get("offset", 0.0)
        if not _are_numbers([offset]):
            raise ExportError(f"{where}: `offset`: {offset!r}; expected a number")
        name = str(entry.get("name", "+".join(map(str, listed))))
        return Column([name], lambda r: [float(np.mean(read(r)[places])) + offset])
    name = str(entry.get("name", of))
    if what == "joint wrench":
        place = _joint(simulation, where, str(of))
        names = [f"{name}.{axis}" for axis in _AXES[6]]
        return Column(names, lambda r: [float(number) for number in r.simulation.joint_wrenches[place]])
    if what == "note":
        count = entry.get("count", 1)
        if not isinstance(count, int) or not 1 <= count <= 1000:
            raise ExportError(f"{where}: `count`: {count!r}; expected how many numbers the note has")
        names = [name] if count == 1 else [f"{name}.{index}" for index in range(count)]
        return Column(names, lambda r: _noted(r, notes, str(of), count, where))
    if what == "twist":
        twist, axes = _twist_of(simulation, str(of), where), _frame(simulation, where, entry.get("in"))

        def turned(recording: Recording) -> List[float]:
            velocities, rotation = twist(recording), axes(recording, _IDENTITY)[3:]
            return [float(n) for half in (velocities[:3], velocities[3:]) for n in _rotate(rotation, half)]

        return Column([f"{name}.twist.{axis}" for axis in _TWIST], turned)
    part = slice(0, 3) if what.endswith("position") else slice(3, 7)
    body = target_of(simulation, str(of), where) if what.startswith("target ") else place_of(simulation, str(of), where)
    fixed, frame = _offset(where, entry), _frame(simulation, where, entry.get("in"))
    names = [f"{name}.{what.removeprefix('target ')}.{axis}" for axis in _AXES[part.stop - part.start]]
    return Column(names, lambda r: [float(number) for number in frame(r, compose(body(r), fixed))[part]])


def _noted(recording: Recording, notes: Sequence[Note], name: str, count: int, where: str) -> List[float]:
    """The numbers of the newest note of that name: `goal: 0.1 0.2 0.3`. Raises ExportError."""
    now = recording.simulation.sim_time + 1e-9
    texts = [text.split(":", 1)[1] for time, text in notes if time <= now and text.startswith(f"{name}:")]
    try:
        numbers = [float(word) for word in texts[-1].replace(",", " ").split()] if texts else []
    except ValueError as error:
        raise ExportError(f"{recording.path}: note `{name}:{texts[-1]}`: {error}") from error
    if len(numbers) != count:
        raise ExportError(
            f"{recording.path}: {where}: at {now:.3f} s the newest note `{name}` has {len(numbers)} numbers; expected {count}"
        )
    return numbers


def _offset(where: str, entry: Mapping[Any, Any]) -> Array:
    """(7) a frame that is fixed to a body: `offset: {position, rpy}` as those of tools of CRTK arms."""
    offset = entry.get("offset", {})
    if not isinstance(offset, dict):
        raise ExportError(f"{where}: `offset`: {offset!r}; expected {{position: [x, y, z], rpy: [r, p, y]}}")
    _check_keys(f"{where}, `offset`", offset, ("position", "rpy"))
    made = {}
    for key in ("position", "rpy"):
        numbers = offset.get(key, [0.0, 0.0, 0.0])
        if not isinstance(numbers, list) or len(numbers) != 3 or not _are_numbers(numbers):
            raise ExportError(f"{where}: `offset / {key}`: {numbers!r}; expected three numbers")
        made[key] = [float(number) for number in numbers]
    rotation = _IDENTITY[3:]
    # About the fixed axes x, y, z one after the other: the last is applied first here.
    for axis, angle in reversed(list(enumerate(made["rpy"]))):
        about = np.zeros(4)
        about[axis], about[3] = math.sin(angle / 2.0), math.cos(angle / 2.0)
        rotation = _multiply(rotation, about)
    return np.append(made["position"], rotation)


def _joint(simulation: Simulation, where: str, name: str) -> int:
    """The row of a joint."""
    try:
        return find(name, joint_names(simulation), "joints")
    except (LookupError, IndexError) as error:
        raise ExportError(f"{where}: {error}") from error


def _body(simulation: Simulation, name: str, where: str) -> Tuple[str, Optional[int]]:
    """A body: its name, and its row in the arrays; None: it has none, because it is passive."""
    # In one list: the whole name of one is not taken for a part of another's.
    names = [*simulation.bodies, *simulation.passive_bodies]
    try:
        index = find(name, names, "bodies")
    except (LookupError, IndexError) as error:
        raise ExportError(f"{where}: {error}") from error
    return names[index], index if index < len(simulation.bodies) else None


def place_of(simulation: Simulation, name: str, where: str) -> Place:
    """Where a body is. Raises ExportError."""
    full, row = _body(simulation, name, where)
    if row is None:
        return lambda r: r.simulation.passive_body(full).pose
    return lambda r: r.simulation.poses[row]


def _twist_of(simulation: Simulation, name: str, where: str) -> Callable[[Recording], Array]:
    full, row = _body(simulation, name, where)
    if row is None:
        return lambda r: r.simulation.passive_body(full).twist
    return lambda r: r.simulation.twists[row]


def target_of(simulation: Simulation, name: str, where: str) -> Place:
    """Where a body was commanded to be: by its own pose, else by the positions of the joints of its tree, by forward kinematics with the
    present ones of those that were not commanded. Where nothing was, it is where it is. Raises ExportError.
    """
    full, row = _body(simulation, name, where)
    here = place_of(simulation, name, where)
    trees: Dict[int, Optional[Tuple[Simulation, Tree]]] = {}

    def tree_of(moved: Simulation) -> Optional[Tree]:
        """The tree of the body; each replay has a simulation of its own. None: of joints that close loops there is none."""
        if id(moved) not in trees:
            trees.clear()
            found = None
            for start in moved.bodies if row is None else [full]:
                try:
                    tree = moved.tree(start)
                except TreeError:
                    continue
                if full in tree.bodies:
                    found = moved, tree
                    break
            trees[id(moved)] = found
        kept = trees[id(moved)]
        return None if kept is None else kept[1]

    def target(recording: Recording) -> Array:
        if row is not None and not np.isnan(recording.target_poses[row]).any():
            pose: Array = recording.target_poses[row]
            return pose
        tree = tree_of(recording.simulation)
        if tree is None:
            return here(recording)
        targets = recording.joint_targets[tree.joint_indices]
        if np.isnan(targets).all():
            return here(recording)
        wanted = np.where(np.isnan(targets), tree.joint_positions, targets)
        reached: Array = tree.poses(joint_positions=wanted)[tree.bodies.index(full)]
        return reached

    return target


def _frame(simulation: Simulation, where: str, name: Any) -> Callable[[Recording, Array], Array]:
    """Poses in the frame of a body or a camera; None: in the world."""
    if name is None or name == "world":
        return lambda _, pose: pose
    bodies = [*simulation.bodies, *simulation.passive_bodies]
    names = [*bodies, *simulation.cameras]
    try:
        index = find(str(name), names, "bodies and cameras")
    except (LookupError, IndexError) as error:
        raise ExportError(f"{where}: `in: {name}`: {error}") from error
    if index >= len(bodies):
        camera = index - len(bodies)
        return lambda r, pose: relative(r.simulation.camera_pose(camera), pose)
    place = place_of(simulation, bodies[index], where)
    return lambda r, pose: relative(place(r), pose)


def relative(frame: Array, pose: Array) -> Array:
    """A pose (position, m, and quaternion x, y, z, w) in another one's frame: its inverse times the pose."""
    inverse = np.array([-frame[3], -frame[4], -frame[5], frame[6]])
    position = _rotate(inverse, pose[:3] - frame[:3])
    return np.concatenate([position, _multiply(inverse, pose[3:])])


def compose(frame: Array, pose: Array) -> Array:
    """A pose that is given in the frame `frame`, where that frame is given: `frame` times the pose."""
    return np.concatenate([frame[:3] + _rotate(frame[3:], pose[:3]), _multiply(frame[3:], pose[3:])])


def quaternion_of(axes: Array) -> Array:
    """(4) quaternion x, y, z, w of a (3 x 3) rotation matrix."""
    # The largest of the squares of the four numbers is well conditioned (Shepperd 1978).
    trace = float(np.trace(axes))
    squares = np.array([*(1.0 + 2.0 * np.diag(axes) - trace), 1.0 + trace])
    i = int(np.argmax(squares))
    a, b, c = axes[2, 1] - axes[1, 2], axes[0, 2] - axes[2, 0], axes[1, 0] - axes[0, 1]
    q = np.array([a, b, c, squares[3]]) if i == 3 else np.append(axes[:, i] + axes[i, :], (a, b, c)[i])
    if i != 3:
        q[i] = squares[i]
    quaternion: Array = q / np.linalg.norm(q)
    return quaternion


def _multiply(a: Array, b: Array) -> Array:
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.append(vector, a[3] * b[3] - a[:3] @ b[:3])


def _rotate(quaternion: Array, vector: Array) -> Array:
    twice = 2.0 * np.cross(quaternion[:3], vector)
    rotated: Array = vector + quaternion[3] * twice + np.cross(quaternion[:3], twice)
    return rotated
