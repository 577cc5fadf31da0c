"""Cuts of the shipped phantom over ROS 2: `ambf_simulator --ros 2` beside rclpy."""

import math

from ambf_msgs.msg import RigidBodyCmd, RigidBodyState, VolumeCmd
from geometry_msgs.msg import WrenchStamped
from harness import REPOSITORY
from rclpy.qos import DurabilityPolicy, QoSProfile
from simulator import MANY, Simulated, scenes
from std_msgs.msg import Bool, Empty, UInt8
from volumetric_drilling_msgs.msg import DrillSize, Index, VolumeInfo, Voxels

PLUGIN = "/ambf/env/plugin/volumetric_drilling"
WORLD = "/ambf/env/World"
COUNT = (96, 80, 64)
EDGE = 0.25e-3


def centre(index):
    """Of a voxel, in the volume's frame, m."""
    return tuple((i + 0.5 - 0.5 * count) * EDGE for i, count in zip(index, COUNT))


class Cut(Simulated):
    """Tests that are told what is cut, in the shipped scene of a drill above a phantom."""

    FOLDER = REPOSITORY / "resources/drill"
    VOLUME = "phantom"

    def launch_file(self):
        """What is simulated."""
        return self.FOLDER / "launch.yaml"

    def setUp(self):
        super().setUp()
        self.simulator("--ros", "2", scene=(self.launch_file(), 0))
        self.node = self.client()
        self.messages = self.node.listen(Voxels, f"{PLUGIN}/voxels_removed", MANY)
        self.told = {}
        self.read = 0
        publishers = self.node.node.count_publishers
        self.node.wait_for(lambda: publishers(f"{PLUGIN}/voxels_removed") == 1, "the simulator tells of cuts")

    def voxels(self):
        """Colours of 255 by index; a voxel that is told twice is a failure."""
        new, self.read = self.messages[self.read :], len(self.messages)
        for message in new:
            self.assertEqual(message.header.frame_id, f"/ambf/env/VOLUME {self.VOLUME}")
            self.assertEqual(len(message.indices), len(message.colors))
            for index, color in zip(message.indices, message.colors):
                self.assertNotIn((index.x, index.y, index.z), self.told)
                levels = (color.r, color.g, color.b, color.a)
                self.told[index.x, index.y, index.z] = tuple(round(255 * level) for level in levels)
        return self.told

    def publisher(self, topic, kind):
        """A publisher to which the simulator listens."""
        publisher = self.node.node.create_publisher(kind, topic, 10)
        self.node.wait_for(lambda: publisher.get_subscription_count() == 1, f"a subscription of {topic}")
        return publisher

    def until_cut(self, publish, count, what):
        """Publishes until as many voxels are told: the first cut may come before the two have met."""

        def is_cut():
            publish()
            return len(self.voxels()) >= count

        self.node.wait_for(is_cut, what)


class Phantom(Cut):
    """The shipped scene."""

    def test_cuts_are_told_and_come_back_with_a_reset(self):
        infos = self.node.listen(VolumeInfo, f"{PLUGIN}/volume_info", MANY)
        self.node.wait_for(lambda: infos, "where the volume is")
        self.assertEqual(tuple(infos[0].voxel_count), COUNT)
        carve = self.publisher(f"{WORLD}/Command/Carve", VolumeCmd)
        reset = self.publisher(f"{WORLD}/Command/Reset/Volumes", Empty)
        at = centre((40, 36, 27))
        command = VolumeCmd(volume="phantom", shape="sphere", size=[0.001], frame="volume")
        for pose in (command.start, command.end):
            pose.position.x, pose.position.y, pose.position.z = at

        def cut():
            reset.publish(Empty())
            carve.publish(command)

        # Without the reset, voxels that went before the two have met would never be told.
        first = []

        def is_told():
            if not self.messages:
                cut()
                return False
            first[:] = [index for message in self.messages[:1] for index in message.indices]
            return len(first) > 200

        self.node.wait_for(is_told, "a cut")
        self.assertLess(len(first), 330)
        for index in first:
            self.assertLessEqual(math.dist(centre((index.x, index.y, index.z)), at), 0.001 + 1e-9)

    def test_a_voxel_goes_by_its_index(self):
        remove = self.publisher(f"{PLUGIN}/remove_voxels", Index)
        row = iter(range(2, 78))
        self.until_cut(lambda: remove.publish(Index(x=2, y=next(row), z=20)), 3, "voxels go")
        self.assertEqual(set(self.voxels().values()), {(255, 249, 219, 255)})
        self.assertTrue(all((x, z) == (2, 20) for x, _, z in self.voxels()))

    def test_a_client_drills(self):
        states = self.node.listen(RigidBodyState, "/ambf/env/drill/State", MANY)
        command = self.publisher("/ambf/env/drill/Command", RigidBodyCmd)
        self.node.wait_for(lambda: states, "a state")
        down = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_POSITION)
        down.pose.position.z, down.pose.orientation.w = 0.0055, 1.0
        self.until_cut(lambda: command.publish(down), 300, "the drill cuts")
        # It may slide along the bone; its burr has a radius of 2 mm.
        ways = [(state.pose.position.x, state.pose.position.y) for state in states]
        for index in self.voxels():
            self.assertLess(min(math.dist(centre(index)[:2], way) for way in ways), 0.0035)


class Drill(Cut):
    """A launch file of the C++ drilling plugin: what is part of the program takes its place."""

    VOLUME = "temporal_bone"

    def launch_file(self):
        folder = self.folder / "drill"
        scenes.drill(folder, self.FOLDER / "phantom.nrrd")
        return folder / "launch.yaml"

    def test_it_is_led_switched_and_changed_by_topics(self):
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        sizes = self.node.listen(DrillSize, f"{PLUGIN}/drill_size", latched)
        self.node.wait_for(lambda: sizes, "the size of the burr")
        self.assertEqual(sizes[0].size.data, 6)
        forces = self.node.listen(WrenchStamped, f"{PLUGIN}/drill_force_feedback", MANY)
        switch = self.publisher(f"{PLUGIN}/set_drill_on", Bool)
        lead = self.publisher("/ambf/env/mastoidectomy_drill/Command", RigidBodyCmd)
        down = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_POSITION)
        down.pose.position.z, down.pose.orientation.w = 0.0095, 1.0
        switch.publish(Bool(data=False))

        def is_held():
            lead.publish(down)
            return forces and forces[-1].wrench.force.z > 0.3

        self.node.wait_for(is_held, "the drill is held")
        self.assertEqual(self.voxels(), {})
        switch.publish(Bool(data=True))
        self.node.wait_for(lambda: len(self.voxels()) > 150, "it cuts")
        change = self.publisher(f"{PLUGIN}/set_drill_size", UInt8)
        change.publish(UInt8(data=4))
        self.node.wait_for(lambda: sizes[-1].size.data == 4, "the other burr")
