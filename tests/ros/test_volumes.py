"""A rospy client cuts the phantom of the shipped drill, is told what went, and drills it; also as the C++ drilling plugin has it."""

import math

import harness
import node
import rospy
import scenes
from ambf_msgs.msg import RigidBodyCmd, RigidBodyState, VolumeCmd
from geometry_msgs.msg import WrenchStamped
from simulated import RESOURCES, WORLD, Ros, Simulated
from std_msgs.msg import Bool, UInt8
from volumetric_drilling_msgs.msg import DrillSize, Index, VolumeInfo, Voxels

FOLDER = RESOURCES / "drill"
PLUGIN = "/ambf/env/plugin/volumetric_drilling"
COUNT = (96, 80, 64)
EDGE = 0.25e-3
# Colours of the phantom's segments, of 255.
CORTICAL, NERVE = (255, 249, 219, 255), (255, 217, 26, 255)

setUpModule, tearDownModule = Ros.start, Ros.stop


def centre(index):
    """Of a voxel, in the volume's frame, m."""
    return tuple((i + 0.5 - 0.5 * count) * EDGE for i, count in zip(index, COUNT))


def ball(at, radius=0.001, **fields):
    """A cut of a ball at `at`, in the volume's frame."""
    command = VolumeCmd(volume="phantom", shape="sphere", size=[radius], frame="volume", **fields)
    for pose in (command.start, command.end):
        pose.position.x, pose.position.y, pose.position.z = at
    return command


class Cuts:
    """All voxels that were told: colours of 255 by index."""

    def __init__(self):
        self.voxels = {}
        self.frames = set()
        self.twice = 0
        self._subscriber = rospy.Subscriber(f"{PLUGIN}/voxels_removed", Voxels, self._receive, queue_size=1000)
        harness.wait_for(self._subscriber.get_num_connections, "the simulator tells of cuts")

    def _receive(self, message):
        assert len(message.indices) == len(message.colors)
        self.frames.add(message.header.frame_id)
        for index, color in zip(message.indices, message.colors):
            place = (index.x, index.y, index.z)
            self.twice += place in self.voxels
            self.voxels[place] = tuple(round(255 * level) for level in (color.r, color.g, color.b, color.a))

    def close(self):
        """Unsubscribes."""
        self._subscriber.unregister()


class Cut(Simulated):
    """Tests that are told what is cut."""

    def setUp(self):
        super().setUp()
        self.cuts = Cuts()
        self.addCleanup(self.cuts.close)

    def publisher(self, topic, kind):
        """A publisher to which the simulator listens."""
        publisher = rospy.Publisher(topic, kind, queue_size=10)
        self.addCleanup(publisher.unregister)
        harness.wait_for(publisher.get_num_connections, f"the simulator listens to {topic}")
        return publisher

    def count(self):
        """How many voxels were told so far, when no more come."""
        before, count = None, 0
        while before != count:
            before = count
            self.pass_time(0.1)
            count = len(self.cuts.voxels)
        return count


class Phantom(Cut):
    """The shipped scene."""

    LAUNCH = FOLDER / "launch.yaml"
    FILES = (FOLDER / "drill.yaml",)

    def test_the_volume_is_where_its_file_says(self):
        info = self.listen(f"{PLUGIN}/volume_info", VolumeInfo).newest()
        self.assertEqual(info.voxel_count, COUNT)
        for edge, count in zip(info.dimensions, COUNT):
            self.assertAlmostEqual(edge, count * EDGE, places=7)
        at, turn = info.pose.position, info.pose.orientation
        self.assertEqual((at.x, at.y, at.z, turn.w), (0.0, 0.0, 0.0, 1.0))
        self.assertTrue(info.header.frame_id.endswith("VOLUME phantom"), info.header.frame_id)

    def test_a_cut_is_told_voxel_by_voxel_and_a_reset_brings_all_back(self):
        carve = self.publisher(f"{WORLD}/Command/Carve", VolumeCmd)
        # The nerve passes here.
        at = centre((40, 36, 27))
        carve.publish(ball(at))
        # 4/3 π 4³ of its edge are 268.
        harness.wait_for(lambda: len(self.cuts.voxels) > 200, "the ball is cut")
        first = self.count()
        self.assertLess(first, 330)
        for index in self.cuts.voxels:
            self.assertLessEqual(math.dist(centre(index), at), 0.001 + 1e-9)
        self.assertIn(NERVE, self.cuts.voxels.values())
        self.assertEqual(self.cuts.frames, {"/ambf/env/VOLUME phantom"})
        # What is gone is not told again; with a reset it comes back, and goes once more.
        carve.publish(ball(at))
        self.assertEqual((self.count(), self.cuts.twice), (first, 0))
        self.reset("Reset/Volumes")
        self.pass_time(0.2)
        carve.publish(ball(at))
        harness.wait_for(lambda: self.cuts.twice == first, "the same ball is cut again")
        self.assertEqual(self.count(), first)

    def test_a_count_takes_the_nearest_and_a_box_all(self):
        carve = self.publisher(f"{WORLD}/Command/Carve", VolumeCmd)
        at = centre((20, 20, 20))
        carve.publish(ball(at, rule="count", amount=7))
        harness.wait_for(lambda: self.cuts.voxels, "a cut")
        self.assertEqual(self.count(), 7)
        self.assertIn((20, 20, 20), self.cuts.voxels)
        for index in self.cuts.voxels:
            self.assertLessEqual(math.dist(index, (20, 20, 20)), 1.0)
        # Around a corner of voxels, 4 x 2 x 2 of them.
        command = ball(tuple(a + 0.5 * EDGE for a in centre((60, 40, 15))))
        command.shape, command.size = "box", [4 * EDGE, 2 * EDGE, 2 * EDGE]
        carve.publish(command)
        harness.wait_for(lambda: len(self.cuts.voxels) > 7, "a box")
        self.assertEqual(self.count(), 7 + 4 * 2 * 2)
        self.assertIn((62, 41, 16), self.cuts.voxels)

    def test_a_voxel_goes_by_its_index(self):
        remove = self.publisher(f"{PLUGIN}/remove_voxels", Index)
        remove.publish(Index(x=2, y=40, z=20))
        harness.wait_for(lambda: self.cuts.voxels, "a cut")
        remove.publish(Index(x=500, y=-1, z=20))
        self.count()
        self.assertEqual(self.cuts.voxels, {(2, 40, 20): CORTICAL})

    def test_what_cannot_be_cut_is_named(self):
        carve = self.publisher(f"{WORLD}/Command/Carve", VolumeCmd)
        carve.publish(ball((0, 0, 0), rule="some"))
        self.wait_for_log("rule `some`: all, rate, or count with an amount; it is ignored")
        self.assertEqual(self.count(), 0)

    def test_a_client_drills(self):
        """The drill is led down, cuts what its tip touches, and nothing else."""
        drill = self.listen("/ambf/env/drill/State", RigidBodyState)
        command = self.publisher("/ambf/env/drill/Command", RigidBodyCmd)
        down = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_POSITION)
        down.pose.position.z, down.pose.orientation.w = 0.0055, 1.0
        ways = []

        def is_deep():
            state = drill.newest()
            ways.append((state.pose.position.x, state.pose.position.y))
            command.publish(down)
            return len(self.cuts.voxels) > 300

        harness.wait_for(is_deep, "the drill cuts")
        voxels = list(self.cuts.voxels)
        # It may slide along the bone; its burr has a radius of 2 mm.
        for index in voxels:
            self.assertLess(min(math.dist(centre(index)[:2], way) for way in ways), 0.0035)
        self.assertTrue(set(self.cuts.voxels.values()) >= {CORTICAL})
        self.assertEqual(self.cuts.twice, 0)


class Drill(Cut):
    """A launch file of the C++ drilling plugin: what is part of the program takes its place."""

    def setUp(self):
        folder = harness.folder / self.id()
        scenes.drill(folder, FOLDER / "phantom.nrrd")
        self.LAUNCH, self.FILES = folder / "launch.yaml", (folder / "drill.yaml",)
        super().setUp()

    def test_it_is_led_switched_and_changed_by_topics(self):
        self.assertEqual(self.count_in_log("is left out"), 0, self.simulator.log())
        size = self.listen(f"{PLUGIN}/drill_size", DrillSize)
        self.assertEqual(size.newest().size.data, 6)
        force = self.listen(f"{PLUGIN}/drill_force_feedback", WrenchStamped)
        shown = self.listen("/ambf/env/6mm/State", RigidBodyState)
        switch = self.publisher(f"{PLUGIN}/set_drill_on", Bool)
        switch.publish(Bool(data=False))
        down = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_POSITION)
        # The phantom's top is at about 7.3 mm, the burr has a radius of 3 mm.
        down.pose.position.z, down.pose.orientation.w = 0.0095, 1.0
        with node.Stream("/ambf/env/mastoidectomy_drill/Command", down):
            pushed = force.until(lambda wrench: wrench.wrench.force.z > 0.3, "the drill is held")
            self.assertEqual((pushed.wrench.torque.x, pushed.wrench.torque.y, pushed.wrench.torque.z), (0.0, 0.0, 0.0))
            self.assertGreater(shown.next().pose.position.z, 0.0098)
            self.assertEqual(self.count(), 0)
            switch.publish(Bool(data=True))
            harness.wait_for(lambda: len(self.cuts.voxels) > 150, "it cuts")
            force.until(lambda wrench: wrench.wrench.force.z < 0.05, "it has come where it is led")
        change = self.publisher(f"{PLUGIN}/set_drill_size", UInt8)
        change.publish(UInt8(data=4))
        size.until(lambda message: message.size.data == 4, "the other burr")
        change.publish(UInt8(data=5))
        self.wait_for_log("no burr of this tool")
        self.assertEqual(size.newest().size.data, 4)
