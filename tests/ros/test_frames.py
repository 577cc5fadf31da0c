"""What ROS programs expect beside states: tf, a robot description, simulated time, a launch file, diagnostics of devices."""

import pathlib
import subprocess
import xml.etree.ElementTree

import harness
import node
import rospy
from ambf_msgs.msg import RigidBodyState, WorldCmd
from ambf_msgs.srv import AddModel, RemoveModel
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from poses import angle, distance, pose_of
from rosgraph_msgs.msg import Clock
from scenes import box, model
from simulated import MODELS, RESOURCES, WORLD, Ros, Simulated, written
from tf2_msgs.msg import TFMessage

TOOL = "ambf/env/psm/tool"

setUpModule, tearDownModule = Ros.start, Ros.stop


def transforms(message):
    """By the name of their child: where it is in the world."""
    return {
        transform.child_frame_id: (
            [transform.transform.translation.x, transform.transform.translation.y, transform.transform.translation.z],
            [getattr(transform.transform.rotation, axis) for axis in "xyzw"],
        )
        for transform in message.transforms
    }


def seconds(stamp):
    """Of a ROS time."""
    return stamp.secs + stamp.nsecs * 1e-9


class Frames(Simulated):
    """The shipped arm, with tf."""

    FILES = (MODELS / "psm.yaml", MODELS / "arm7.yaml")
    ARGUMENTS = ("--tf=100", "robot_description:=/told/description")

    def description(self):
        """The parameter, as XML; `None` while it is not there."""
        try:
            return xml.etree.ElementTree.fromstring(rospy.get_param("/told/description"))
        except KeyError:
            return None

    def links(self):
        """Of the description."""
        described = self.description()
        return {link.get("name") for link in described.iter("link")} if described is not None else set()

    def test_frames_are_where_the_states_are(self):
        """Of one step: the same stamp and pose."""
        states, told = {}, {}
        subscribers = [
            rospy.Subscriber(f"/{TOOL}/State", RigidBodyState, lambda state: states.setdefault(state.header.stamp, state)),
            rospy.Subscriber("/tf", TFMessage, lambda message: told.setdefault(message.transforms[0].header.stamp, message)),
        ]
        stamp = harness.wait_for(lambda: set(states) & set(told), "a state and a transform of one step").pop()
        for subscriber in subscribers:
            subscriber.unregister()
        found, expected = transforms(told[stamp])[TOOL], pose_of(states[stamp].pose)
        self.assertLess(distance(found[0], expected[0]), 1e-9)
        self.assertLess(angle(found[1], expected[1]), 1e-6)
        self.assertEqual({transform.header.frame_id for transform in told[stamp].transforms}, {"world"})

    def test_every_link_has_a_frame_and_every_mesh_is_there(self):
        """As rviz needs it."""
        described = harness.wait_for(self.description, "the parameter")
        names = transforms(self.listen("/tf", TFMessage).newest())
        self.assertEqual(self.links(), {"world", *names})
        meshes = [mesh.get("filename").removeprefix("file://") for mesh in described.iter("mesh")]
        self.assertTrue(meshes and all(pathlib.Path(mesh).is_file() for mesh in meshes), meshes)
        file = written("described.urdf", {})
        file.write_text(rospy.get_param("/told/description"))
        read = subprocess.run(["check_urdf", file], capture_output=True, text=True)
        self.assertEqual(read.returncode, 0, read.stdout + read.stderr)
        kinds = [joint.get("type") for joint in described.iter("joint")]
        self.assertGreaterEqual(kinds.count("revolute"), 5)
        self.assertGreaterEqual(kinds.count("prismatic"), 1)

    def test_models_that_come_and_go(self):
        """Frames and description follow."""
        harness.wait_for(self.description, "the parameter")
        add, remove = self.service("add_model", AddModel), self.service("remove_model", RemoveModel)
        answer = add(str(written("guest.yaml", model({"BODY Guest": box("Guest", 1.0, z=3.0)}))))
        self.assertTrue(answer.success, answer)
        frames = self.listen("/tf", TFMessage)
        frames.until(lambda message: "ambf/env/Guest" in transforms(message), "its frame")
        harness.wait_for(lambda: "ambf/env/Guest" in self.links(), "its link")
        self.assertTrue(remove(answer.model).success)
        frames.until(lambda message: "ambf/env/Guest" not in transforms(message), "no frame")
        harness.wait_for(lambda: "ambf/env/Guest" not in self.links(), "no link")


class Time(Simulated):
    """Simulated time for all."""

    FILES = (MODELS / "pendulum.yaml",)
    ARGUMENTS = ("--clock",)

    def test_stamps_are_simulated_time(self):
        """Those of states and of the clock, which stands while the simulation does."""
        clock = self.listen("/clock", Clock)
        state = self.world.next()
        self.assertAlmostEqual(seconds(state.header.stamp), state.sim_time, delta=1e-4 * max(state.sim_time, 1.0))
        first = clock.newest()
        later = clock.until(lambda message: message.clock > first.clock, "it goes on")
        self.assertLess(seconds(later.clock), 600.0, "time since the start")
        with node.Stream(f"{WORLD}/Command", WorldCmd(enable_step_throttling=True, n_skip_steps=1)):
            self.world.until(lambda _: self.world.next().sim_step == self.world.next().sim_step, "it stands")
            stopped = clock.next()
            self.assertTrue(all(clock.next().clock == stopped.clock for _ in range(20)))


class Launched(harness.RosTest):
    """The simulator started by roslaunch."""

    def test_launch_file(self):
        """Its arguments become the simulator's; the node has the name that it gives; Ctrl+C ends both."""
        env = harness.environment(Ros.master.port, AMBF_SIMULATOR=str(harness.simulator_path()))
        arguments = [f"models:={MODELS / 'pendulum.yaml'}", f"launch_file:={RESOURCES / 'launch.yaml'}", "gui:=false", "tf:=20"]
        with harness.Program(["roslaunch", "ambf_simulator", "simulator.launch", *arguments], env) as launched:
            harness.wait_for(lambda: "/ambf_simulator" in harness.nodes(Ros.master.port), "the node")
            listener = node.Listener("/tf", TFMessage)
            listener.newest()
            listener.close()
            harness.wait_for(lambda: rospy.has_param("/robot_description"), "the description")
            self.assertEqual(launched.interrupt(), 0, launched.log())
            self.assertNotIn("panicked", launched.log())
        harness.wait_for(lambda: "/ambf_simulator" not in harness.nodes(Ros.master.port), "the node is gone")

    def test_a_missing_program_is_named(self):
        """With what to do about it."""
        script = RESOURCES / "ros/ambf_simulator/scripts/ambf_simulator"
        done = subprocess.run([script], env={"PATH": "/usr/bin:/bin", "AMBF_SIMULATOR": "/nowhere/x"}, capture_output=True, text=True)
        self.assertEqual(done.returncode, 1)
        self.assertIn("/nowhere/x", done.stderr)


class Devices(Simulated):
    """A device that is no hardware."""

    FILES = (MODELS / "pendulum.yaml",)
    ARGUMENTS = ("-i", "5")

    def test_reports(self):
        """The number of devices is in the world's state, how each is in the diagnostics."""
        self.world.until(lambda state: state.n_devices == 1, "one device")
        told = self.listen("/diagnostics", DiagnosticArray)
        message = told.until(lambda message: len(message.status) == 2, "two reports")
        status = message.status[1]
        self.assertTrue(status.name.startswith("ambf_simulator: device "), status)
        told.until(lambda message: message.status[1].level == DiagnosticStatus.OK, "it runs")
        self.assertIn("loop, Hz", {value.key for value in status.values})
