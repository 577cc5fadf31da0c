"""Pictures of one engine: pictures_engine.py ENGINE SCENE WIDTH HEIGHT SHADOW. `pictures.py` starts it.

ENGINE is ours, mujoco, tiny or egl (the two renderers of pybullet); SCENE is boxes, arm or cloth. Answers `KIND FRAMES` (KIND: color,
depth, ids, stereo) with the milliseconds of each frame; `check FILE` writes the depth of the scene as it starts (NumPy, m along the axis);
before that it says `ready SECONDS MIB`. What moves is stepped by 5 ms before each frame, which is not timed: no engine may reuse what it
drew. All draw the same bodies by one light with a shadow map of 1024 texels squared, or none, without anti-aliasing. A kind holds colour;
depth adds depth to it, ids adds ids to both, stereo is colour and depth for two eyes.
"""

from __future__ import annotations

import math
import os
import random
import resource
import sys
import tempfile
import time
from pathlib import Path

# The answers own standard output; engines print to it as they like.
ANSWERS = os.fdopen(os.dup(1), "w", buffering=1)
os.dup2(2, 1)

EYE, TARGET, FIELD, NEAR, FAR = (2.5, -2.0, 1.6), (0.0, 0.0, 0.3), 0.8, 0.05, 20.0
LIGHT, LIGHT_ANGLE = (2.0, 1.0, 4.0), 1.0
SEPARATION, FOCAL = 0.06, 3.0
MESHES = Path(__file__).resolve().parents[2] / "resources/meshes/arm7"
# Pose of each link of the arm at home: height along a line, turned about y.
LINKS = {
    "base": (0.0, 0.0, 0.1, 0.0),
    "shoulder": (0.0, 0.0, 0.275, 0.0),
    "upper_arm": (0.029552021, 0.0, 0.445533649, 0.3),
    "elbow": (0.088656062, 0.0, 0.636600947, 0.3),
    "forearm": (0.217374564, 0.0, 0.719250146, 1.7),
    "wrist": (0.415707526, 0.0, 0.693481247, 1.7),
    "hand": (0.514874007, 0.0, 0.640596798, math.pi),
    "flange": (0.514874007, 0.0, 0.560596798, math.pi),
}
CLOTH = 20


def boxes(scene: str) -> list[tuple[tuple[float, float, float], float, tuple[float, float, float]]]:
    """Place, edge and colour of the boxes that fall."""
    draw = random.Random(7)
    count = 200 if scene == "boxes" else 1
    made = []
    for i in range(count):
        place = (0.18 * (i % 10 - 4.5), 0.18 * (i // 10 % 10 - 4.5), 0.15 + 0.25 * (i // 100))
        if count == 1:
            place = (0.3, 0.4, 0.8)
        made.append((place, draw.uniform(0.06, 0.12), tuple(draw.uniform(0.2, 1.0) for _ in range(3))))
    return made


class Ours:
    """This project, in this process."""

    def __init__(self, scene: str, width: int, height: int, shadow: bool) -> None:
        import ambf

        folder = Path(tempfile.mkdtemp())
        vector = "{{x: {}, y: {}, z: {}}}".format
        direction = vector(*(t - s for t, s in zip(TARGET, LIGHT)))
        camera = (
            f"  location: {vector(*EYE)}\n  look at: {vector(*TARGET)}\n  up: {{x: 0, y: 0, z: 1}}\n"
            f"  clipping plane: {{near: {NEAR}, far: {FAR}}}\n  field view angle: {FIELD}\n"
        )
        (folder / "world.yaml").write_text(
            "namespace: /bench/\ngravity: {x: 0, y: 0, z: -9.81}\nlights: [light]\ncameras: [one, two]\n"
            f"light:\n  name: light\n  location: {vector(*LIGHT)}\n  direction: {direction}\n  spot exponent: 0\n"
            f"  cutoff angle: {LIGHT_ANGLE}\n  shadow quality: {3 if shadow else 0}\n"
            f"one:\n  name: one\n{camera}two:\n  name: two\n{camera}"
            f"  stereo: {{mode: passive, eye separation: {SEPARATION}, focal length: {FOCAL}}}\n"
        )
        bodies = {
            "Ground": (
                "mass: 0",
                (0, 0, -0.05),
                "shape: Box\n  geometry: {x: 8, y: 8, z: 0.1}\n  collision shape: Box\n"
                "  collision geometry: {x: 8, y: 8, z: 0.1}\n  color rgba: {r: 0.6, g: 0.6, b: 0.6, a: 1}",
            )
        }
        for i, (place, edge, (r, g, b)) in enumerate(boxes(scene)):
            size = f"{{x: {edge}, y: {edge}, z: {edge}}}"
            bodies[f"Box{i}"] = (
                "mass: 0.5",
                place,
                f"shape: Box\n  geometry: {size}\n  collision shape: Box\n"
                f"  collision geometry: {size}\n  color rgba: {{r: {r}, g: {g}, b: {b}, a: 1}}",
            )
        text = ""
        if scene == "arm":
            for name, (x, y, z, pitch) in LINKS.items():
                text += (
                    f"BODY {name}:\n  name: {name}\n  mass: 0\n  mesh: {name}.obj\n  collision mesh type: CONVEX_HULL\n"
                    f"  location: {{position: {vector(x, y, z)}, orientation: {{r: 0, p: {pitch}, y: 0}}}}\n"
                )
        for name, (mass, place, look) in bodies.items():
            text += f"BODY {name}:\n  name: {name}\n  {mass}\n  location: {{position: {vector(*place)}}}\n  {look}\n"
        names = [f"BODY {name}" for name in (list(LINKS) if scene == "arm" else []) + list(bodies)]
        soft = ""
        if scene == "cloth":
            grid(folder / "cloth.obj")
            soft = "soft bodies: [SOFT BODY cloth]\n"
            text += (
                "SOFT BODY cloth:\n  name: cloth\n  mesh: cloth.obj\n  mass: 0.5\n  location: {position: {x: 0, y: 0, z: 0.6}}\n"
                "  color rgba: {r: 0.2, g: 0.4, b: 0.9, a: 1}\n  config: {kLST: 0.5, kAST: 0.5, kVST: 0.5, piterations: 4}\n"
            )
        (folder / "model.yaml").write_text(
            f"namespace: /bench/\nhigh resolution path: {MESHES if scene == 'arm' else folder}/\n"
            f"low resolution path: {MESHES if scene == 'arm' else folder}/\nbodies: [{', '.join(names)}]\n{soft}joints: []\n{text}"
        )
        self.sim = ambf.Simulation([folder / "model.yaml"], world=folder / "world.yaml")
        self.size = {"width": width, "height": height}

    def step(self) -> None:
        self.sim.step(5)

    def frame(self, kind: str):
        """All that the kind asks for, as arrays."""
        if kind == "stereo":
            return self.sim.render("two", width=2 * self.size["width"], height=self.size["height"], depth=True)
        return self.sim.render("one", **self.size, depth=kind != "color", ids=kind == "ids")

    def depth(self):
        """m along the axis."""
        return self.sim.render("one", **self.size, rgb=False, depth=True)


class MuJoCo:
    """MuJoCo's renderer of the Python package, EGL."""

    def __init__(self, scene: str, width: int, height: int, shadow: bool) -> None:
        os.environ["MUJOCO_GL"] = "egl"
        import mujoco

        def numbers(values):
            return " ".join(str(value) for value in values)

        axis = [t - s for t, s in zip(TARGET, LIGHT)]
        back = [e - t for e, t in zip(EYE, TARGET)]
        length = math.sqrt(sum(x * x for x in back))
        back = [x / length for x in back]
        right = [-back[1], back[0], 0.0]
        length = math.hypot(*right)
        right = [x / length for x in right]
        up = [
            back[1] * right[2] - back[2] * right[1],
            back[2] * right[0] - back[0] * right[2],
            back[0] * right[1] - back[1] * right[0],
        ]
        body = '<geom type="box" size="4 4 0.05" pos="0 0 -0.05" rgba="0.6 0.6 0.6 1"/>'
        assets = ""
        for place, edge, color in boxes(scene):
            body += (
                f'<body pos="{numbers(place)}"><freejoint/><geom type="box" size="{numbers([edge / 2] * 3)}" mass="0.5" '
                f'rgba="{numbers(color)} 1"/></body>'
            )
        if scene == "arm":
            for name, (x, y, z, pitch) in LINKS.items():
                assets += f'<mesh name="{name}" file="{MESHES / name}.obj"/>'
                # MuJoCo centres meshes; a body without a geom's offset would move them.
                body += (
                    f'<body pos="{x} {y} {z}" euler="0 {pitch} 0"><geom type="mesh" mesh="{name}" rgba="0.9 0.9 0.85 1" '
                    f'contype="0" conaffinity="0"/></body>'
                )
        if scene == "cloth":
            body += (
                f'<flexcomp type="grid" count="{CLOTH + 1} {CLOTH + 1} 1" spacing="{1 / CLOTH} {1 / CLOTH} 0.1" pos="0 0 0.6" '
                f'radius="0.002" name="cloth" dim="2" mass="0.5" rgba="0.2 0.4 0.9 1"><edge equality="true"/></flexcomp>'
            )
        self.model = mujoco.MjModel.from_xml_string(
            f"""<mujoco><compiler angle="radian"/><option timestep="0.005"/>
            <visual><global offwidth="{2 * width}" offheight="{height}"/>
            <quality shadowsize="1024" offsamples="0"/><map znear="{NEAR}" zfar="{FAR}"/>
            <headlight active="0"/></visual><statistic extent="1" center="0 0 0"/><asset>{assets}</asset>
            <worldbody><light pos="{numbers(LIGHT)}" dir="{numbers(axis)}" cutoff="{math.degrees(LIGHT_ANGLE)}" exponent="0"
            castshadow="{str(shadow).lower()}"/>
            <camera name="one" fovy="{math.degrees(FIELD)}" pos="{numbers(EYE)}" xyaxes="{numbers(right)} {numbers(up)}"/>
            {body}</worldbody></mujoco>"""
        )
        self.mujoco, self.data = mujoco, mujoco.MjData(self.model)
        self.renderer = mujoco.Renderer(self.model, height, width)
        self.renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadow
        self.renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        mujoco.mj_forward(self.model, self.data)

    def step(self) -> None:
        self.mujoco.mj_step(self.model, self.data)

    def frame(self, kind: str):
        """All that the kind asks for, as arrays."""
        parts = []
        for _ in range(2 if kind == "stereo" else 1):
            self.renderer.update_scene(self.data, "one")
            parts.append(self.renderer.render())
            if kind != "color":
                parts.append(self.depth(update=False))
            if kind == "ids":
                self.renderer.enable_segmentation_rendering()
                parts.append(self.renderer.render())
                self.renderer.disable_segmentation_rendering()
        return parts

    def depth(self, update: bool = True):
        """m along the axis."""
        if update:
            self.renderer.update_scene(self.data, "one")
        self.renderer.enable_depth_rendering()
        depth = self.renderer.render()
        self.renderer.disable_depth_rendering()
        return depth


class PyBullet:
    """pybullet's renderers."""

    def __init__(self, scene: str, width: int, height: int, shadow: bool, hardware: bool) -> None:
        import pybullet

        if scene == "cloth":
            raise SystemExit("pybullet's renderers do not draw soft bodies")
        self.p, self.size, self.shadow = pybullet, (width, height), shadow
        pybullet.connect(pybullet.DIRECT)
        self.renderer = pybullet.ER_TINY_RENDERER
        if hardware:
            import importlib.util

            found = importlib.util.find_spec("eglRenderer")
            if found is None or pybullet.loadPlugin(found.origin, "_eglRendererPlugin") < 0:
                raise SystemExit("pybullet has no EGL renderer here")
            self.renderer = pybullet.ER_BULLET_HARDWARE_OPENGL
        pybullet.setGravity(0, 0, -9.81)
        pybullet.setTimeStep(0.005)

        def box(half, color):
            return (
                pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half),
                pybullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=half, rgbaColor=[*color, 1]),
            )

        pybullet.createMultiBody(0, *box([4, 4, 0.05], (0.6, 0.6, 0.6)), [0, 0, -0.05])
        for place, edge, color in boxes(scene):
            pybullet.createMultiBody(0.5, *box([edge / 2] * 3, color), place)
        if scene == "arm":
            for name, (x, y, z, pitch) in LINKS.items():
                visual = pybullet.createVisualShape(pybullet.GEOM_MESH, fileName=str(MESHES / name) + ".obj")
                pybullet.createMultiBody(0, -1, visual, [x, y, z], pybullet.getQuaternionFromEuler([0, pitch, 0]))
        self.view = pybullet.computeViewMatrix(EYE, TARGET, (0, 0, 1))
        self.projection = pybullet.computeProjectionMatrixFOV(math.degrees(FIELD), width / height, NEAR, FAR)
        if hardware and shadow:
            pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_SHADOWS, 1)

    def step(self) -> None:
        self.p.stepSimulation()

    def frame(self, kind: str):
        """All that the kind asks for, as arrays; depth always comes with the colours."""
        flags = 0 if kind == "ids" else self.p.ER_NO_SEGMENTATION_MASK
        return [
            self.p.getCameraImage(
                *self.size,
                self.view,
                self.projection,
                LIGHT,
                shadow=int(self.shadow),
                renderer=self.renderer,
                flags=flags,
            )
            for _ in range(2 if kind == "stereo" else 1)
        ]

    def depth(self):
        """m along the axis."""
        import numpy

        buffer = numpy.array(self.frame("depth")[0][3]).reshape(self.size[1], self.size[0])
        return FAR * NEAR / (FAR - (FAR - NEAR) * buffer)


def grid(path: Path) -> None:
    """A square of 1 m of CLOTH x CLOTH cells."""
    lines = [f"v {i / CLOTH - 0.5} {j / CLOTH - 0.5} 0" for j in range(CLOTH + 1) for i in range(CLOTH + 1)]
    for j in range(CLOTH):
        for i in range(CLOTH):
            a = j * (CLOTH + 1) + i + 1
            lines += [f"f {a} {a + 1} {a + CLOTH + 2}", f"f {a} {a + CLOTH + 2} {a + CLOTH + 1}"]
    path.write_text("\n".join(lines) + "\n")


def main() -> None:
    """Answers until there are no more lines."""
    engine, scene, width, height, shadow = (
        sys.argv[1],
        sys.argv[2],
        int(sys.argv[3]),
        int(sys.argv[4]),
        sys.argv[5] == "1",
    )
    begin = time.perf_counter()
    if engine == "ours":
        made = Ours(scene, width, height, shadow)
    elif engine == "mujoco":
        made = MuJoCo(scene, width, height, shadow)
    else:
        made = PyBullet(scene, width, height, shadow, hardware=engine == "egl")
    made.frame("color")
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print("ready", round(time.perf_counter() - begin, 3), round(memory), file=ANSWERS)
    for line in sys.stdin:
        kind, argument = line.split()
        if kind == "check":
            import numpy

            numpy.save(argument, numpy.asarray(made.depth(), dtype=numpy.float32))
            print("ok", file=ANSWERS)
            continue
        times = []
        for _ in range(int(argument)):
            made.step()
            begin = time.perf_counter()
            made.frame(kind)
            times.append(1e3 * (time.perf_counter() - begin))
        print(*(f"{time:.3f}" for time in times), file=ANSWERS)


if __name__ == "__main__":
    main()
