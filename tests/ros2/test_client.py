"""The Python client with ROS 2: its tests without a simulator, and programs for client 3.0 beside one."""

import os
import pathlib
import signal
import subprocess
import sys
import tempfile

from harness import PATIENCE_S, REPOSITORY, Ros2Test, environment, program
from simulator import Simulator

# There is no rospy here: without ROS_VERSION the client chooses ROS 2.
CLIENT = REPOSITORY / "python/ambf_client"
sys.path += [str(CLIENT / "src"), str(CLIENT / "tests"), str(REPOSITORY / "python/tests")]

import jaws  # noqa: E402
import test_objects  # noqa: E402

# What programs for client 3.0 do that have no objects, and what they print.
LAYER = """
import sys
from ambf_client import Client
c = Client('ral_case')
assert c.ral.node_name() == 'ral_case'
c.connect()
assert c.get_ral() is c.ral and c.ral.now_msg().sec > 0
from ros_abstraction_layer import ral
from sensor_msgs.msg import JointState
c.ral.publisher('/CRTK/x/measured_js', JointState, queue_size=1).publish(JointState(position=[0.5]))
child = ral('of_the_arm', '/CRTK').create_child('y')
child.publisher('measured_js', JointState)
c.ral.on_shutdown(lambda: print('ended', flush=True))
print('ready', flush=True)
rate = c.create_rate(100)
while not c.is_shutdown():
    rate.sleep()
print('left the loop', flush=True)
"""

# As somebody who brings a node: callbacks come when it is spun, by `spin` of the layer too.
GIVEN = """
import rclpy, threading
from rclpy.node import Node
from ambf_msgs.msg import WorldState
from ros_abstraction_layer import ral
rclpy.init()
layer = ral('given', node=Node('mine'))
heard = threading.Event()
layer.subscriber('/ambf/env/World/State', WorldState, lambda _: heard.set())
assert not heard.wait(0.5)
layer.spin()
assert heard.wait(60)
layer.shutdown()
assert not rclpy.ok()
print('well', flush=True)
"""

# The same program without a simulator.
ALONE = """
from ambf_client import Client, SimulatorNotFound
try:
    Client('alone').connect(timeout=0.5)
except SimulatorNotFound as error:
    print(error)
"""


def load_tests(loader, tests, _pattern):
    """With what setters make of commands and getters of states, which python/ambf_client/tests tests with ROS 1."""
    tests.addTests(loader.loadTestsFromModule(test_objects))
    return tests


class Programs(Ros2Test):
    """Programs beside a simulator, each in a process of its own."""

    def setUp(self):
        super().setUp()
        folder = tempfile.TemporaryDirectory(prefix="ambf-ros2-tests-")
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def simulator(self):
        """A simulator with an object of each kind."""
        simulator = Simulator.__new__(Simulator)
        simulator.log_file = self.folder / "log"
        with simulator.log_file.open("w") as log:
            simulator.process = subprocess.Popen(
                [program("ambf_simulator"), "--ros", "2", *jaws.everything(self.folder)],
                env=environment(self.domain),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
        self.addCleanup(simulator.close)
        return simulator

    def program(self, *arguments):
        """A Python program in this domain."""
        variables = dict(
            environment(self.domain), ROS_VERSION="2", PYTHONPATH=f"{CLIENT / 'src'}:{os.environ['PYTHONPATH']}"
        )
        running = subprocess.Popen(
            [sys.executable, "-u", "-W", "ignore", *map(str, arguments)],
            env=variables,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.addCleanup(running.stdout.close)
        self.addCleanup(running.wait)
        self.addCleanup(running.kill)
        return running

    def check(self, running, said):
        """It ends well, and has said that."""
        output, _ = running.communicate(timeout=3 * PATIENCE_S)
        self.assertEqual(running.returncode, 0, output)
        self.assertIn(said, output)
        return output

    def test_each_kind_of_object(self):
        """The program that python/tests/test_any_ros.py runs with ROS 1."""
        self.simulator()
        self.check(self.program(REPOSITORY / "python/tests/any_ros.py", jaws.ADDED, "2"), "everything obeyed")

    def test_a_grasp_in_a_script_for_3(self):
        """The one that python/tests/test_client_3.py runs with ROS 1."""
        self.simulator()
        self.check(self.program(REPOSITORY / "python/tests/usage_3_0.py"), "cleaned up")

    def test_the_layer(self):
        """It is there from the start, its topics are where they should be, and Ctrl+C ends loops, hooks and node."""
        self.simulator()
        running = self.program("-c", LAYER)
        line = ""
        while line != "ready\n":
            line = running.stdout.readline()
            self.assertTrue(line, "it ended")
        client = self.client()
        topics = {"/CRTK/x/measured_js", "/CRTK/y/measured_js"}
        client.wait_for(lambda: topics <= {name for name, _ in client.node.get_topic_names_and_types()}, "topics")
        client.wait_for(lambda: {"ral_case", "of_the_arm"} <= set(client.node.get_node_names()), "nodes")
        running.send_signal(signal.SIGTERM)
        output, _ = running.communicate(timeout=PATIENCE_S)
        self.assertEqual((running.returncode, sorted(output.split("\n"))), (0, ["", "ended", "left the loop"]), output)

    def test_a_node_that_is_given(self):
        self.simulator()
        self.check(self.program("-c", GIVEN), "well")

    def test_nobody_is_there(self):
        """The error names the domain."""
        output = self.check(self.program("-c", ALONE), "no simulator has published a world; does it run")
        self.assertIn(f"ROS 2, domain {self.domain} (ROS_DOMAIN_ID): within 0.5 s", output)
