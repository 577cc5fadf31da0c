"""Windows: what they look like, and what keys and the mouse do in them, on an X server of their own without a screen.

Names of tests hold the numbers of the rows of the checklist that they check."""

import ctypes
import json
import math
import os
import pathlib
import subprocess
import time
import unittest

import harness
from ambf_msgs.msg import CameraState, RigidBodyState, WorldState
from display import Display
from scenes import NOWHERE, box, model
from sensor_msgs.msg import Image
from simulated import WORLD, Ros, Simulated

SCREEN = (1000, 800)
# What the program does of its own: 80 % x 50 %, centred.
SIZE = (800, 400)
PLACE = (100, 200)


class ClientMessage(ctypes.Structure):
    """Xlib's XClientMessageEvent, as large as any of its events."""

    _fields_ = [
        ("type", ctypes.c_int),
        ("serial", ctypes.c_ulong),
        ("send_event", ctypes.c_int),
        ("display", ctypes.c_void_p),
        ("window", ctypes.c_ulong),
        ("message_type", ctypes.c_ulong),
        ("format", ctypes.c_int),
        ("data", ctypes.c_long * 5),
        ("pad", ctypes.c_long * 24),
    ]


class Screen(Display):
    """A display with what is on it."""

    def __init__(self):
        super().__init__(SCREEN)

    def run(self, *command):
        """Output of a program that works with the display."""
        done = subprocess.run(
            [str(word) for word in command],
            env={**os.environ, "DISPLAY": self.name},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            timeout=harness.PATIENCE_S,
            check=False,
        )
        return done.stdout

    def windows(self):
        """{title: (left, top, width, height)} of all windows that are shown."""
        found = {}
        for number in self.run("xdotool", "search", "--onlyvisible", "--name", "AMBF Simulator Window").split():
            text = self.run("xwininfo", "-id", number.decode()).decode()
            if "IsViewable" not in text:
                continue
            title = text.split('"')[1]
            value = {line.split(":")[0].strip(): line.split(":")[-1].strip() for line in text.splitlines() if ":" in line}
            keys = ("Absolute upper-left X", "Absolute upper-left Y", "Width", "Height")
            found[title] = tuple(int(value[key]) for key in keys)
        return found

    def number(self, title):
        """Number of a window."""
        return self.run("xdotool", "search", "--name", f"^{title}$").split()[0].decode()

    def mouse(self, *words):
        """Lets xdotool move the pointer and press buttons."""
        self.run("xdotool", *words)

    def key(self, window, *keys):
        """Presses keys in a window."""
        number = self.number(window)
        self.run("xdotool", "windowfocus", "--sync", number)
        self.run("xdotool", "key", "--delay", "60", *keys)

    def focus(self, window):
        """Gives a window the keyboard: there is no window manager that would."""
        self.run("xdotool", "windowfocus", "--sync", self.number(window))

    def close(self, number):
        """Does what a window manager does when its user closes a window: sends WM_DELETE_WINDOW."""
        x11 = ctypes.CDLL("libX11.so.6")
        x11.XOpenDisplay.restype = ctypes.c_void_p
        x11.XInternAtom.restype = ctypes.c_ulong
        display = ctypes.c_void_p(x11.XOpenDisplay(self.name.encode()))
        protocols, delete = (
            x11.XInternAtom(display, name, False) for name in (b"WM_PROTOCOLS", b"WM_DELETE_WINDOW")
        )
        message = ClientMessage(type=33, window=int(number), message_type=protocols, format=32)
        message.data[0] = delete
        x11.XSendEvent(display, ctypes.c_ulong(int(number)), False, ctypes.c_long(0), ctypes.byref(message))
        x11.XCloseDisplay(display)

    def picture(self):
        """What is on the screen: rows of (red, green, blue)."""
        size = f"{SCREEN[0]}x{SCREEN[1]}"
        command = ["ffmpeg", "-loglevel", "error", "-f", "x11grab", "-draw_mouse", "0", "-video_size", size, "-i", self.name]
        pixels = self.run(*command, "-frames:v", "1", "-f", "rawvideo", "-pix_fmt", "rgb24", "-")
        assert len(pixels) == 3 * SCREEN[0] * SCREEN[1], f"{len(pixels)} bytes"
        row = 3 * SCREEN[0]
        return [
            [tuple(pixels[at : at + 3]) for at in range(start, start + row, 3)] for start in range(0, len(pixels), row)
        ]


def camera(name, **keys):
    """A camera 3 m before the origin."""
    return {
        "namespace": "cameras/",
        "name": name,
        "location": {"x": 3.0, "y": 0.0, "z": 0.0},
        "look at": NOWHERE,
        "up": {"x": 0.0, "y": 0.0, "z": 1.0},
        "clipping plane": {"near": 0.01, "far": 20.0},
        "field view angle": 0.8,
        **keys,
    }


def red(body):
    """The body in red."""
    return {**body, "color rgba": {"r": 1.0, "g": 0.0, "b": 0.0, "a": 1.0}}


def ball(name, radius):
    """A ball that nothing pulls at."""
    body = {key: value for key, value in box(name, 1.0).items() if "geometry" not in key and "shape" not in key}
    shape = {"shape": "Sphere", "geometry": {"radius": radius}}
    return {**body, **shape, **{f"collision {key}": value for key, value in shape.items()}}


class Windowed(Simulated):
    """A simulator with windows for each test."""

    CAMERAS = {"CAMERA eye": camera("eye")}
    BODIES = {"BODY Red": red(ball("Red", 0.3))}
    GUI = ("-g", "1")
    GRAVITY = NOWHERE

    def setUp(self):
        self.display = Screen()
        self.addCleanup(self.display.stop)
        folder = harness.folder / self.id().rsplit(".", maxsplit=1)[-1]
        folder.mkdir()
        self.files_at = folder
        world = {
            "environment": "./ground.yaml",
            "namespace": "/ambf/env/",
            "max iterations": 50,
            "gravity": self.GRAVITY,
            "lights": ["LIGHT lamp"],
            "cameras": list(self.CAMERAS),
            "LIGHT lamp": {
                "namespace": "lights/",
                "name": "lamp",
                "location": {"x": 4.0, "y": 0.0, "z": 4.0},
                "direction": {"x": -1.0, "y": 0.0, "z": -1.0},
                "cutoff angle": 1.2,
                "shadow quality": 0,
            },
            **self.CAMERAS,
        }
        files = {
            "world.yaml": world,
            "ground.yaml": model({"BODY Ground": dict(box("Ground", 0.0, z=-50.0, size=1.0), passive=True)}),
            "colors.yaml": {"red": {"r": 255, "g": 0, "b": 0, "a": 255}},
            "devices.yaml": {"input devices": []},
            "model.yaml": model(self.BODIES),
            "launch.yaml": {
                "world config": "./world.yaml",
                "color config": "./colors.yaml",
                "input devices config": "./devices.yaml",
                "multibody configs": ["./model.yaml"],
            },
        }
        for name, content in files.items():
            (folder / name).write_text(json.dumps(content, indent=1))
        self.simulator = harness.Simulator(
            Ros.master.port,
            "--launch_file",
            folder / "launch.yaml",
            "-l",
            "0",
            *self.ARGUMENTS,
            gui=self.GUI,
            DISPLAY=self.display.name,
        )
        self.addCleanup(self.finish, self.simulator)
        self.simulator.wait_for_topics(f"{WORLD}/State")
        self.world = self.listen(f"{WORLD}/State", WorldState)
        self.world.newest()

    def finish(self, simulator):
        """It may have ended by itself, with status 0."""
        if simulator.running():
            super().finish(simulator)
        else:
            self.assertEqual(simulator.status(), 0, simulator.log())
            simulator.check_log()

    def wait_for_windows(self, count):
        """Waits until so many windows are shown; their places by title."""

        def shown():
            assert self.simulator.running(), self.simulator.log()
            windows = self.display.windows()
            return windows if len(windows) == count else None

        return harness.wait_for(shown, f"{count} windows")

    def wait_for_picture(self, condition, what):
        """Waits until the screen shows something; the picture."""

        def shown():
            picture = self.display.picture()
            return picture if condition(picture) else None

        return harness.wait_for(shown, what)

    def eye(self, name="eye"):
        """Listener of a camera's state."""
        return self.listen(f"/ambf/env/cameras/{name}/State", CameraState)

    def drag(self, button, dx, dy, steps=10, start=(500, 400)):
        """Drags in equal moves from the middle of the window."""
        self.display.mouse("mousemove", *start)
        time.sleep(0.2)
        self.display.mouse("mousedown", button)
        for step in range(1, steps + 1):
            place = (start[0] + dx * step // steps, start[1] + dy * step // steps)
            self.display.mouse("mousemove", *place)
        self.display.mouse("mouseup", button)


def position(state):
    """Of an object."""
    place = state.pose.position
    return (place.x, place.y, place.z)


def is_near(found, expected, off=2e-3):
    """Whether two vectors are the same within `off`."""
    return all(abs(a - b) <= off for a, b in zip(found, expected))


def view(state):
    """Direction in which a camera looks: its -x axis."""
    q = state.pose.orientation
    return (
        -(1 - 2 * (q.y * q.y + q.z * q.z)),
        -2 * (q.x * q.y + q.z * q.w),
        -2 * (q.x * q.z - q.y * q.w),
    )


def reds(picture, area=None):
    """Pixels that are red: (left, top, right, bottom, number)."""
    left, top, width, height = area or (0, 0, *SCREEN)
    places = [
        (x, y)
        for y in range(top, top + height)
        for x, (r, g, b) in enumerate(picture[y][left : left + width], left)
        if r > 60 and g < 0.45 * r and b < 0.45 * r
    ]
    if not places:
        return None
    columns, rows = [x for x, _ in places], [y for _, y in places]
    return (min(columns), min(rows), max(columns), max(rows), len(places))


def dark(picture, area):
    """Nearly black pixels of an area."""
    left, top, width, height = area
    return sum(max(pixel) < 70 for row in picture[top : top + height] for pixel in row[left : left + width])


def plugin_library(name="marker"):
    """The library of an example of plugins: cargo puts it beside the tests that depend on it, or builds it here."""
    folder = harness.simulator_path().parent
    places = [folder / f"libambf_{name}.so", folder / "deps" / f"libambf_{name}.so"]
    if not any(place.exists() for place in places):
        command = ["cargo", "build", "--quiet", "--package", f"ambf-{name}", "--target-dir", folder.parent]
        release = ["--release"] if folder.name == "release" else []
        subprocess.run([*command, *release], cwd=harness.REPOSITORY, check=True)
    return max((place for place in places if place.exists()), key=lambda place: place.stat().st_mtime)


def cut(picture, area):
    """The part of a picture in an area (left, top, width, height)."""
    return [row[area[0] : area[0] + area[2]] for row in picture[area[1] : area[1] + area[3]]]


def is_green(pixel):
    """Whether a pixel is that of a lit green marker."""
    red_part, green_part, blue_part = pixel
    return green_part > 60 and green_part > 2 * red_part + 20 and green_part > 2 * blue_part + 20


class OneWindow(Windowed):
    """One camera."""

    def test_row_17_a_ball_stays_round_in_a_window_of_any_shape(self):
        windows = self.wait_for_windows(1)
        self.assertEqual(windows, {"AMBF Simulator Window 1": (*PLACE, *SIZE)})
        self.wait_for_picture(reds, "the red ball")
        number = self.display.number("AMBF Simulator Window 1")
        for width, height in ((800, 400), (400, 500)):
            self.display.mouse("windowsize", number, width, height)
            area = (*PLACE, width, height)

            def is_round(picture):
                found = reds(picture, area)
                if not found:
                    return False
                left, top, right, bottom, _ = found
                # The vertical angle is that of the camera: 0.3 m at 3 m.
                focal = height / (2 * math.tan(0.4))
                wanted = 2 * focal * 0.3 / math.sqrt(9 - 0.09)
                across, down = right - left + 1, bottom - top + 1
                middle = ((left + right) / 2 - PLACE[0], (top + bottom) / 2 - PLACE[1])
                return (
                    abs(across - wanted) < 5
                    and abs(down - wanted) < 5
                    and is_near(middle, (width / 2, height / 2), off=3)
                )

            self.wait_for_picture(is_round, f"a round ball in {width} x {height}")

    def test_row_19_full_screen_and_back(self):
        self.wait_for_windows(1)
        self.display.key("AMBF Simulator Window 1", "f")
        full = {"AMBF Simulator Window 1": (0, 0, *SCREEN)}
        harness.wait_for(lambda: self.display.windows() == full, "full screen")
        self.display.key("AMBF Simulator Window 1", "f")
        before = {"AMBF Simulator Window 1": (*PLACE, *SIZE)}
        harness.wait_for(lambda: self.display.windows() == before, "the window's old place")

    def test_row_59_left_drag_pans(self):
        eye = self.eye()
        self.wait_for_windows(1)
        self.wait_for_picture(reds, "the scene")
        self.drag(1, 100, 0)
        eye.until(lambda state: is_near(position(state), (3.0, -1.0, 0.0)), "1 m to the left")
        self.drag(1, 0, 50)
        eye.until(lambda state: is_near(position(state), (3.0, -1.0, 0.5)), "0.5 m up")
        self.display.focus("AMBF Simulator Window 1")
        self.display.mouse("keydown", "Shift_L")
        self.drag(1, -100, 0)
        self.display.mouse("keyup", "Shift_L")
        eye.until(lambda state: is_near(position(state), (3.0, -0.9, 0.5)), "a tenth with Shift")
        # Row 63: back to the beginning.
        self.display.key("AMBF Simulator Window 1", "ctrl+v")
        eye.until(lambda state: is_near(position(state), (3.0, 0.0, 0.0)), "the camera is back")

    def test_rows_60_61_62_look_orbit_wheel(self):
        eye = self.eye()
        self.wait_for_windows(1)
        self.wait_for_picture(reds, "the scene")
        self.drag(3, 100, 0)
        angle = math.radians(30.0)
        eye.until(lambda state: is_near(view(state), (-math.cos(angle), -math.sin(angle), 0.0)), "30 degrees to the left")
        self.display.key("AMBF Simulator Window 1", "ctrl+v")
        eye.until(lambda state: is_near(view(state), (-1.0, 0.0, 0.0)), "the camera is back")

        self.drag(2, 0, 30)
        up = 30 * 0.03 / 3.0
        eye.until(lambda s: is_near(position(s), (3 * math.cos(up), 0.0, 3 * math.sin(up))), "above the target")
        state = eye.newest()
        self.assertTrue(is_near(view(state), [-x / 3 for x in position(state)]), "the target is in the middle")
        self.drag(2, 0, 300)
        eye.until(lambda s: abs(math.asin(s.pose.position.z / 3) - 1.5) < 1e-3, "not beyond 1.5 rad")

        self.display.key("AMBF Simulator Window 1", "ctrl+v")
        eye.until(lambda s: is_near(position(s), (3.0, 0.0, 0.0)), "the camera is back")
        # The drag has ended outside the window.
        self.display.mouse("mousemove", 500, 400)
        # The first tick of a device that the X server has not seen before only says where its wheel stands.
        self.display.mouse("click", 5)
        time.sleep(0.5)
        before = eye.next().pose.position.x
        self.display.mouse("click", 4)
        nearer = eye.until(lambda s: s.pose.position.x < before - 0.05, "nearer")
        time.sleep(0.5)
        moved = before - eye.next().pose.position.x
        # This X server has a wheel without axes, of which the window library reports press and release: two ticks a click.
        self.assertTrue(is_near((moved,), (0.1,)) or is_near((moved,), (0.2,)), f"{moved} m, {nearer}")
        self.display.mouse("click", "--repeat", 5, "--delay", 60, 5)
        eye.until(lambda s: is_near(position(s), (before + 4 * moved, 0.0, 0.0)), "four clicks further back")

    def test_row_57_pick_drag_release(self):
        ball_state = self.listen("/ambf/env/Red/State", RigidBodyState)
        self.wait_for_windows(1)
        self.wait_for_picture(reds, "the red ball")
        self.display.key("AMBF Simulator Window 1", "p")
        self.wait_for_log("picking on")
        self.display.mouse("mousemove", 500, 400)
        time.sleep(0.2)
        self.display.mouse("mousedown", 1)
        self.wait_for_log("User picked AF rigid body: Red")

        def is_tomato(picture):
            return any(pixel[0] > 80 and 0.3 < pixel[1] / pixel[0] < 0.46 and pixel[2] < pixel[1] for pixel in picture[430][480:520])

        picture = self.wait_for_picture(is_tomato, "the ball is tomato")
        point = sum(r < g and b < g - 60 for row in picture[390:410] for r, g, b in row[490:510])
        self.assertGreater(point, 30, "the point is green-yellow")
        # 100 pixels to the right, at the distance of the hit: 2.7 m.
        for x in range(510, 601, 10):
            self.display.mouse("mousemove", x, 400)
        focal = SIZE[1] / (2 * math.tan(0.4))
        angle = math.atan(100 / focal)
        wanted = 2.7 * math.sin(angle)
        ball_state.until(lambda state: abs(state.pose.position.y - wanted) < 0.02, f"the ball is at y = {wanted:.3f}")
        self.display.mouse("mouseup", 1)
        self.wait_for_picture(lambda picture: not is_tomato(picture) and reds(picture), "its own colour is back")
        # Row 73: the body that was picked last goes, for everybody.
        self.display.key("AMBF Simulator Window 1", "ctrl+x")
        self.wait_for_log("removed body Red")
        self.wait_for_picture(lambda picture: not reds(picture), "the ball is gone")
        harness.wait_for(lambda: "/ambf/env/Red/State" not in harness.published(Ros.master.port), "its topics are gone")

    def test_rows_64_65_66_texts_and_pause(self):
        self.wait_for_windows(1)
        self.wait_for_picture(reds, "the scene")
        left, top, width, height = (*PLACE, *SIZE)
        # Three centred lines above the lower edge, one below the upper edge, nothing beside them.
        bottom = (left + 200, top + height - 75, 400, 75)
        above = (left + 200, top, 400, 24)
        picture = self.wait_for_picture(lambda picture: dark(picture, bottom) > 300, "texts")
        self.assertGreater(dark(picture, above), 60)
        self.assertEqual(dark(picture, (left, top + height - 75, 150, 75)), 0)

        times = (left + 200, top + height - 50, 400, 20)
        self.display.key("AMBF Simulator Window 1", "ctrl+p")
        self.wait_for_log("paused")
        before = self.world.newest().sim_step
        first = cut(self.display.picture(), times)
        harness.wait_for(lambda: cut(self.display.picture(), times) != first, "the wall time goes on")
        self.display.key("AMBF Simulator Window 1", "u")
        self.wait_for_log("updating of texts off")
        time.sleep(0.5)
        stands = cut(self.display.picture(), bottom)
        time.sleep(1.5)
        self.assertEqual(cut(self.display.picture(), bottom), stands, "texts stand still")
        self.display.key("AMBF Simulator Window 1", "u")
        # Paused: cameras move all the same.
        eye = self.eye()
        self.drag(1, 100, 0)
        eye.until(lambda state: is_near(position(state), (3.0, -1.0, 0.0)), "panned while paused")
        paused = self.world.newest().sim_step
        self.assertLess(paused - before, 1000)
        self.display.key("AMBF Simulator Window 1", "space")
        self.world.until(lambda state: state.sim_step == paused + 1, "one step")
        self.display.key("AMBF Simulator Window 1", "ctrl+space")
        self.world.until(lambda state: state.sim_step == paused + 11, "ten steps")
        self.display.key("AMBF Simulator Window 1", "ctrl+p")
        self.world.until(lambda state: state.sim_step > paused + 100, "it runs again")

    def test_keys_say_what_they_do(self):
        self.wait_for_windows(1)
        window = "AMBF Simulator Window 1"
        said = {
            "v": "frames on",
            "m": "mirrored windows on",
            "i": "inverted mouse on",
            "s": "sensors on",
            "a": "actuators on",
            "n": "GRIPPER_JAW_CONTROL",
            "c": "camera's frame",
            "w": "world's frame",
            "t": "gripping assist off",
            "2": "gravity off",
            "1": "gravity on",
            "4": "K_lh = 0.0500",
            "Home": "D_ac = 0.1000",
            "shift+n": "normal maps off",
            "shift+v": "no body was picked",
            "ctrl+x": "no body was picked",
            "ctrl+r": "reset of all rigid bodies",
            "alt+r": "reset of the world",
            "h": "end the simulation",
        }
        for key, text in said.items():
            self.display.key(window, key)
            self.wait_for_log(text)
        self.display.key(window, "F1")
        self.display.key(window, "alt+2")
        self.display.key(window, "q")
        self.assertEqual(self.simulator.status(), 0, self.simulator.log())

    def test_a_key_begins_a_recording_with_the_next_reset_and_ends_it(self):
        self.wait_for_windows(1)
        window = "AMBF Simulator Window 1"
        self.pass_time(0.1)
        self.display.key(window, "shift+r")
        line = self.wait_for_log("is recorded from the next reset of the world on")
        file = pathlib.Path(line[line.index("ambf_") :].split(" ", maxsplit=1)[0])
        self.addCleanup(file.unlink, missing_ok=True)
        self.display.key(window, "alt+r")
        self.wait_for_log("the recording begins, with this reset")
        self.pass_time(0.2)
        self.display.key(window, "shift+r")
        self.wait_for_log(f"updates in {file}")
        batch = harness.simulator_path().with_name("ambf_batch")
        done = subprocess.run([batch, "--replay", file, "--json"], capture_output=True, text=True, check=False)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertGreater(json.loads(done.stdout)["sim_s"], 0.2)

    def test_a_display_that_goes_away_leaves_the_simulation_alone(self):
        self.wait_for_windows(1)
        self.display.stop()
        self.wait_for_log("the simulation goes on without")
        self.pass_time(1.0)


class TwoWindows(Windowed):
    """Two cameras, one of which names devices."""

    CAMERAS = {
        "CAMERA one": camera("one"),
        "CAMERA two": camera("two", **{"controlling devices": ["A", "B"], "monitor": 7}),
        "CAMERA three": camera("three", visible=False),
    }

    def test_rows_14_15_18_titles_places_and_end(self):
        windows = self.wait_for_windows(2)
        self.assertEqual(
            windows,
            {
                "AMBF Simulator Window 1": (*PLACE, *SIZE),
                "AMBF Simulator Window 2 - A - B": (PLACE[0] + 30, PLACE[1] + 30, *SIZE),
            },
        )
        self.wait_for_log("there is no monitor 7")
        number = self.display.number("AMBF Simulator Window 2 - A - B")
        self.display.close(number)
        self.assertEqual(self.simulator.status(), 0, self.simulator.log())


class PublishingWindow(Windowed):
    """A camera with a window that publishes pictures."""

    CAMERAS = {
        "CAMERA eye": camera(
            "eye", **{"publish image": True, "publish image resolution": {"width": 320, "height": 240}}
        )
    }

    def test_row_64_texts_are_in_the_window_and_not_in_images(self):
        self.wait_for_windows(1)
        images = self.listen("/ambf/env/cameras/eye/ImageData", Image)
        left, top, width, height = (*PLACE, *SIZE)
        self.wait_for_picture(lambda picture: dark(picture, (left + 200, top + height - 75, 400, 75)) > 300, "texts")
        image = images.next()
        self.assertEqual((image.width, image.height, image.encoding), (320, 240, "rgb8"))
        rows = [image.data[start : start + image.step] for start in range(0, len(image.data), image.step)]
        self.assertEqual({value for row in rows[:20] + rows[-40:] for value in row}, {255}, "nothing but the background")
        # Below the highlight.
        red, green, _ = rows[136][3 * 160 : 3 * 160 + 3]
        self.assertTrue(red > 60 and green < red / 2, "the ball in the middle")
        # A display that goes away takes no pictures from ROS.
        self.display.stop()
        self.wait_for_log("the simulation goes on without")
        images.next()
        later = images.newest().header.stamp
        images.until(lambda image: (image.header.stamp - later).to_sec() > 1.0, "pictures keep coming")


class WithPlugin(Windowed):
    """Two cameras, and the example of a plugin for windows."""

    CAMERAS = {"CAMERA one": camera("one"), "CAMERA two": camera("two")}

    def setUp(self):
        self.ARGUMENTS = ("--plugins", plugin_library())
        super().setUp()

    def test_rows_74_75_frames_keys_and_mouse_reach_plugins_which_draw(self):
        self.wait_for_windows(2)
        first, second = (f"AMBF Simulator Window {number}" for number in (1, 2))
        self.wait_for_log("libambf_marker.so: the first frame was drawn")
        # A dark blue panel behind the text, at its place.
        left, top = PLACE

        def is_panel(picture):
            return sum(b > 60 and b > r + 25 and b > g + 25 for row in picture for r, g, b in row) > 2000

        self.wait_for_picture(is_panel, "the panel behind the plugin's text")
        # After the built-in action, with modifiers and window.
        self.display.key(second, "ctrl+p")
        self.wait_for_log("key Ctrl+P in window 2")
        log = self.simulator.log()
        self.assertLess(log.index("paused"), log.index("key Ctrl+P in window 2"), log)
        # Also while paused: frames go on.
        text = (left + 30, top + 80, 250, 40)
        before = cut(self.display.picture(), text)
        harness.wait_for(lambda: cut(self.display.picture(), text) != before, "frames are counted while paused")
        self.display.key(first, "ctrl+p")
        self.wait_for_log("key Ctrl+P in window 1")
        self.assertEqual(sum(is_green(pixel) for row in self.display.picture() for pixel in row), 0)
        self.display.key(first, "b")
        self.wait_for_log("key B in window 1")
        self.wait_for_picture(
            lambda picture: sum(is_green(pixel) for row in picture for pixel in row) > 200, "a green ball above the body"
        )
        self.display.key(first, "b")
        self.wait_for_picture(
            lambda picture: not any(is_green(pixel) for row in picture for pixel in row), "the ball is gone"
        )
        # Pictures: a sky behind the scene of the window on top, which fills it, and three squares before it.
        self.display.key(first, "k")
        right, above = left + 30 + SIZE[0], top + 30

        def has_pictures(picture):
            sky = picture[above + 3][left + 40], picture[above + SIZE[1] // 2][right - 10]
            squares = [pixel for at in (15, 45, 75) for pixel in picture[above + 25][right - 100 + at]]
            return (
                sky[0][0] < 20
                and sky[0][2] > 240
                and abs(sky[1][0] - 96) < 12
                and is_near(squares, (255, 0, 0, 0, 255, 0, 0, 0, 255), off=25)
            )

        picture = self.wait_for_picture(has_pictures, "a sky and squares")
        middle = picture[above + SIZE[1] // 2][left + 30 + SIZE[0] // 2]
        self.assertLess(middle[2], 100, "the ball is before the sky")
        self.display.key(first, "k")
        self.wait_for_picture(lambda picture: picture[above + 3][left + 40] == (255, 255, 255), "the sky is gone")
        self.display.mouse("mousemove", left + 300, top + 15)
        self.display.mouse("click", "3")
        self.wait_for_log("button 1 pressed in window 1 at 300, 15, modifiers 0")
        self.wait_for_log("button 1 released in window 1 at 300, 15, modifiers 0")


class NoCamera(Windowed):
    """A world without cameras."""

    CAMERAS = {}

    def test_row_13_the_default_camera_has_a_window(self):
        self.assertEqual(list(self.wait_for_windows(1)), ["AMBF Simulator Window 1"])
        state = self.eye_of_default().next()
        self.assertTrue(is_near(position(state), (0.0, 0.0, 0.0)))
        self.assertTrue(is_near(view(state), (-1.0, 0.0, 0.0)))

    def eye_of_default(self):
        """The state of the camera that was not described."""
        topic = harness.wait_for(
            lambda: next((t for t in harness.published(Ros.master.port) if t.endswith("default_camera/State")), None),
            "the default camera has a topic",
        )
        return self.listen(topic, CameraState)


class SameTrace(Windowed):
    """A box that falls and turns with fixed steps, recorded by a plugin in each step."""

    ARGUMENTS = ("-t", "true")
    GRAVITY = {"x": 0.3, "y": 0.1, "z": -1.0}
    STEPS = 1000

    def setUp(self):
        library = plugin_library("recorder")
        recorded = {"plugins": [{"name": "recorder", "filename": str(library)}], "record": {"file": "trace.csv"}}
        self.BODIES = {"BODY Red": {**red(ball("Red", 0.3)), **recorded}}
        super().setUp()

    def trace(self):
        """The first rows of the recording, once there are so many."""

        def rows():
            # It has its own name when it is complete.
            files = list(self.files_at.glob("*.csv"))
            lines = files[0].read_text().splitlines() if files else []
            # The last line may be cut.
            return lines[: self.STEPS] if len(lines) > self.STEPS + 1 else None

        return harness.wait_for(rows, "a trace")

    def test_row_70_the_trace_is_the_same_with_and_without_windows(self):
        self.wait_for_windows(1)
        with_windows = self.trace()
        self.display.key("AMBF Simulator Window 1", "q")
        self.assertEqual(self.simulator.status(), 0, self.simulator.log())
        (self.files_at / "trace.csv").unlink()
        launch = self.files_at / "launch.yaml"
        headless = harness.Simulator(
            Ros.master.port, "--launch_file", launch, "-l", "0", "--no_ros", *self.ARGUMENTS, DISPLAY=""
        )
        self.addCleanup(headless.stop)
        without = self.trace()
        self.assertEqual(with_windows, without)
        first, last = (row.split(",")[2:5] for row in (without[1], without[-1]))
        self.assertGreater(abs(float(last[2]) - float(first[2])), 0.1, "it fell")


class PluginWithoutWindows(unittest.TestCase):
    """The same plugin in a run without windows."""

    def test_row_74_no_frame_is_told_without_windows(self):
        simulator = harness.Simulator(Ros.master.port, "-l", "1", "--no_ros", "--verbose", "true", "--plugins", plugin_library())
        self.addCleanup(simulator.stop)
        harness.wait_for(lambda: "is running" in simulator.log(), "the plugin runs")
        time.sleep(1.5)
        self.assertEqual(simulator.interrupt(), 0)
        self.assertNotIn("frame was drawn", simulator.log())
        simulator.check_log()


class NoDisplay(unittest.TestCase):
    """What the option -g means where there is no display."""

    def start(self, *gui, display=""):
        """A simulator without a display, or with one that is not there."""
        simulator = harness.Simulator(Ros.master.port, "-l", "1", "--no_ros", gui=gui, DISPLAY=display, WAYLAND_DISPLAY="")
        self.addCleanup(simulator.stop)
        return simulator

    def test_row_69_windows_that_are_asked_for_and_cannot_be(self):
        for display in ("", ":4242"):
            simulator = self.start("-g", "1", display=display)
            self.assertEqual(simulator.status(), 1, simulator.log())
            self.assertIn("windows", simulator.log())
            self.assertIn("-g 0", simulator.log())
            simulator.check_log()

    def test_without_a_word_about_windows_it_runs_headless(self):
        for gui, display in (((), ""), ((), ":4242"), (("-g", "0"), "")):
            simulator = self.start(*gui, display=display)
            harness.wait_for(lambda: "loaded" in simulator.log(), "it runs")
            time.sleep(1.0)
            self.assertTrue(simulator.running(), simulator.log())
            said = [line for line in simulator.log().splitlines() if "without" in line]
            self.assertEqual(len(said), 0 if gui else 1, simulator.log())
            self.assertEqual(simulator.interrupt(), 0)
            simulator.check_log()


setUpModule, tearDownModule = Ros.start, Ros.stop
