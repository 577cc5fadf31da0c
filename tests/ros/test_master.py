"""ROS masters that come, go, are missing or are not wanted."""

import signal
import sys
import time
import unittest

import harness
import yaml
from scenes import WORLD

BODY = "/ambf/env/Free"
LAUNCH = ("--launch_file", harness.scene / "launch.yaml", "-l0,1")


def echo(port, topic):
    """One message, or the value of one field, as Python data."""
    return yaml.safe_load(harness.ros(port, "rostopic", "echo", "-n", "1", topic).split("---")[0])


def stamp(state):
    """System time of a state, s, as the simulator says."""
    time_s = state["header"]["stamp"]
    return time_s["secs"] + 1e-9 * time_s["nsecs"]


class RosMaster(harness.Program):
    """The bare master, which can be killed and come back on the same port."""

    def __init__(self, port):
        super().__init__(["rosmaster", "--core", "-p", port], harness.environment(port))
        harness.wait_for(lambda: harness.state_of(port) is not None, "rosmaster answers")


def run_client(port):
    """A rospy script reads states and drives a joint and a body."""
    client = [sys.executable, harness.REPOSITORY / "tests/ros/client.py"]
    with harness.Program(client, harness.environment(port)) as program:
        status = program.status()
        assert (status, program.log().split()[::2]) == (0, ["Base", "Wall"]), (status, program.log())


class Real(harness.RosTest):
    """`roscore` runs already."""

    def test_a_script(self):
        """It meets the simulator there, and no second master is started."""
        with harness.Simulator(self.port, *LAUNCH) as simulator:
            run_client(self.port)
            self.assertEqual(simulator.interrupt(), 0)
            self.assertNotIn("started one", simulator.log())


    def test_rosnode_kill(self):
        """The simulation goes on without ROS."""
        with harness.Simulator(self.port, *LAUNCH) as simulator:
            simulator.wait_for_topics(f"{BODY}/State")
            (name,) = harness.simulator_nodes(self.port)
            harness.ros(self.port, "rosnode", "kill", name)
            harness.wait_for(lambda: not harness.simulator_nodes(self.port), "the node is gone")
            harness.wait_for(lambda: "goes on without ROS" in simulator.log(), "the simulator says so")
            self.assertTrue(simulator.running())
            self.assertEqual(simulator.interrupt(), 0)


class Embedded(unittest.TestCase):
    """Nobody listens at the local ROS_MASTER_URI: the simulator brings its own master."""

    def test_tools_and_clients(self):
        """ROS's own programs work with it."""
        port = harness.free_port()
        with harness.Simulator(port, *LAUNCH) as simulator:
            simulator.wait_for_topics(f"{WORLD}/State", f"{BODY}/State")
            self.assertIn(f"{BODY}/Command", harness.ros(port, "rostopic", "list").split())
            self.assertEqual(harness.ros(port, "rostopic", "type", f"{BODY}/State").strip(), "ambf_msgs/RigidBodyState")
            self.assertEqual(echo(port, f"{BODY}/State")["name"]["data"], "Free")
            self.assertTrue(any("ambf_comm_node" in name for name in harness.ros(port, "rosnode", "list").split()))
            self.assertIn("/ambf/env/World/point_cloud_topics", harness.ros(port, "rosparam", "list").split())
            harness.ros(port, "rosparam", "set", "/mine", "3")
            self.assertEqual(harness.ros(port, "rosparam", "get", "/mine").strip(), "3")
            command = [
                "rostopic",
                "pub",
                "-r",
                "20",
                f"{BODY}/Command",
                "ambf_msgs/RigidBodyCmd",
                "{wrench: {force: {y: 2.0}}}",
            ]
            with harness.Program(command, harness.environment(port)):
                harness.wait_for(lambda: echo(port, f"{BODY}/State")["twist"]["linear"]["y"] > 0.1, "the body moves")
            with harness.Program(["rostopic", "hz", f"{BODY}/State"], harness.environment(port)) as tool:
                harness.wait_for(lambda: "average rate" in tool.log(), "rostopic hz counts")
            run_client(port)
            self.assertEqual(simulator.interrupt(), 0)
        self.assertIsNone(harness.state_of(port))

    def test_a_second_simulator_joins_it(self):
        """The first one's master serves the second."""
        port = harness.free_port()
        with harness.Simulator(port, *LAUNCH) as first:
            first.wait_for_topics(f"{BODY}/State")
            with harness.Simulator(port, *LAUNCH, "--ns", "/two") as second:
                second.wait_for_topics(f"/two{BODY}/State", f"{BODY}/State")


class Lost(unittest.TestCase):
    """The master dies and comes back."""

    def test_everything_registers_again(self):
        """Within seconds, with the simulation going on all the while; twice in a row."""
        port = harness.free_port()
        topics = (f"{WORLD}/State", f"{BODY}/State", "/ambf/env/Base/State")
        master = RosMaster(port)
        self.addCleanup(lambda: master.running() and master.kill())
        with harness.Simulator(port, *LAUNCH) as simulator:
            simulator.wait_for_topics(*topics)
            took = []
            for _ in range(2):
                before = echo(port, f"{WORLD}/State")
                master.process.send_signal(signal.SIGKILL)
                master.process.wait()
                harness.wait_for(lambda: harness.state_of(port) is None, "the master is gone")
                master = RosMaster(port)
                back = time.monotonic()
                simulator.wait_for_topics(*topics)
                harness.wait_for(
                    lambda: f"{BODY}/Command" in {name for name, _ in harness.state_of(port)[1]}, "Command"
                )
                took.append(time.monotonic() - back)
                after = echo(port, f"{WORLD}/State")
                self.assertEqual(len(harness.simulator_nodes(port)), 1)
                passed = after["sim_time"] - before["sim_time"]
                self.assertGreater(passed, 0.0)
                self.assertLess(abs(passed - (stamp(after) - stamp(before))), 3.0)
                command = [
                    "rostopic",
                    "pub",
                    "-r",
                    "20",
                    f"{BODY}/Command",
                    "ambf_msgs/RigidBodyCmd",
                    "{cartesian_cmd_type: 2, twist: {linear: {y: 0.25}}}",
                ]
                with harness.Program(command, harness.environment(port)):
                    harness.wait_for(
                        lambda: echo(port, f"{BODY}/State")["twist"]["linear"]["y"] == 0.25, "commands arrive"
                    )
            # Promised are 5 s; a busy machine may spoil one of the two.
            self.assertLess(min(took), 5.0, took)
            self.assertEqual(simulator.interrupt(), 0)
            self.assertFalse([name for name in harness.published(port) if name.startswith("/ambf")])

    def test_it_may_stay_away(self):
        """Ctrl+C works without a master too."""
        port = harness.free_port()
        master = RosMaster(port)
        with harness.Simulator(port, *LAUNCH) as simulator:
            simulator.wait_for_topics(f"{WORLD}/State")
            master.kill()
            self.assertEqual(simulator.interrupt(), 0)


class Absent(unittest.TestCase):
    """No ROS, or none within reach."""

    def stays_silent(self, port, *arguments, **env):
        """The simulator runs for a while, registers nothing at `port` and ends well; returns its output."""
        with harness.Simulator(port, *LAUNCH, *arguments, **env) as simulator:
            harness.wait_for(simulator.log, "a first line of output")
            end = time.monotonic() + 4.0
            while time.monotonic() < end:
                self.assertTrue(simulator.running(), simulator.log())
                self.assertEqual({name for name in harness.published(port) if name.startswith("/ambf")}, set())
                time.sleep(0.1)
            self.assertEqual(simulator.interrupt(), 0)
            return simulator.log()

    def test_not_wanted(self):
        """`--no_ros` uses no master and starts none."""
        port = harness.free_port()
        with RosMaster(port):
            self.stays_silent(port, "--no_ros")
        self.stays_silent(port, "--no_ros")
        self.assertIsNone(harness.state_of(port))

    def test_remote_master_that_does_not_answer(self):
        """It is named, and the simulation goes on."""
        port = harness.free_port()
        # An address that is reserved for documentation.
        log = self.stays_silent(port, ROS_MASTER_URI="http://192.0.2.1:11311", ROS_HOSTNAME="localhost")
        self.assertIn("192.0.2.1", log)

    def test_address_that_is_none(self):
        """The same."""
        port = harness.free_port()
        log = self.stays_silent(port, ROS_MASTER_URI="certainly not an address")
        self.assertIn("certainly not an address", log)
