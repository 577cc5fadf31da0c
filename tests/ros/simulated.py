"""Tests with a simulator of their own each, on the shipped scenes or on scenes of their own."""

import json
import unittest

import harness
import node
import rospy
from ambf_msgs.msg import WorldState
from std_msgs.msg import Empty

RESOURCES = harness.REPOSITORY / "resources"
MODELS = RESOURCES / "models"
WORLD = "/ambf/env/World"


class Ros:
    """One master and one rospy node for all tests of a module."""

    master = None

    @classmethod
    def start(cls):
        """For `setUpModule`."""
        cls.master = harness.Master()
        node.start(cls.master.port)

    @classmethod
    def stop(cls):
        """For `tearDownModule`: the master ends last."""
        rospy.signal_shutdown("done")
        cls.master.stop()


def written(name, model):
    """A model file with this content; its path."""
    path = harness.folder / name
    path.write_text(json.dumps(model, indent=1))
    return path


class Simulated(unittest.TestCase):
    """Each test has a simulator with the models `FILES` in the shipped world, where g is 9.81 m/s²."""

    LAUNCH = RESOURCES / "launch.yaml"
    FILES = ()
    ARGUMENTS = ()

    def setUp(self):
        self.simulator = self.start(*self.FILES, arguments=self.ARGUMENTS)
        self.world = self.listen(f"{WORLD}/State", WorldState)
        self.world.newest()

    def start(self, *files, arguments=()):
        """Starts a simulator with these model files, which ends with the test."""
        models = ("-a", ",".join(str(path) for path in files))
        simulator = harness.Simulator(Ros.master.port, "--launch_file", self.LAUNCH, *models, *arguments)
        self.addCleanup(self.finish, simulator)
        simulator.wait_for_topics(f"{WORLD}/State")
        return simulator

    def finish(self, simulator):
        """A simulator ends as asked, and has never panicked."""
        try:
            self.assertTrue(simulator.running(), simulator.log())
            self.assertEqual(simulator.interrupt(), 0)
            simulator.check_log()
        finally:
            simulator.stop()

    def listen(self, topic, kind):
        """A listener that ends with the test."""
        listener = node.Listener(topic, kind)
        self.addCleanup(listener.close)
        return listener

    def service(self, name, kind):
        """A service of the world."""
        return node.service(f"{WORLD}/{name}", kind)

    def reset(self, what="Reset"):
        """Asks for a reset once."""
        publisher = rospy.Publisher(f"{WORLD}/Command/{what}", Empty, queue_size=1)
        harness.wait_for(publisher.get_num_connections, "the simulator listens to resets")
        publisher.publish(Empty())
        # The message must leave before the publisher does.
        self.addCleanup(publisher.unregister)

    def pass_time(self, seconds):
        """Waits until so much simulated time has passed."""
        first = self.world.next()
        self.world.until(lambda state: state.sim_time > first.sim_time + seconds, f"{seconds} s pass")

    def wait_for_log(self, text):
        """Waits until the simulator has printed `text`; the line."""

        def line():
            return next((line for line in self.simulator.log().splitlines() if text in line), None)

        return harness.wait_for(line, f"the log says {text!r}")

    def count_in_log(self, text):
        """Lines of the log that hold `text`."""
        return sum(text in line for line in self.simulator.log().splitlines())
