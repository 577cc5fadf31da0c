"""The referee of the peg transfer, and its scripted player, as ROS programs."""

import json
import sys
import unittest

import harness
import jaws
from rospy import Publisher, Subscriber, init_node
from std_msgs.msg import Empty, String
from support import use_master

SCORE = "/ambf/env/peg_transfer/score"
MASTER = None


def setUpModule():
    """rospy knows one master in a process."""
    global MASTER
    MASTER = harness.Master()
    use_master(MASTER.port)


def tearDownModule():
    MASTER.stop()


class Watching(unittest.TestCase):
    """Beside a simulator of the whole scene."""

    def test_the_score_is_published_and_begins_anew(self):
        """Blocks rest on the pegs on which they start; a start, and a reset of the world, begin a new run."""
        launch = jaws.RESOURCES / "peg_transfer/launch.yaml"
        arguments = ("--launch_file", launch, "-l", "0,1,2,3,4,5", "-p", "200", "-t", "1", "--profile", "accurate")
        with harness.Simulator(MASTER.port, *arguments, gui=()) as simulator:
            simulator.wait_for_topics("/ambf/env/phantom/block2/State")
            command = [sys.executable, "-u", "-m", "ambf_peg_transfer", "--print"]
            with harness.Program(command, harness.environment(MASTER.port)):
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


class Playing(unittest.TestCase):
    """The scripted player, which knows of the simulator what topics say."""

    def test_the_player_brings_a_block_over(self):
        """By topics alone: a point within a minute of simulated time, a hand-off, no drop."""
        folder = jaws.RESOURCES / "peg_transfer"
        # Without ghosts: friction alone holds the blocks.
        scene = ("--launch_file", folder / "launch.yaml", "-l", "0,1,2,4", "-p", "200", "-t", "1")
        options = ("--profile", "accurate", "--crtk", folder / "crtk.yaml")
        rates = ("--override_max_comm_freq", "100", "--override_min_comm_freq", "100")
        with harness.Simulator(MASTER.port, *scene, *options, *rates, gui=()) as simulator:
            simulator.wait_for_topics("/CRTK/psm2/measured_js", "/ambf/env/phantom/block2/State")
            environment = harness.environment(MASTER.port)
            with harness.Program([sys.executable, "-u", "-m", "ambf_peg_transfer"], environment):
                init_node("watching", disable_signals=True)
                scores = []
                Subscriber(SCORE, String, lambda message: scores.append(json.loads(message.data)))
                # block1 left, as the file has it, and block2 right.
                harness.wait_for(lambda: scores and scores[-1]["on_peg"]["block1"] == "peg4_s", "the block rests")
                command = [sys.executable, "-u", "-m", "ambf_peg_transfer.player", "--ros", "--verbose"]
                with harness.Program(command, environment) as player:
                    harness.wait_for(
                        lambda: scores[-1]["points"] or not player.running(), "a point", seconds=4 * harness.PATIENCE_S
                    )
                    self.assertEqual((scores[-1]["points"], scores[-1]["drops"]), (1, 0), player.log())
                    self.assertEqual(scores[-1]["hand_offs"], 1)
                    self.assertLess(scores[-1]["last_point"], 60.0)


if __name__ == "__main__":
    unittest.main()
