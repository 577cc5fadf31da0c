"""The referee of the peg transfer over ROS 2, beside a simulator of the whole scene."""

import json
import os
import subprocess
import sys

from harness import REPOSITORY, STOP_S, environment
from simulator import MANY, Simulated
from std_msgs.msg import Empty, String

SCORE = "/ambf/env/peg_transfer/score"
SOURCES = ("python/ambf_client/src", "python/ambf_gym/src")


class Watching(Simulated):
    """Blocks rest on the pegs on which they start."""

    def referee(self):
        """The program of the referee; it lasts no longer than the test."""
        variables = environment(self.domain)
        paths = [str(REPOSITORY / source) for source in SOURCES] + variables.get("PYTHONPATH", "").split(os.pathsep)
        variables |= {"ROS_VERSION": "2", "PYTHONPATH": os.pathsep.join(path for path in paths if path)}
        command = [sys.executable, "-u", "-m", "ambf_peg_transfer"]
        process = subprocess.Popen(command, env=variables, stdin=subprocess.DEVNULL, start_new_session=True)
        self.addCleanup(process.wait, STOP_S)
        self.addCleanup(process.kill)
        return process

    def test_the_score_is_published_and_begins_anew(self):
        """A start, and a reset of the world, begin a new run."""
        launch = REPOSITORY / "resources/peg_transfer/launch.yaml"
        self.simulator(
            "--ros", "2", "-p", "200", "-t", "1", "--profile", "accurate", scene=(launch, "0,1,2,3,4,5")
        )
        client = self.client()
        texts = client.listen(String, SCORE, MANY)
        referee = self.referee()

        def score():
            self.assertIsNone(referee.poll(), "the referee has ended")
            return json.loads(texts[-1].data) if texts else {}

        pegs = {"block1": "peg4_s", "block2": "peg11_s"}
        client.wait_for(lambda: score().get("on_peg") == pegs, "blocks rest on their pegs")
        self.assertEqual((score()["points"], score()["drops"], score()["is_over"]), (0, 0, False))
        for topic in ("/ambf/env/peg_transfer/start", "/ambf/env/World/Command/Reset"):
            client.wait_for(lambda: score()["time"] > 1.0, "a second passes")
            begin = client.node.create_publisher(Empty, topic, 1)
            client.wait_for(lambda: begin.get_subscription_count() > 0, "somebody listens")
            begin.publish(Empty())
            client.wait_for(lambda: score()["time"] < 0.7, f"a new run begins with {topic}")
