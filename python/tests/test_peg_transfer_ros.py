"""The referee of the peg transfer as a ROS program."""

import json
import sys
import unittest

import harness
import jaws
from rospy import Publisher, Subscriber, init_node
from std_msgs.msg import Empty, String
from support import use_master

SCORE = "/ambf/env/peg_transfer/score"


class Watching(unittest.TestCase):
    """Beside a simulator of the whole scene."""

    def test_the_score_is_published_and_begins_anew(self):
        """Blocks rest on the pegs on which they start; a start, and a reset of the world, begin a new run."""
        master = harness.Master()
        self.addCleanup(master.stop)
        launch = jaws.RESOURCES / "peg_transfer/launch.yaml"
        arguments = ("--launch_file", launch, "-l", "0,1,2,3,4,5", "-p", "200", "-t", "1", "--profile", "accurate")
        with harness.Simulator(master.port, *arguments, gui=()) as simulator:
            simulator.wait_for_topics("/ambf/env/phantom/block2/State")
            command = [sys.executable, "-u", "-m", "ambf_peg_transfer", "--print"]
            with harness.Program(command, harness.environment(master.port)):
                use_master(master.port)
                init_node("watching", disable_signals=True)
                scores = []
                Subscriber(SCORE, String, lambda message: scores.append(json.loads(message.data)))

                def rests():
                    return scores and scores[-1]["on_peg"] == {"block1": "peg4_s", "block2": "peg11_s"}

                harness.wait_for(rests, "blocks rest on their pegs")
                self.assertEqual((scores[-1]["points"], scores[-1]["drops"], scores[-1]["is_over"]), (0, 0, False))
                for topic in ("/ambf/env/peg_transfer/start", "/ambf/env/World/Command/Reset"):
                    harness.wait_for(lambda: scores[-1]["time"] > 1.0, "a second passes")
                    begin = Publisher(topic, Empty, queue_size=1)
                    harness.wait_for(begin.get_num_connections, "somebody listens")
                    begin.publish(Empty())
                    harness.wait_for(lambda: scores[-1]["time"] < 0.7, f"a new run begins with {topic}")


if __name__ == "__main__":
    unittest.main()
