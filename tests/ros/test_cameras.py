"""Images, clouds and intrinsics of cameras. Numbers of rows are those of the checklist of what must be seen."""

import array
import math
import pathlib
import shutil
import signal
import subprocess
import sys
import time

import harness
import node
import rospy
import tcpros
from ambf_msgs.msg import CameraCmd, CameraState, WorldCmd, WorldState
from ambf_msgs.srv import AddModel, RemoveModel
from geometry_msgs.msg import Point32
from scenes import box, model
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud, PointCloud2
from simulated import WORLD, Ros, Simulated, written
from std_msgs.msg import Empty, Float32

setUpModule, tearDownModule = Ros.start, Ros.stop

CAMERAS = "/ambf/env/cameras"
ANGLE = 0.8


def vector(x, y, z):
    """As a scene file writes it."""
    return {"x": x, "y": y, "z": z}


def camera(name, at=(2.0, 0.0, 0.0), to=(0.0, 0.0, 0.0), size=(64, 48), **more):
    """A camera of vertical angle ANGLE that sees from 0.1 to 10 m; `more`: keys with _ for spaces."""
    return {
        "name": name,
        "namespace": f"{CAMERAS}/",
        "location": vector(*at),
        "look at": vector(*to),
        "up": vector(0.0, 0.0, 1.0),
        "clipping plane": {"near": 0.1, "far": 10.0},
        "field view angle": ANGLE,
        "publish image resolution": {"width": size[0], "height": size[1]},
        "visible": False,
        **{key.replace("_", " "): value for key, value in more.items()},
    }


def block(name, at, size, color):
    """A static cube that shines in one colour: it looks the same from all sides."""
    cube = dict(box(name, 0.0, size=size))
    cube["location"] = {"position": vector(*at), "orientation": {"r": 0.0, "p": 0.0, "y": 0.0}}
    components = {"r": color[0], "g": color[1], "b": color[2]}
    cube["color components"] = {
        "ambient": {"level": 0.0},
        "diffuse": components,
        "specular": {"r": 0.0, "g": 0.0, "b": 0.0},
        "emission": components,
        "transparency": 1.0,
    }
    return cube


def scene(name, cameras, blocks=()):
    """A model file with these cameras and cubes; its path."""
    content = model({f"BODY {cube['name']}": cube for cube in blocks})
    content["cameras"] = [f"CAMERA {one['name']}" for one in cameras]
    content.update({f"CAMERA {one['name']}": one for one in cameras})
    return written(name, content)


def pixel(image, x, y):
    """(r, g, b) at column x of row y, from the upper left."""
    at = y * image.step + 3 * x
    return tuple(image.data[at : at + 3])


def name_of(color):
    """`red`, `green`, `blue` for a colour in which one channel is by far the strongest; `white`, `other`."""
    if min(color) > 250:
        return "white"
    strongest = max(color)
    others = sorted(color)[:2]
    if strongest > 100 and max(others) < strongest / 2:
        return ("red", "green", "blue")[color.index(strongest)]
    return "other"


def floats(data):
    """All 32-bit floats in `data`."""
    numbers = array.array("f")
    numbers.frombytes(data)
    if sys.byteorder != "little":
        numbers.byteswap()
    return numbers


def points(cloud):
    """Lists of x, y and z."""
    numbers = floats(cloud.data)
    return numbers[0::8], numbers[1::8], numbers[2::8]


def stamp(message):
    """Time of the step, ns."""
    return message.header.stamp.to_nsec()


class Stamps:
    """All messages of a topic by stamp."""

    def __init__(self, topic, kind):
        self.seen = {}
        self._subscriber = rospy.Subscriber(topic, kind, self._receive, queue_size=1000, tcp_nodelay=True)

    def _receive(self, message):
        self.seen[stamp(message)] = message

    def close(self):
        """Unsubscribes."""
        self._subscriber.unregister()


class Seen(Simulated):
    """A simulator without window, with cameras in a world without gravity."""

    @property
    def LAUNCH(self):
        """Of the scenes that the tests write."""
        return harness.scene / "launch.yaml"

    def setUp(self):
        """Each test starts its own simulator."""

    def show(self, cameras, blocks=(), arguments=()):
        """Starts a simulator with these cameras and cubes."""
        self.simulator = self.start(scene(f"{self.id()}.yaml", cameras, blocks), arguments=arguments)
        self.simulator.wait_for_topics(*(f"{CAMERAS}/{one['name']}/State" for one in cameras))
        return self.simulator

    def of(self, name, last, kind):
        """A listener to a topic of a camera."""
        return self.listen(f"{CAMERAS}/{name}/{last}", kind)

    def image(self, name):
        """An image of a camera, two after the first: what was loaded is there."""
        listener = self.of(name, "ImageData", Image)
        try:
            listener.newest()
        except AssertionError as error:
            raise AssertionError(f"{error}; the simulator printed:\n{self.simulator.log()}") from None
        listener.next()
        return listener.next()

    def cloud(self, name):
        """A cloud of a camera."""
        listener = self.of(name, "DepthData", PointCloud2)
        listener.newest()
        return listener.next()

    def collect(self, name, last, kind):
        """All messages by stamp."""
        stamps = Stamps(f"{CAMERAS}/{name}/{last}", kind)
        self.addCleanup(stamps.close)
        return stamps

    def has_graphics(self):
        """Whether a library of OpenGL is mapped."""
        maps = pathlib.Path(f"/proc/{self.simulator.process.pid}/maps").read_text()
        return "libEGL" in maps


class Images(Seen):
    """Colour."""

    def test_rows_16_22_23_the_picture_is_upright_and_rgb8(self):
        """A hidden camera's image without a window: encoding, step, frame, and what is where."""
        blocks = [
            block("Red", (0.0, -0.4, 0.3), 0.3, (1, 0, 0)),
            block("Green", (0.0, 0.4, 0.3), 0.3, (0, 1, 0)),
            block("Blue", (0.0, -0.4, -0.3), 0.3, (0, 0, 1)),
        ]
        self.show([camera("cam", publish_image=True)], blocks)
        image = self.image("cam")
        self.assertEqual((image.encoding, image.width, image.height, image.step), ("rgb8", 64, 48, 192))
        self.assertEqual((len(image.data), image.is_bigendian, image.header.frame_id), (64 * 48 * 3, 0, "cam"))
        # 0.4 m at 2 m are 0.4 · f / 2 pixels, f = 24 / tan 0.4; the front of a cube is a little nearer.
        self.assertEqual(name_of(pixel(image, 20, 15)), "red")
        self.assertEqual(name_of(pixel(image, 43, 15)), "green")
        self.assertEqual(name_of(pixel(image, 20, 32)), "blue")
        self.assertEqual(name_of(pixel(image, 43, 32)), "white")

    def test_row_22_the_stamp_is_that_of_the_states_of_the_step(self):
        """While the physics is held at a step, images and states have one stamp; after the next step another one."""
        self.show([camera("cam", publish_image=True, publish_depth=True, publish_depth_interval=1)])
        image, cloud = self.of("cam", "ImageData", Image), self.of("cam", "DepthData", PointCloud2)
        state, world = self.of("cam", "State", CameraState), self.listen(f"{WORLD}/State", WorldState)
        command = WorldCmd(enable_step_throttling=True, n_skip_steps=1)
        with node.Stream(f"{WORLD}/Command", command):

            def stands():
                first = state.next().sim_step
                time.sleep(0.3)
                return state.next().sim_step == first

            harness.wait_for(stands, "the physics is held")
            held = state.next()
            for listener in (image, cloud, world):
                listener.until(lambda message: stamp(message) == stamp(held), "a message of the held step")
            for listener in (image, cloud):
                self.assertEqual(stamp(listener.next()), stamp(held))

    def test_row_20_cameras_with_one_interval_publish_in_the_same_frames(self):
        """Two of interval 5, one of interval 1: same stamps, a fifth of the rate."""
        every = camera("every", publish_image=True, size=(8, 6))
        left, right = (
            camera(name, publish_image=True, publish_image_interval=5, size=(8, 6)) for name in ("left", "right")
        )
        self.show([every, left, right])
        seen = {name: self.collect(name, "ImageData", Image) for name in ("every", "left", "right")}
        harness.wait_for(lambda: all(len(one.seen) > 3 for one in seen.values()), "all publish")
        begin = max(max(one.seen) for one in seen.values())
        harness.wait_for(lambda: len([t for t in seen["every"].seen if t > begin]) > 200, "200 images")
        end = min(max(one.seen) for one in seen.values())
        stamps = {name: {t for t in one.seen if begin < t < end} for name, one in seen.items()}
        self.assertEqual(stamps["left"], stamps["right"])
        self.assertLessEqual(stamps["left"], stamps["every"])
        ratio = len(stamps["every"]) / len(stamps["left"])
        # Images of frames without a step between them have one stamp, and a busy machine misses some.
        self.assertTrue(3.5 < ratio < 6.5, f"{ratio} {[len(one) for one in stamps.values()]}")

    def test_row_21_an_interval_of_0_is_1(self):
        """With a warning, not a crash."""
        self.show([camera("cam", publish_image=True, publish_image_interval=0)])
        self.image("cam")
        self.wait_for_log("publish image interval")

    def test_row_10_a_command_moves_the_camera(self):
        """The next image is from the commanded pose; without the command the camera stays there."""
        self.show([camera("cam", publish_image=True)], [block("Red", (0.0, 0.0, 0.0), 0.3, (1, 0, 0))])
        images = self.of("cam", "ImageData", Image)
        self.assertEqual(name_of(pixel(self.image("cam"), 32, 24)), "red")
        command = CameraCmd(enable_position_controller=True)
        command.pose.position.x, command.pose.position.y, command.pose.orientation.w = 2.0, 0.5, 1.0
        # f = 24 / tan 0.4; the cube is 0.5 m to the left of the middle, 2 m away.
        column = int(32 - 24 / math.tan(ANGLE / 2) * 0.5 / 1.85)

        def is_left(image):
            return name_of(pixel(image, column, 24)) == "red" and name_of(pixel(image, 32, 24)) == "white"

        with node.Stream(f"{CAMERAS}/cam/Command", command):
            images.until(is_left, "the view from the commanded pose")
        ended = stamp(images.next())
        later = images.until(lambda image: stamp(image) > ended + 1_000_000_000, "an image of a second later")
        self.assertTrue(is_left(later), "it stays after the last command")

    def test_row_11_the_field_of_view_is_a_parameter(self):
        """The next image is zoomed by the ratio of the tangents of the half angles."""
        self.show([camera("cam", publish_image=True)], [block("Red", (0.0, 0.0, 0.0), 0.3, (1, 0, 0))])
        images = self.of("cam", "ImageData", Image)

        def width(image):
            return sum(name_of(pixel(image, x, 24)) == "red" for x in range(64))

        before = width(self.image("cam"))
        node.set_parameter(f"{CAMERAS}/cam/field_view_angle", ANGLE / 2)
        expected = before * math.tan(ANGLE / 2) / math.tan(ANGLE / 4)
        images.until(lambda image: abs(width(image) - expected) <= 2, f"about {expected:.0f} pixels")

    def test_row_72_a_reset_of_the_world_leaves_nothing_behind(self):
        """Pictures go on after a reset while points are shown, and the camera is back at its place."""
        self.show([camera("cam", publish_image=True)], [block("Red", (0.0, 0.0, 0.0), 0.3, (1, 0, 0))])
        cloud = rospy.Publisher(f"{WORLD}/point_cloud", PointCloud, queue_size=1, latch=True)
        self.addCleanup(cloud.unregister)
        message = PointCloud(points=[Point32(0.3, 0.0, 0.0)])
        message.header.frame_id = "BODY Red"
        cloud.publish(message)
        images = self.of("cam", "ImageData", Image)
        images.until(lambda image: max(pixel(image, 32, 24)) < 10, "the point is before the cube")
        publisher = rospy.Publisher(f"{WORLD}/Command/Reset", Empty, queue_size=1)
        self.addCleanup(publisher.unregister)
        harness.wait_for(lambda: publisher.get_num_connections() > 0, "the simulator listens")
        publisher.publish(Empty())
        for _ in range(3):
            images.next()
        self.assertIsNone(self.simulator.process.poll())
        message.points = []
        cloud.publish(message)
        images.until(lambda image: name_of(pixel(image, 32, 24)) == "red", "the cube alone")

    def test_compressed_images_show_the_same(self):
        """JPEG, as image_transport names it."""
        self.show([camera("cam", publish_image=True)], [block("Red", (0.0, -0.4, 0.3), 0.4, (1, 0, 0))])
        listener = self.of("cam", "ImageData/compressed", CompressedImage)
        listener.newest()
        message = listener.next()
        self.assertEqual((message.format, message.header.frame_id), ("rgb8; jpeg compressed bgr8", "cam"))
        self.assertEqual((message.data[:2], message.data[-2:]), (b"\xff\xd8", b"\xff\xd9"))
        if not shutil.which("ffmpeg"):
            self.skipTest("ffmpeg, which decodes it, is not installed")
        decode = "ffmpeg -v error -f mjpeg -i - -f rawvideo -pix_fmt rgb24 -".split()
        pixels = subprocess.run(decode, input=message.data, stdout=subprocess.PIPE, check=True).stdout
        self.assertEqual(len(pixels), 64 * 48 * 3)
        decoded = Image(data=pixels, step=192)
        self.assertEqual(name_of(pixel(decoded, 20, 15)), "red")
        self.assertGreater(min(pixel(decoded, 50, 40)), 240)

    def test_stereo_is_side_by_side(self):
        """What is at the focal length is in the middle of both halves; points of both halves are in the camera's frame."""
        stereo = {"mode": "PASSIVE", "eye separation": 0.2, "focal length": 1.9}
        eye = camera(
            "cam", size=(128, 48), publish_image=True, publish_depth=True, publish_depth_interval=1, stereo=stereo
        )
        self.show([eye], [block("Red", (0.0, 0.0, 0.0), 0.2, (1, 0, 0))])
        image, cloud = self.image("cam"), self.cloud("cam")
        red = [x for x in range(128) if name_of(pixel(image, x, 24)) == "red"]
        for half in (range(0, 64), range(64, 128)):
            part = [x for x in red if x in half]
            self.assertTrue(part, red)
            self.assertAlmostEqual((part[0] + part[-1]) / 2, (half[0] + half[-1]) / 2, delta=1.0)
        xs, ys, _ = points(cloud)
        row = 23 * 128
        for half in (range(0, 64), range(64, 128)):
            front = [ys[row + x] for x in half if abs(xs[row + x] + 1.9) < 0.01]
            self.assertAlmostEqual(sum(front) / len(front), 0.0, delta=0.02)
            self.assertAlmostEqual(max(front) - min(front), 0.2, delta=0.05)
        self.assertNotIn(f"{CAMERAS}/cam/CameraInfo", harness.published(Ros.master.port))


class Depth(Seen):
    """Clouds and depth images."""

    def test_row_25_depth_is_along_the_axis(self):
        """A wall 1.5 m ahead: the same x in the corners as in the middle."""
        eye = camera("cam", publish_depth=True, publish_depth_interval=1)
        self.show([eye], [block("Wall", (-1.5, 0.0, 0.0), 4.0, (0, 1, 0))])
        xs, ys, zs = points(self.cloud("cam"))
        self.assertEqual(len(xs), 64 * 48)
        self.assertLess(max(abs(x + 1.5) for x in xs), 0.0015)
        focal = 24 / math.tan(ANGLE / 2)
        for place in range(0, len(xs), 7):
            i, j = place % 64, place // 64
            self.assertAlmostEqual(ys[place], 1.5 * (i + 0.5 - 32) / focal, delta=0.002)
            self.assertAlmostEqual(zs[place], 1.5 * (j + 0.5 - 24) / focal, delta=0.002)

    def test_row_26_nothing_is_at_the_far_plane(self):
        """All points are there, finite."""
        self.show([camera("cam", publish_depth=True, publish_depth_interval=1)])
        xs, ys, zs = points(self.cloud("cam"))
        self.assertEqual((len(xs), len(ys), len(zs)), (64 * 48,) * 3)
        self.assertLess(max(abs(x + 10.0) for x in xs), 0.01)
        self.assertTrue(all(map(math.isfinite, ys)) and all(map(math.isfinite, zs)))

    def test_row_27_the_layout_of_a_cloud(self):
        """Fields, sizes, order of points and of colours."""
        eye = camera("cam", publish_image=True, publish_depth=True, publish_depth_interval=1)
        # In the lower left.
        self.show([eye], [block("Red", (0.0, -0.7, -0.5), 0.7, (1, 0.1, 0))])
        images, clouds = self.collect("cam", "ImageData", Image), self.collect("cam", "DepthData", PointCloud2)
        harness.wait_for(lambda: len(set(images.seen) & set(clouds.seen)) > 2, "both of one frame")
        time_ns = max(set(images.seen) & set(clouds.seen))
        image, cloud = images.seen[time_ns], clouds.seen[time_ns]
        self.assertEqual((cloud.height, cloud.width), (1, 64 * 48))
        self.assertEqual((cloud.point_step, cloud.row_step, len(cloud.data)), (32, 32 * 64 * 48, 32 * 64 * 48))
        self.assertEqual((cloud.is_dense, cloud.is_bigendian, cloud.header.frame_id), (False, False, "cam"))
        fields = [(field.name, field.offset, field.datatype, field.count) for field in cloud.fields]
        self.assertEqual(fields, [("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1), ("rgb", 16, 7, 1)])
        xs, ys, zs = points(cloud)
        self.assertTrue(ys[0] < 0 and zs[0] < 0 and ys[63] > 0 and zs[-1] > 0)
        self.assertEqual(name_of(pixel(image, 8, 40)), "red")
        for place in range(0, len(xs), 5):
            blue, green, red = cloud.data[32 * place + 16 : 32 * place + 19]
            self.assertEqual((red, green, blue), pixel(image, place % 64, 47 - place // 64))
        self.assertLess(abs(xs[7 * 64 + 8] + 1.65), 0.01)

    def test_row_28_noise_is_on_x_only(self):
        """Mean and bias are added to x; the depth image has the same noise."""
        noise = {"mean": 0.1, "std_dev": 0.0, "bias": 0.05}
        eyes = [
            camera("clean", publish_depth=True, publish_depth_interval=1),
            camera("noisy", publish_depth=True, publish_depth_interval=1, publish_depth_noise=noise),
        ]
        self.show(eyes, [block("Wall", (-1.5, 0.0, 0.0), 4.0, (0, 1, 0))])
        clean, noisy = points(self.cloud("clean")), points(self.cloud("noisy"))
        self.assertLess(max(abs(b - a - 0.15) for a, b in zip(clean[0], noisy[0])), 1e-5)
        self.assertEqual((clean[1], clean[2]), (noisy[1], noisy[2]))
        depth = self.of("noisy", "DepthImage", Image).newest()
        self.assertLess(max(abs(a + b) for a, b in zip(noisy[0][:64], floats(depth.data)[-64:])), 1e-5)

    def test_row_29_orthographic_depth(self):
        """x is exact; y and z follow from the pixel alone."""
        eye = camera("cam", publish_depth=True, publish_depth_interval=1, orthographic_view_width=2.0)
        self.show([eye], [block("Red", (0.0, 0.0, 0.0), 0.4, (1, 0, 0))])
        xs, ys, zs = points(self.cloud("cam"))
        self.assertEqual({round(x, 2) for x in xs}, {-1.8, -10.0})
        for place in range(len(xs)):
            i, j = place % 64, place // 64
            self.assertAlmostEqual(ys[place], (i + 0.5 - 32) * 2 / 64, delta=1e-5)
            self.assertAlmostEqual(zs[place], (j + 0.5 - 24) * 2 / 64, delta=1e-5)
        # The view is 64 pixels for 2 m: the box 12 or 13 each way.
        self.assertIn(sum(x > -2.0 for x in xs), range(11 * 11, 15 * 15))
        self.assertNotIn(f"{CAMERAS}/cam/CameraInfo", harness.published(Ros.master.port))

    def test_depth_images_and_a_size_of_their_own(self):
        """Metres, top row first; a resolution of depth of its own makes clouds and depth images of that size with the image's stamps."""
        own = {"width": 16, "height": 12}
        eye = camera("cam", publish_image=True, publish_depth=True, publish_depth_interval=1)
        eye["publish depth resolution"] = own
        self.show([eye], [block("Red", (0.0, -0.4, 0.3), 0.4, (1, 0, 0))])
        kinds = {"ImageData": Image, "DepthImage": Image, "DepthData": PointCloud2}
        seen = {last: self.collect("cam", last, kind) for last, kind in kinds.items()}
        common = lambda: set.intersection(*(set(one.seen) for one in seen.values()))  # pylint: disable=C3001
        harness.wait_for(lambda: len(common()) > 2, "all of one frame")
        image, depth, cloud = (seen[last].seen[max(common())] for last in kinds)
        self.assertEqual((image.width, image.height, cloud.width), (64, 48, 16 * 12))
        self.assertEqual((depth.width, depth.height, depth.step, depth.encoding), (16, 12, 64, "32FC1"))
        self.assertEqual((depth.is_bigendian, depth.header.frame_id), (0, "cam"))
        metres, (xs, _, _) = floats(depth.data), points(cloud)
        for row in range(12):
            for column in range(16):
                self.assertEqual(metres[row * 16 + column], -xs[(11 - row) * 16 + column])
        self.assertAlmostEqual(metres[3 * 16 + 5], 1.8, delta=0.002)
        self.assertAlmostEqual(metres[9 * 16 + 12], 10.0, delta=0.01)


class Others(Seen):
    """What belongs to images: intrinsics, subscribers, models, clouds of clients."""

    def test_camera_info_is_that_of_the_image(self):
        """K follows from the angle and the height, or from the intrinsics of the file; stamps are the images'."""
        eyes = [
            camera("angle", publish_image=True),
            camera("given", publish_image=True, intrinsics={"fx": 50.0, "fy": 60.0, "cx": 30.0, "cy": 20.0}),
        ]
        self.show(eyes, [block("Red", (0.0, 0.4, 0.3), 0.1, (1, 0, 0))])
        focal = 24 / math.tan(ANGLE / 2)
        for name, expected in (
            ("angle", (focal, 0, 32, 0, focal, 24, 0, 0, 1)),
            ("given", (50, 0, 30, 0, 60, 20, 0, 0, 1)),
        ):
            infos, images = self.collect(name, "CameraInfo", CameraInfo), self.collect(name, "ImageData", Image)
            harness.wait_for(lambda one=infos, two=images: len(set(one.seen) & set(two.seen)) > 2, "both of one frame")
            info = infos.seen[max(set(infos.seen) & set(images.seen))]
            image = images.seen[stamp(info)]
            self.assertEqual((info.width, info.height, info.distortion_model), (64, 48, "plumb_bob"))
            self.assertEqual((info.header.frame_id, len(info.D)), (name, 0))
            for a, b in zip(info.K, expected):
                self.assertAlmostEqual(a, b, places=9)
            self.assertEqual(tuple(info.P), (*info.K[:3], 0.0, *info.K[3:6], 0.0, *info.K[6:], 0.0))
            # A point of the scene projects where its picture is: right 0.4, down -0.3, and 1.95 ahead.
            u = info.K[0] * 0.4 / 1.95 + info.K[2]
            v = info.K[4] * -0.3 / 1.95 + info.K[5]
            self.assertEqual(name_of(pixel(image, int(u), int(v))), "red")

    def test_rows_24_and_68_without_subscriber_there_are_no_graphics(self):
        """Topics are there; a context comes with the first subscriber and goes some seconds after the last."""
        self.show([camera("cam", publish_image=True)])
        topics = [f"{CAMERAS}/cam/{last}" for last in ("ImageData", "ImageData/compressed", "CameraInfo")]
        self.simulator.wait_for_topics(*topics)
        time.sleep(1.0)
        self.assertFalse(self.has_graphics())
        listener = node.Listener(topics[0], Image)
        try:
            listener.newest()
            self.assertTrue(self.has_graphics())
            self.assertEqual(self.simulator.log().count("cameras: drawn by"), 1)
        finally:
            listener.close()
        # It is kept for 5 s, and then made anew.
        time.sleep(7.0)
        self.image("cam")
        self.assertEqual(self.simulator.log().count("cameras: drawn by"), 2)

    def test_no_pictures_can_be_made(self):
        """One line with advice, and physics goes on."""
        path = scene(f"{self.id()}.yaml", [camera("cam", publish_image=True)])
        # Libraries of OpenGL find no driver.
        broken = {"__EGL_VENDOR_LIBRARY_DIRS": "/nowhere", "LIBGL_DRIVERS_PATH": "/nowhere"}
        arguments = ("--launch_file", self.LAUNCH, "-a", path)
        self.simulator = harness.Simulator(Ros.master.port, *arguments, **broken)
        self.addCleanup(self.finish, self.simulator)
        self.simulator.wait_for_topics(f"{CAMERAS}/cam/ImageData")
        self.of("cam", "ImageData", Image)
        self.wait_for_log("cameras: no pictures")
        state = self.listen(f"{WORLD}/State", WorldState)
        first = state.newest().sim_step
        state.until(lambda now: now.sim_step > first + 500, "physics goes on")
        self.assertEqual(self.count_in_log("cameras: no pictures"), 1)

    def test_subscribers_that_hang_or_are_killed_cost_nobody_anything(self):
        """One never reads, one is killed while it reads; a third one gets its clouds all the time."""
        # Two megabytes each, more than the system holds back.
        eye = camera("cam", size=(320, 240), publish_depth=True, publish_depth_interval=1)
        self.show([eye])
        topic = f"{CAMERAS}/cam/DepthData"
        healthy = self.of("cam", "DepthData", PointCloud2)
        healthy.newest()
        alone = healthy.rate(3.0)
        address = tcpros.publisher_address(Ros.master.port, topic)
        with tcpros.subscribe(address, topic, "hanging", buffer_bytes=4096) as hanging:
            command = ["rostopic", "echo", "-n", "1000", "--noarr", topic]
            with harness.Program(command, harness.environment(Ros.master.port)) as victim:
                harness.wait_for(lambda: victim.log().count("seq:") > 2, "it reads")
                victim.process.send_signal(signal.SIGKILL)
                victim.process.wait()
            # Not at once where other programs have just taken the processor.
            harness.wait_for(lambda: healthy.rate(3.0) > 0.4 * alone, f"clouds as often as before, {alone:.1f} a second")
            # It has not been dropped: the old message, then the newest.
            first = tcpros.read_block(hanging)
            second = tcpros.read_block(hanging)
            numbers = [int.from_bytes(message[:4], "little") for message in (first, second)]
            self.assertGreater(numbers[1], numbers[0] + 5)
        healthy.next()

    def test_a_slow_callback_is_not_dropped(self):
        """It gets a recent image each time it is ready."""
        self.show([camera("cam", size=(320, 240), publish_image=True)])
        got = []

        def receive(message):
            got.append(message)
            time.sleep(0.7)

        subscriber = rospy.Subscriber(f"{CAMERAS}/cam/ImageData", Image, receive, queue_size=1, buff_size=1 << 24)
        self.addCleanup(subscriber.unregister)
        harness.wait_for(lambda: len(got) > 4, "it still gets images")

    def test_cameras_come_and_go_with_their_models(self):
        """Topics, images, and the end of both; then again."""
        self.show([camera("cam", publish_image=True)])
        add_model, remove_model = self.service("add_model", AddModel), self.service("remove_model", RemoveModel)
        path = scene("coming.yaml", [camera("late", publish_image=True)], [block("Wall", (-1.5, 0, 0), 4.0, (1, 0, 0))])
        topic = f"{CAMERAS}/late/ImageData"
        for _ in range(2):
            answer = add_model(str(path))
            self.assertTrue(answer.success, answer)
            self.simulator.wait_for_topics(topic)
            listener = node.Listener(topic, Image)
            try:
                listener.until(lambda image: name_of(pixel(image, 32, 24)) == "red", "an image of the new wall")
            finally:
                listener.close()
            self.assertTrue(remove_model(answer.model).success)
            harness.wait_for(lambda: topic not in harness.published(Ros.master.port), "the topic is gone")
        eye = self.of("cam", "ImageData", Image)
        eye.until(lambda image: name_of(pixel(image, 32, 24)) == "white", "the wall is gone")

    def test_row_53_clouds_of_clients_are_drawn(self):
        """In a body's frame, black; their size changes at once; an unknown frame is the world."""
        self.show([camera("cam", publish_image=True)], [block("Red", (0.0, 0.4, 0.3), 0.1, (1, 0, 0))])
        cloud = rospy.Publisher(f"{WORLD}/point_cloud", PointCloud, queue_size=1, latch=True)
        radius = rospy.Publisher(f"{WORLD}/point_cloud/radius", Float32, queue_size=1, latch=True)
        self.addCleanup(cloud.unregister)
        self.addCleanup(radius.unregister)
        images = self.of("cam", "ImageData", Image)
        images.newest()

        def black(image):
            """Columns and rows of black pixels."""
            places = range(64 * 48)
            found = [place for place in places if max(pixel(image, place % 64, place // 64)) < 10]
            return [place % 64 for place in found], [place // 64 for place in found]

        def middle(image):
            columns, rows = black(image)
            return columns and (sum(columns) / len(columns) + 0.5, sum(rows) / len(rows) + 0.5)

        def is_at(y, z, x):
            focal = 24 / math.tan(ANGLE / 2)
            u, v = 32 + focal * y / (2 - x), 24 - focal * z / (2 - x)

            def look(image):
                found = middle(image)
                return found and abs(found[0] - u) < 1 and abs(found[1] - v) < 1

            return look

        message = PointCloud(points=[Point32(0.2, 0.0, 0.0)])
        message.header.frame_id = "BODY Red"
        cloud.publish(message)
        big = images.until(is_at(0.4, 0.3, 0.2), "the point is before the body")
        self.assertIn(len(black(big)[0]), range(64, 145), "about 10 x 10 pixels")
        radius.publish(3.0)
        images.until(lambda image: 4 <= len(black(image)[0]) <= 16, "it becomes small at once")
        message.header.frame_id = "BODY Nowhere"
        cloud.publish(message)
        images.until(is_at(0.0, 0.0, 0.2), "the point is in the world")
        self.wait_for_log("BODY Nowhere")
        cloud.publish(message)
        images.next()
        self.assertEqual(self.count_in_log("BODY Nowhere"), 1)
        message.points = []
        cloud.publish(message)
        images.until(lambda image: not black(image)[0], "the cloud is gone")

    def test_killing_the_node_ends_the_program(self):
        """Pictures are topics of the simulator's only node."""
        self.show([camera("cam", publish_image=True)])
        self.simulator.wait_for_topics(f"{CAMERAS}/cam/ImageData")
        (name,) = harness.simulator_nodes(Ros.master.port)
        self.assertIn(f"{CAMERAS}/cam/ImageData", harness.ros(Ros.master.port, "rosnode", "info", name))
        harness.ros(Ros.master.port, "rosnode", "kill", name)
        self.assertEqual(self.simulator.status(), 0)
        self.assertEqual(harness.simulator_nodes(Ros.master.port), set())
        self._cleanups.clear()

    def test_topics_come_back_with_the_master(self):
        """A master that was restarted is told of the topics of pictures too."""
        port = harness.free_port()
        path = scene(f"{self.id()}.yaml", [camera("cam", publish_image=True)])
        topic = f"{CAMERAS}/cam/ImageData"
        with harness.Master(port) as first:
            with harness.Simulator(port, "--launch_file", self.LAUNCH, "-a", path) as simulator:
                simulator.wait_for_topics(topic)
                first.kill()
                with harness.Master(port):
                    simulator.wait_for_topics(topic)
                    environment = harness.environment(port)
                    command = ["rostopic", "echo", "-n", "1", "--noarr", topic]
                    subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL, timeout=60)
