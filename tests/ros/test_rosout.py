"""What the simulator says is on /rosout, with its level."""

import math

import harness
import rospy
from ambf_msgs.msg import RigidBodyCmd
from rosgraph_msgs.msg import Log
from simulated import Ros, Simulated

setUpModule, tearDownModule = Ros.start, Ros.stop

BODY = "/ambf/env/Free"


class Rosout(Simulated):
    """A simulator with a model whose mesh is missing."""

    def setUp(self):
        """It is started when somebody listens."""

    def test_lines_are_sent_with_their_levels(self):
        lines = []
        subscriber = rospy.Subscriber("/rosout_agg", Log, lines.append, queue_size=1000)
        self.addCleanup(subscriber.unregister)
        harness.wait_for(subscriber.get_num_connections, "the lines of all nodes are listened to")
        simulator = harness.Simulator(
            Ros.master.port, "--launch_file", harness.scene / "launch.yaml", "-l", "3,1", gui=("-g", "0")
        )
        self.addCleanup(self.finish, simulator)
        simulator.wait_for_topics(f"{BODY}/State")

        def said(text, level):
            own = [line for line in lines if line.name.startswith("/ambf_comm_node")]
            return [line for line in own if text in line.msg and line.level == level]

        harness.wait_for(lambda: said("nothere.STL", Log.ERROR), "what was said while the scene was loaded")
        self.reset()
        harness.wait_for(lambda: said("reset", Log.INFO), "what has happened")
        command = rospy.Publisher(f"{BODY}/Command", RigidBodyCmd, queue_size=1)
        harness.wait_for(command.get_num_connections, "the simulator listens to commands")
        wrong = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_FORCE)
        wrong.wrench.force.x = math.nan

        def warned():
            command.publish(wrong)
            return said(f"{BODY}/Command", Log.WARN)

        line = harness.wait_for(warned, "a warning")[0]
        self.assertIn(line.msg, simulator.log())
        self.assertGreater(line.header.stamp.to_sec(), 0.0)
        self.assertEqual(len(said("reset", Log.INFO)), 1)
