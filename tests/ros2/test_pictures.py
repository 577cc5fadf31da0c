"""What cameras publish, and points that are drawn: `ambf_simulator --ros 2` beside rclpy."""

import io
import json
import struct
import time

import numpy
from geometry_msgs.msg import Point32
from harness import PATIENCE_S
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud, PointCloud2
from simulator import MANY, Simulated, scenes
from std_msgs.msg import Float32

CAMERA = "/ambf/env/cameras/seeing"
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
RED = {"r": 1.0, "g": 0.0, "b": 0.0}
BLACK = {"r": 0.0, "g": 0.0, "b": 0.0}


def vector(x, y, z):
    """As a scene file writes it."""
    return {"x": x, "y": y, "z": z}


def stamp(message):
    """When it was, ns."""
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def redness(image):
    """The part of an image's pixels that are red."""
    pixels = numpy.frombuffer(bytes(image.data), numpy.uint8).reshape(image.height, image.width, 3).astype(int)
    return float(numpy.mean((pixels[:, :, 0] > 150) & (pixels[:, :, 1] < 80) & (pixels[:, :, 2] < 80)))


class Seen(Simulated):
    """A camera 2 m from a cube with a side of 0.4 m that shines red."""

    def show(self, size=(64, 48), *arguments, **variables):
        """A simulator with the camera, and a client."""
        # Far above the other bodies of the scene, one of which falls.
        cube = dict(scenes.box("Red", 0.0, z=50.0, size=0.4))
        shining = {"ambient": {"level": 0.0}, "diffuse": RED, "specular": BLACK, "emission": RED, "transparency": 1.0}
        cube["color components"] = shining
        content = scenes.model({"BODY Red": cube})
        resolution = {"width": size[0], "height": size[1]}
        content["cameras"] = ["CAMERA seeing"]
        content["CAMERA seeing"] = {
            "name": "seeing",
            "namespace": "/ambf/env/cameras/",
            "location": vector(2.0, 0.0, 50.0),
            "look at": vector(0.0, 0.0, 50.0),
            "up": vector(0.0, 0.0, 1.0),
            "clipping plane": {"near": 0.1, "far": 10.0},
            "field view angle": 0.8,
            "publish image": True,
            "publish depth": True,
            "publish depth interval": 1,
            "publish image resolution": resolution,
            "publish depth resolution": resolution,
            "visible": False,
        }
        file = self.folder / "seen.yaml"
        file.write_text(json.dumps(content))
        simulator = self.simulator("--ros", "2", "-a", file, *arguments, **variables)
        return simulator, self.client()

    def test_images_show_what_is_there_and_stamps_agree(self):
        simulator, client = self.show()
        self.assertNotIn("libEGL", simulator.maps(), "nobody subscribes, nothing is drawn")
        images = client.listen(Image, f"{CAMERA}/ImageData", BEST_EFFORT)
        infos = client.listen(CameraInfo, f"{CAMERA}/CameraInfo", MANY)
        small = client.listen(CompressedImage, f"{CAMERA}/ImageData/compressed", MANY)
        client.wait_for(lambda: len(images) > 5 and len(infos) > 5 and len(small) > 5, "pictures")
        client.wait_for(lambda: redness(images[-1]) > 0.0, "what was loaded is drawn")
        image = images[-1]
        self.assertEqual((image.width, image.height, image.encoding, image.step), (64, 48, "rgb8", 192))
        self.assertEqual(image.header.frame_id, "seeing")
        self.assertAlmostEqual(image.header.stamp.sec, time.time(), delta=PATIENCE_S)
        # The cube's face fills (0.4 / 1.8 / (2 tan 0.4))^2 of the height, and 3/4 as much of the width.
        self.assertAlmostEqual(redness(image), 0.75 * (0.4 / 1.8 / 0.8456) ** 2, delta=0.02)
        info = infos[-1]
        self.assertEqual((info.width, info.height, info.distortion_model), (64, 48, "plumb_bob"))
        self.assertAlmostEqual(info.k[0], 24 / 0.42279, delta=0.01)
        self.assertEqual(small[-1].format, "rgb8; jpeg compressed bgr8")
        self.assertEqual(bytes(small[-1].data[:2]), b"\xff\xd8")
        self.assertTrue(io.BytesIO(bytes(small[-1].data)).read().endswith(b"\xff\xd9"), "a whole file")
        # Images are best effort: on a busy machine some of them are lost.
        client.wait_for(
            lambda: len({stamp(m) for m in images} & {stamp(m) for m in infos} & {stamp(m) for m in small}) > 2,
            "what is made of one picture has one stamp",
        )

    def test_depth_is_in_metres(self):
        _, client = self.show()
        clouds = client.listen(PointCloud2, f"{CAMERA}/DepthData", MANY)
        depths = client.listen(Image, f"{CAMERA}/DepthImage", MANY)
        middle = 4 * (24 * 64 + 32)

        def nearness():
            return struct.unpack("<f", bytes(depths[-1].data[middle : middle + 4]))[0] if clouds and depths else None

        # In the first pictures not everything is loaded yet.
        client.wait_for(lambda: nearness() is not None and abs(nearness() - 1.8) < 0.01, "the face of the cube is seen")
        depth = depths[-1]
        client.wait_for(lambda: stamp(clouds[-1]) >= stamp(depth), "the cloud of that picture, or a later one")
        cloud = clouds[-1]
        self.assertEqual((cloud.width, cloud.height, cloud.point_step), (64 * 48, 1, 32))
        self.assertEqual([field.name for field in cloud.fields], ["x", "y", "z", "rgb"])
        self.assertEqual((depth.width, depth.height, depth.encoding), (64, 48, "32FC1"))
        x, _, _ = struct.unpack("<3f", bytes(cloud.data[32 * (24 * 64 + 32) :][:12]))
        self.assertAlmostEqual(x, -1.8, delta=0.01)

    def test_large_images_bring_advice_once_and_smaller_ones_do_not(self):
        simulator, client = self.show((400, 300))
        small = client.listen(CompressedImage, f"{CAMERA}/ImageData/compressed", MANY)
        client.wait_for(lambda: len(small) > 3, "compressed images")
        self.assertNotIn("receive buffer", simulator.log())
        client.listen(Image, f"{CAMERA}/ImageData", BEST_EFFORT)
        advice = f"{CAMERA}/ImageData: messages of 360 kB"
        client.wait_for(lambda: advice in simulator.log(), "advice")
        count = len(small)
        client.wait_for(lambda: len(small) > count + 5, "compressed images beside large ones")
        self.assertEqual(simulator.log().count(advice), 1)
        self.assertIn("subscribe to ImageData/compressed, or", simulator.log())

    def test_nothing_is_drawn_when_the_subscriber_is_gone(self):
        simulator, client = self.show()
        images = client.listen(Image, f"{CAMERA}/ImageData", MANY)
        client.wait_for(lambda: len(images) > 3, "images")
        for subscription in list(client.node.subscriptions):
            client.node.destroy_subscription(subscription)

        def stands():
            before = simulator.ticks("cameras")
            time.sleep(0.5)
            return simulator.ticks("cameras") == before

        client.wait_for(stands, "the end of drawing")

    def test_stamps_are_simulated_time_where_there_is_a_clock(self):
        _, client = self.show((64, 48), "--clock")
        images = client.listen(Image, f"{CAMERA}/ImageData", MANY)
        client.wait_for(lambda: len(images) > 3, "images")
        self.assertLess(images[-1].header.stamp.sec, 2 * PATIENCE_S)

    def test_points_that_clients_send_are_drawn(self):
        """On the topic that is there, and on one that the parameter of the world names instead."""
        _, client = self.show()
        images = client.listen(Image, f"{CAMERA}/ImageData", MANY)
        client.wait_for(lambda: images and redness(images[-1]) > 0.03, "the cube")
        node, name, first = "/ambf_env_World", "/ambf/env/World/point_cloud_topics", "/ambf/env/World/point_cloud"

        def topics():
            answer = client.call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=[name]))
            return list(answer.values[0].string_array_value)

        def result(names):
            value = ParameterValue(type=ParameterType.PARAMETER_STRING_ARRAY, string_array_value=names)
            request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
            return client.call(SetParameters, f"{node}/set_parameters", request).results[0]

        def hides_the_cube(topic):
            points = client.node.create_publisher(PointCloud, topic, 1)
            radius = client.node.create_publisher(Float32, f"{topic}/radius", 1)
            cloud = PointCloud(points=[Point32(x=1.0, z=50.0)])

            def hidden():
                points.publish(cloud)
                radius.publish(Float32(data=60.0))
                return redness(images[-1]) < 0.01

            client.wait_for(hidden, f"points of {topic} before the cube")

        self.assertEqual(topics(), [first])
        hides_the_cube(first)
        self.assertTrue(result(["/other"]).successful)
        self.assertEqual(topics(), ["/other"])
        client.wait_for(lambda: redness(images[-1]) > 0.03, "the cube without points")
        hides_the_cube("/other")
        for wrong in (["/a b"], ["relative"], [f"/t{number}" for number in range(101)]):
            self.assertFalse(result(wrong).successful)
        self.assertEqual(topics(), ["/other"])
