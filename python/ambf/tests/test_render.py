"""Pictures without ROS and without X."""

import concurrent.futures
import gc
import multiprocessing
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import unittest

import ambf
import numpy as np
from display import Display

RESOURCES = pathlib.Path(__file__).resolve().parents[3] / "resources"
LAUNCH = RESOURCES / "launch.yaml"
ARM = RESOURCES / "models/arm7.yaml"

BOX = (
    "bodies: [BODY Box]\nBODY Box: {name: Box, mass: 1, collision shape: Box, collision geometry: {x: 0.4, y: 0.4, z: 0.4}, "
    "geometry: {x: 0.4, y: 0.4, z: 0.4}, shape: Box, color rgba: {r: 1, g: 0, b: 0, a: 1}}\n"
)
CAMERA = (
    "up: {x: 0, y: 0, z: 1}, clipping plane: {near: 0.1, far: 20}, field view angle: 0.8, publish image: true, "
    "publish image resolution: {width: 64, height: 48}"
)
WORLD = (
    "namespace: /w/\ngravity: {x: 0, y: 0, z: -10}\ncameras: [front, flat, two]\nlights: [sun]\n"
    f"front: {{namespace: cameras/, name: front, location: {{x: 2, y: 0, z: 0}}, look at: {{x: 0, y: 0, z: 0}}, {CAMERA}}}\n"
    f"flat: {{name: flat, location: {{x: 2, y: 0, z: 0}}, look at: {{x: 0, y: 0, z: 0}}, orthographic view width: 2, {CAMERA}}}\n"
    f"two: {{name: two, location: {{x: 2, y: 0.5, z: 1}}, look at: {{x: 0, y: 0, z: 0}}, "
    f"stereo: {{mode: PASSIVE, eye separation: 0.1, focal length: 2}}, {CAMERA}}}\n"
    "sun: {name: sun, location: {x: 3, y: 1, z: 3}, direction: {x: -1, y: -0.3, z: -1}}\n"
)


def simulation(box=BOX, world=WORLD, **options):
    """A red box of 0.4 m that falls, seen from x = 2 m."""
    with tempfile.TemporaryDirectory() as folder:
        files = pathlib.Path(folder) / "box.yaml", pathlib.Path(folder) / "world.yaml"
        files[0].write_text(box)
        files[1].write_text(world)
        return ambf.Simulation(files[0], world=files[1], **options)


def picture_of(count):
    """What a process of its own sees, as bytes."""
    sim = simulation()
    sim.step(count)
    return sim.render("front").tobytes()


class Pictures(unittest.TestCase):
    """What is in them."""

    def test_colors_cameras_and_lights_are_changed(self):
        """From the next picture on; a reset returns cameras and lights, not colours."""
        sim = simulation()
        first = sim.render("front", 64, 48)
        middle = first[24, 32].astype(int)
        self.assertGreater(middle[0], 2 * middle[1], "it is red")
        sim.set_parameters(colors={"Box": (0, 1, 0, 1)})
        green = sim.render("front", 64, 48)
        middle = green[24, 32].astype(int)
        self.assertGreater(middle[1], 2 * middle[0], "it is green")
        pose, sim_ids = sim.camera_pose("front"), sim.render("front", 64, 48, rgb=False, ids=True)
        sim.place_camera("front", (4, 0, 0, 0, 0, 0, 1))
        np.testing.assert_allclose(sim.camera_pose("front"), (4, 0, 0, 0, 0, 0, 1), atol=1e-12)
        far = sim.render("front", 64, 48, rgb=False, ids=True)
        size = (far == far[24, 32]).sum(), (sim_ids == sim_ids[24, 32]).sum()
        self.assertLess(2 * size[0], size[1], "twice as far away")
        self.assertEqual(sim.lights, ("sun",))
        lit = sim.render("front", 64, 48).astype(int)
        sim.place_light("sun", (-3, 0, -3, 0, 0, 0, 1))
        self.assertGreater(abs(sim.render("front", 64, 48).astype(int) - lit).max(), 10)
        sim.reset()
        np.testing.assert_allclose(sim.camera_pose("front"), pose, atol=1e-9)
        np.testing.assert_array_equal(sim.render("front", 64, 48), green)
        for call in (
            lambda: sim.place_camera("front", (1, 2, 3)),
            lambda: sim.place_camera("front", np.zeros(7)),
            lambda: sim.place_light("sun", (np.nan, 0, 0, 0, 0, 0, 1)),
        ):
            self.assertRaises(ValueError, call)
        self.assertRaises(ambf.NotFoundError, sim.place_light, "moon", pose)

    def test_all_that_can_be_asked_for(self):
        """Shapes, types, values of a box that is where it is known to be."""
        sim = simulation()
        self.assertEqual(sim.cameras, ("/w/cameras/front", "/w/flat", "/w/two"))
        rgb = sim.render()
        self.assertEqual((rgb.shape, rgb.dtype), ((48, 64, 3), np.uint8))
        found = sim.render("front", depth=True, ids=True, normals=True)
        self.assertEqual(list(found), ["rgb", "depth", "ids", "normals"])
        np.testing.assert_array_equal(found["rgb"], rgb)
        self.assertEqual(
            [found[name].dtype for name in ("depth", "ids", "normals")], [np.float32, np.int32, np.float32]
        )
        self.assertEqual([found[name].shape for name in ("depth", "ids", "normals")], [(48, 64)] * 2 + [(48, 64, 3)])
        box = found["ids"] == sim.id_names.index(sim.bodies[0])
        side = 24 / np.tan(0.4) * 0.4 / 1.8
        self.assertLess(abs(box.sum() - side**2), 2.1 * side)
        self.assertEqual(set(found["ids"][~box]), {0})
        np.testing.assert_allclose(found["depth"][box], 1.8, atol=1e-3)
        np.testing.assert_allclose(found["depth"][~box], 20.0, rtol=1e-4)
        # The face looks at the camera, which looks along -x.
        np.testing.assert_allclose(found["normals"][box], [[1, 0, 0]] * box.sum(), atol=1e-3)
        self.assertFalse(found["normals"][~box].any())
        red, green, blue = rgb[24, 32]
        self.assertGreater(int(red), 60)
        self.assertGreater(int(red), 2 * max(int(green), int(blue)))
        self.assertEqual(sim.render(rgb=False, depth=True).shape, (48, 64))
        self.assertEqual(sim.notices(), [])

    def test_pictures_that_are_held_stay_as_they_are(self):
        """Memory of pictures that nobody holds any more is used again, and only that."""
        sim = simulation()
        held, copies = [], []
        for count in range(6):
            found = sim.render("front", depth=True, ids=True)
            # A view of a part is enough to hold a picture.
            held.append((found["rgb"][10:40], found["depth"].T, found["ids"] if count % 2 else found["ids"][:, ::2]))
            copies.append([array.copy() for array in held[-1]])
            del found
            sim.step(20)
        for arrays, kept in zip(held, copies):
            for array, copy in zip(arrays, kept):
                np.testing.assert_array_equal(array, copy)
        addresses = set()
        for _ in range(8):
            addresses.add(sim.render("front").ctypes.data)
        self.assertLess(len(addresses), 3)
        # What Python makes of the memory of a picture changes nothing.
        picture = sim.render("front")
        below = picture.base
        before = picture.copy()
        below.dtype = np.uint16
        del picture, below
        np.testing.assert_array_equal(sim.render("front"), before)

    def test_sizes(self):
        """As given, as published, or of the published shape."""
        sim = simulation()
        self.assertEqual(sim.render(width=32, height=10).shape, (10, 32, 3))
        self.assertEqual(sim.render(width=32).shape, (24, 32, 3))
        self.assertEqual(sim.render(height=96).shape, (96, 128, 3))
        self.assertEqual(ambf.Simulation(ARM, launch_file=LAUNCH).render().shape, (480, 640, 3))
        self.assertFalse((sim.render("two", samples=4) == sim.render("two")).all())
        for options in (
            {"width": 0},
            {"height": -5},
            {"width": 20_000},
            {"samples": 0},
            {"samples": 9},
            {"rgb": False},
        ):
            with self.subTest(options), self.assertRaises(ValueError):
                sim.render(**options)
        with self.assertRaises(TypeError):
            sim.render(width="wide")

    def test_cameras_by_name(self):
        """By name, part of it, index; what is not there is told with what is."""
        sim = simulation()
        front = sim.render("/w/cameras/front")
        for name in ("front", "fro", 0, None):
            np.testing.assert_array_equal(sim.render(name), front)
        self.assertFalse((sim.render("two") == front).all())
        with self.assertRaisesRegex(ambf.NotFoundError, "`middle`; the scene has /w/cameras/front, /w/flat, /w/two"):
            sim.render("middle")
        with self.assertRaisesRegex(ambf.NotFoundError, "several cameras.*`f`"):
            sim.render("f")
        for name in (3, -1, ""):
            with self.assertRaises(ambf.NotFoundError):
                sim.render(name)

    def test_intrinsics_and_pose(self):
        """A point is seen where they say."""
        sim = simulation()
        matrix = sim.camera_matrix("front")
        focal = 24 / np.tan(0.4)
        np.testing.assert_allclose(matrix, [[focal, 0, 32], [0, focal, 24], [0, 0, 1]])
        np.testing.assert_allclose(sim.camera_matrix("front", width=640)[0, 0], 10 * focal)
        np.testing.assert_allclose(sim.camera_pose("front")[:3], [2, 0, 0])
        found = sim.render("front", depth=True, ids=True)
        rows, columns = np.nonzero(found["ids"])
        depth = found["depth"][rows, columns]
        rays = np.linalg.inv(matrix) @ np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))])
        right, down = rays[:2] * depth
        # World axes: the camera looks along -x, so right is +y.
        for along in (right, -down):
            self.assertLess(abs(along.min() + 0.2), 0.05)
            self.assertLess(abs(along.max() - 0.2), 0.05)
        for name in ("flat", "two"):
            with self.assertRaisesRegex(ValueError, f"{name} is no pinhole"):
                sim.camera_matrix(name)

    def test_pictures_show_the_states_of_the_arrays(self):
        """After steps, resets and restored states."""
        sim = simulation(saving=True)
        start = sim.render("front")
        state = sim.save()
        sim.step(200)
        fallen = sim.render("front")
        self.assertFalse((fallen == start).all())
        rows = np.nonzero(sim.render("front", rgb=False, ids=True))[0]
        expected = 24 - sim.body("Box").pose[2] * 24 / np.tan(0.4) / 1.8
        self.assertLess(abs(rows.mean() + 0.5 - expected), 0.7)
        sim.reset()
        np.testing.assert_array_equal(sim.render("front"), start)
        sim.step(50)
        sim.restore(state)
        np.testing.assert_array_equal(sim.render("front"), start)

    def test_soft_bodies_return_to_their_start(self):
        """Time and number of steps don't tell a reset."""
        sim = ambf.Simulation(RESOURCES / "models/cloth.yaml", launch_file=LAUNCH)
        sim.step(10)
        sim.reset()
        start = sim.render(width=160, height=120)
        sim.step(400)
        later = sim.render(width=160, height=120)
        self.assertFalse((later == start).all())
        sim.reset()
        np.testing.assert_array_equal(sim.render(width=160, height=120), start)

    def test_a_world_without_cameras(self):
        """Has the default one: at the origin, it looks along -x."""
        box = BOX.replace("mass: 1", "mass: 0, location: {position: {x: -1, y: 0, z: 0}}")
        sim = simulation(box, "namespace: /w/\n")
        self.assertEqual(sim.cameras, ("/w/default_camera",))
        depth = sim.render(width=20, height=10, rgb=False, depth=True)
        self.assertAlmostEqual(float(depth[5, 10]), 0.8, places=3)
        self.assertAlmostEqual(float(depth[0, 0]), 10.0, places=2)

    def test_motion_is_the_same_with_pictures(self):
        """To the last bit."""
        sims = [ambf.Simulation(ARM, launch_file=LAUNCH) for _ in range(2)]
        for _ in range(20):
            for sim in sims:
                sim.step(7)
            sims[0].render(width=32, height=24, depth=True, ids=True)
        self.assertEqual(sims[0].poses.tobytes(), sims[1].poses.tobytes())

    def test_what_can_not_be_drawn_is_told(self):
        """Once."""
        with tempfile.TemporaryDirectory() as folder:
            file = pathlib.Path(folder) / "m.yaml"
            file.write_text(
                "bodies: [BODY Box]\nBODY Box: {name: Box, mass: 1, mesh: no.OBJ, collision shape: Sphere, collision geometry: {radius: 1}}"
            )
            sim = ambf.Simulation(file)
        sim.render(width=8, height=8)
        told = [*sim.warnings, *sim.notices()]
        self.assertTrue(any("no.OBJ" in line for line in told), told)
        sim.render(width=8, height=8)
        self.assertEqual(sim.notices(), [])


class Windows(unittest.TestCase):
    """Of a process of their own each: a process enters the window system once."""

    def run_program(self, text, **environment):
        """Its lines."""
        command = [sys.executable, "-c", text, str(ARM), str(LAUNCH)]
        inside = {**os.environ, **environment}
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, env=inside)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout.splitlines()

    def test_without_a_display(self):
        """There is advice, and pictures are drawn all the same."""
        text = (
            "import ambf, sys\nsim = ambf.Simulation(sys.argv[1], launch_file=sys.argv[2])\n"
            "try:\n    sim.view()\nexcept ambf.RenderError as error:\n    print(error)\n"
            "print(sim.render(width=8, height=8).shape)\n"
        )
        lines = self.run_program(text, DISPLAY="", WAYLAND_DISPLAY="")
        self.assertRegex(lines[0], "no display.*render")
        self.assertEqual(lines[1], "(8, 8, 3)")

    @unittest.skipUnless(shutil.which("Xvfb") and shutil.which("xdotool"), "needs Xvfb and xdotool")
    def test_windows(self):
        """They open, show, pause and move cameras, and close; the motion is that of a simulation without."""
        with Display() as name:
            text = (
                "import ambf, sys, subprocess, threading, time\n"
                "make = lambda: ambf.Simulation(sys.argv[1], launch_file=sys.argv[2])\n"
                "sim, other = make(), make()\n"
                "view = sim.view()\n"
                "for each in (sim, other):\n    each.step(200)\n"
                "find = ['xdotool', 'search', '--sync', '--onlyvisible', '--name', 'AMBF Simulator Window 1']\n"
                "window = subprocess.run(find, capture_output=True, text=True, timeout=60).stdout.split()[0]\n"
                "print(view.is_open, (sim.poses == other.poses).all(), sim.view().is_open)\n"
                # The camera is moved while nobody steps.
                "before = sim.camera_pose()\n"
                "tool = lambda *words: subprocess.run(['xdotool', *words], check=True, timeout=60)\n"
                "tool('mousemove', '--window', window, '200', '150')\n"
                "deadline = time.monotonic() + 30\n"
                "while (sim.camera_pose() == before).all() and time.monotonic() < deadline:\n"
                "    tool('click', '4')\n    time.sleep(0.3)\n    sim.step()\n"
                "print((sim.camera_pose() != before).any())\n"
                # Ctrl+P pauses: `step` waits; Space lets one iteration through, Ctrl+P all.
                "tool('windowfocus', '--sync', window)\n"
                "tool('key', 'ctrl+p')\ntime.sleep(1.0)\n"
                "count = sim.sim_step\n"
                "def run():\n    for _ in range(3):\n        sim.step()\n"
                "thread = threading.Thread(target=run)\nthread.start()\nthread.join(1.0)\n"
                "print(thread.is_alive(), sim.sim_step - count)\n"
                "tool('key', 'space')\nthread.join(1.0)\n"
                "print(thread.is_alive(), sim.sim_step - count)\n"
                "tool('key', 'ctrl+p')\nthread.join(20.0)\nprint(thread.is_alive())\n"
                "view.close()\nprint(view.is_open)\nsim.step(3)\n"
            )
            lines = self.run_program(text, DISPLAY=name, WAYLAND_DISPLAY="")
        self.assertEqual(lines, ["True True True", "True", "True 0", "True 1", "False", "False"])


class Life(unittest.TestCase):
    """Many, in threads and processes."""

    def test_many_at_once(self):
        """Each has a renderer of its own, whichever thread asks."""
        sims = [simulation() for _ in range(6)]
        expected = []
        for i, sim in enumerate(sims):
            sim.step(30 * i + 1)
            expected.append(sim.render("front").tobytes())
        with concurrent.futures.ThreadPoolExecutor(4) as pool:
            for _ in range(10):
                self.assertEqual(list(pool.map(lambda sim: sim.render("front").tobytes(), sims)), expected)
        # Sizes and cameras in turn; renderers come and go.
        for _ in range(20):
            other = simulation()
            other.render("two", 33, 21)
            other.close()
            self.assertRaises(ambf.ClosedError, other.render)
            self.assertRaises(ambf.ClosedError, other.camera_pose)
        del sims
        gc.collect()

    def test_one_simulation_in_many_threads(self):
        """They wait for each other while they draw; who steps meanwhile is told so."""
        sim = simulation()
        expected = sim.render("front").tobytes()
        with concurrent.futures.ThreadPoolExecutor(4) as pool:

            def draw(_):
                while True:
                    try:
                        return sim.render("front").tobytes()
                    except ambf.BusyError:
                        time.sleep(0.001)

            self.assertEqual(set(pool.map(draw, range(40))), {expected})

    def test_the_lock_of_python_is_released(self):
        """Other threads go on while a large picture is drawn, and may step the same simulation."""
        sim = ambf.Simulation(ARM, launch_file=LAUNCH)
        sim.render()
        large = {"width": 4000, "height": 3000, "samples": 4}
        thread = threading.Thread(target=sim.render, kwargs=large)
        begin = time.monotonic()
        thread.start()
        time.sleep(0.02)
        counted = stepped = 0
        while thread.is_alive():
            counted += 1
            try:
                sim.step()
                stepped += 1
            except ambf.BusyError:
                pass
        thread.join()
        self.assertGreater(time.monotonic() - begin, 0.05, "too fast to see anything")
        self.assertGreater(counted, 10)
        self.assertGreater(stepped, 5)

    def test_processes(self):
        """Forked ones draw if their parent has not; others always do."""
        text = (
            "import sys, multiprocessing as m, os\n"
            f"sys.path[:0] = {sys.path!r}\n"
            "from test_render import picture_of\n"
            "if __name__ == '__main__':\n"
            "    with m.get_context('fork').Pool(3) as pool:\n"
            "        seen = pool.map(picture_of, [1, 1, 80, 1])\n"
            "    print(len(set(seen)), seen[0] == picture_of(1), seen[2] == picture_of(80))\n"
        )
        done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=120, check=False)
        self.assertEqual(done.stdout.split(), ["2", "True", "True"], done.stderr)
        expected = picture_of(5)
        for way in ("spawn", "forkserver"):
            with concurrent.futures.ProcessPoolExecutor(2, multiprocessing.get_context(way)) as pool:
                self.assertEqual(list(pool.map(picture_of, [5, 5])), [expected] * 2)

    @unittest.skipUnless(hasattr(os, "fork"), "no fork here")
    def test_after_a_fork(self):
        """A child of a process that has drawn is told so, steps and ends; its parent goes on."""
        sim = simulation()
        expected = sim.render().tobytes()
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            said = []
            for attempt in (sim, simulation()):
                try:
                    attempt.render()
                    said.append("drew")
                except ambf.RenderError as error:
                    said.append(str(error))
                attempt.step(3)
                attempt.close()
            os.write(write, "\n".join(said).encode())
            os._exit(0)
        os.close(write)
        with os.fdopen(read) as pipe:
            said = pipe.read().split("\n")
        self.assertEqual(os.waitpid(child, 0)[1], 0)
        self.assertEqual(len(said), 2)
        for line in said:
            self.assertIn("forked from one that has made pictures", line)
            self.assertIn("spawn", line)
        self.assertEqual(sim.render().tobytes(), expected)

    def test_without_opengl(self):
        """There is advice, and the physics goes on."""
        text = (
            "import ambf, sys\nsim = ambf.Simulation(sys.argv[1])\n"
            "try:\n    sim.render()\nexcept ambf.RenderError as error:\n    print(error)\n"
            "sim.step(3)\nprint(sim.sim_step)\n"
        )
        # No vendor of EGL is found.
        environment = {**os.environ, "__EGL_VENDOR_LIBRARY_FILENAMES": "/nothing.json"}
        command = [sys.executable, "-c", text, str(ARM)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=environment)
        lines = done.stdout.splitlines()
        self.assertEqual(len(lines), 2, done.stderr)
        self.assertIn("install libegl1 and libgl1-mesa-dri", lines[0])
        self.assertEqual(lines[1], "3")


if __name__ == "__main__":
    unittest.main()
