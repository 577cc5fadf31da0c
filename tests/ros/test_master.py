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
        """It ends the simulator, as it ends any other node."""
        with harness.Simulator(self.port, *LAUNCH) as simulator:
            simulator.wait_for_topics(f"{BODY}/State")
            (name,) = harness.simulator_nodes(self.port)
            harness.ros(self.port, "rosnode", "kill", name)
            self.assertEqual(simulator.status(), 0)
            self.assertIn("told to shut down", simulator.log())
        self.assertEqual(harness.simulator_nodes(self.port), set())

    def test_arguments_of_ros(self):
        """Names, remappings and private parameters as of any other node."""
        words = ("__name:=simulation", "__ns:=/lab", "__log:=/dev/null", f"{BODY}/State:=body", "/ambf/env/World/step:=/go")
        with harness.Simulator(self.port, *LAUNCH, *words, "_rate:=50", "_who:=me") as simulator:
            simulator.wait_for_topics("/lab/body", f"{WORLD}/State")
            self.assertIn("/lab/simulation", harness.nodes(self.port))
            self.assertNotIn(f"{BODY}/State", harness.published(self.port))
            self.assertEqual(echo(self.port, "/lab/body")["name"]["data"], "Free")
            services = harness.ros(self.port, "rosservice", "list").split()
            self.assertIn("/go", services)
            self.assertNotIn("/ambf/env/World/step", services)
            self.assertEqual(harness.ros(self.port, "rosparam", "get", "/lab/simulation/rate").strip(), "50")
            self.assertEqual(harness.ros(self.port, "rosparam", "get", "/lab/simulation/who").strip(), "me")
            self.assertNotIn("ignored", simulator.log())
            # Another node of that name takes its place, as everywhere in ROS.
            with harness.Simulator(self.port, *LAUNCH, *words[:2], "--ns", "/two") as second:
                second.wait_for_topics(f"/two{BODY}/State")
                self.assertEqual(simulator.status(), 0)

    def test_two_in_one_namespace(self):
        """Both say so; a node that was killed and is registered still is no neighbour."""
        with harness.Simulator(self.port, *LAUNCH) as killed:
            killed.wait_for_topics(f"{BODY}/State")
            killed.process.kill()
            killed.process.wait()
        with harness.Simulator(self.port, *LAUNCH) as first:
            harness.wait_for(lambda: len(harness.simulator_nodes(self.port)) == 2, "the first is there")
            first.wait_for_topics(f"{BODY}/State")
            time.sleep(3.0)
            self.assertNotIn("another simulator", first.log())
            with harness.Simulator(self.port, *LAUNCH) as second:
                for simulator in (first, second):
                    harness.wait_for(
                        lambda simulator=simulator: "another simulator runs in this namespace" in simulator.log(),
                        "both say so",
                    )


class Brought(unittest.TestCase):
    """Nobody listens at the local ROS_MASTER_URI: the simulator starts a master, which lasts as long as somebody uses it."""

    def end_master(self, port):
        """`--end-master`; what it prints."""
        command = [harness.simulator_path(), "--end-master"]
        with harness.Program(command, harness.environment(port)) as program:
            self.assertEqual(program.status(), 0, program.log())
            return program.log()

    def test_tools_and_clients(self):
        """ROS's own programs work with it."""
        port = harness.free_port()
        with harness.Simulator(port, *LAUNCH) as simulator:
            simulator.wait_for_topics(f"{WORLD}/State", f"{BODY}/State")
            self.assertIn(f"{BODY}/Command", harness.ros(port, "rostopic", "list").split())
            self.assertEqual(harness.ros(port, "rostopic", "type", f"{BODY}/State").strip(), "ambf_msgs/RigidBodyState")
            self.assertEqual(echo(port, f"{BODY}/State")["name"]["data"], "Free")
            (name,) = (name for name in harness.ros(port, "rosnode", "list").split() if "ambf_comm_node" in name)
            self.assertIn(f"{BODY}/State [ambf_msgs/RigidBodyState]", harness.ros(port, "rosnode", "info", name))
            self.assertIn("/rosout_agg", harness.ros(port, "rostopic", "list").split())
            listed = harness.ros(port, "rosparam", "list").split()
            self.assertIn("/ambf/env/World/point_cloud_topics", listed)
            self.assertNotIn("/ambf/env/World", listed, "namespaces are no parameters")
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
        harness.wait_for(lambda: harness.state_of(port) is None, "the master ends when nobody is registered")

    def test_it_is_ended(self):
        """At once, on request; there may be none."""
        port = harness.free_port()
        with harness.Simulator(port, *LAUNCH) as simulator:
            simulator.wait_for_topics(f"{BODY}/State")
            self.assertEqual(simulator.interrupt(), 0)
            self.assertIsNotNone(harness.state_of(port))
        self.assertIn("has ended", self.end_master(port))
        self.assertIsNone(harness.state_of(port))
        self.assertIn("no master answers", self.end_master(port))
        with RosMaster(port):
            command = [harness.simulator_path(), "--end-master"]
            with harness.Program(command, harness.environment(port)) as program:
                self.assertEqual(program.status(), 1)
                self.assertIn("not one that a simulator left behind", program.log())
            self.assertIsNotNone(harness.state_of(port))

    def test_a_client_outlives_simulators(self):
        """Interrupted, or killed: a rospy client gets states and moves a body of the next one within 2 s of its first topic."""
        port = harness.free_port()
        self.addCleanup(self.end_master, port)
        script = [sys.executable, harness.REPOSITORY / "tests/ros/faithful.py", BODY]
        took = []
        for finish in (harness.Simulator.interrupt, harness.Simulator.kill, harness.Simulator.interrupt):
            with harness.Simulator(port, *LAUNCH) as simulator:
                simulator.wait_for_topics(f"{BODY}/State")
                up = time.monotonic()
                if not took:
                    client = harness.Program(script, harness.environment(port))
                    self.addCleanup(client.stop)
                met = len(took) + 1
                harness.wait_for(lambda n=met: client.log().count("moves") == n, "the client meets the simulator")
                took.append(time.monotonic() - up)
                finish(simulator)
        self.assertTrue(client.running(), client.log())
        # The first includes the start of Python; a busy machine may spoil one of the others.
        self.assertLess(min(took[1:]), 2.0, took)

    def test_either_of_two_may_end_first(self):
        """The other goes on, with the master that one of them has started."""
        for first_ends in (True, False):
            with self.subTest(first_ends=first_ends):
                port = harness.free_port()
                with harness.Simulator(port, *LAUNCH) as first, harness.Simulator(port, *LAUNCH, "--ns", "/two") as second:
                    first.wait_for_topics(f"{BODY}/State")
                    second.wait_for_topics(f"/two{BODY}/State")
                    self.assertNotIn("another simulator", first.log() + second.log())
                    ends, stays = (first, second) if first_ends else (second, first)
                    topic = f"/two{BODY}/State" if first_ends else f"{BODY}/State"
                    self.assertEqual(ends.interrupt(), 0)
                    before = echo(port, topic)["sim_time"]
                    harness.wait_for(lambda t=topic, b=before: echo(port, t)["sim_time"] > b, "it goes on")
                    self.assertNotIn("lost the master", stays.log())
                self.end_master(port)

    def test_killed_nodes_are_forgotten(self):
        """The master notices that nobody listens at their addresses."""
        port = harness.free_port()
        self.addCleanup(self.end_master, port)
        with harness.Simulator(port, *LAUNCH) as killed:
            killed.wait_for_topics(f"{BODY}/State")
            killed.process.kill()
            killed.process.wait()
        self.assertIn(f"{BODY}/State", harness.published(port))
        harness.wait_for(lambda: not harness.nodes(port), "it is unregistered")

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
            # A publisher of commands that had to be killed stays registered; that is not the simulator's fault.
            self.assertEqual(harness.simulator_nodes(port), set())

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
