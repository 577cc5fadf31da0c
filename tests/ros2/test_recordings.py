"""Recordings that clients of ROS 2 begin and end while the simulation runs."""

import json
import subprocess

from ambf_msgs.msg import RigidBodyCmd
from ambf_msgs.srv import StartRecording, Step, StopRecording
from harness import program
from simulator import FREE, Simulated

WORLD = "/ambf/env/World"


class Services(Simulated):
    """StartRecording and StopRecording."""

    def start_recording(self, client, file, reset):
        """The answer."""
        return client.call(StartRecording, f"{WORLD}/StartRecording", StartRecording.Request(file=file, reset=reset))

    def stop_recording(self, client):
        """The answer."""
        return client.call(StopRecording, f"{WORLD}/StopRecording", StopRecording.Request())

    def test_a_recording_is_replayed_by_a_batch_run(self):
        """It begins with a reset, while a body is pushed, and ends when it is told; ambf_batch makes the same motion."""
        _, client, states = self.with_state()
        file = self.folder / "a.mcap"
        answer = self.start_recording(client, str(file), True)
        self.assertTrue(answer.success, answer.message)
        self.assertEqual(answer.file, str(file))
        publisher = client.node.create_publisher(RigidBodyCmd, f"{FREE}/Command", 1)
        client.wait_for(lambda: publisher.get_subscription_count() == 1, "the subscription")
        command = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_FORCE)
        command.wrench.force.x = 5.0

        def moved():
            publisher.publish(command)
            return states[-1].pose.position.x > 0.5 and states[-1].sim_step > 1500

        client.wait_for(moved, "the body moves, beyond the first hash of a state")
        answer = self.stop_recording(client)
        self.assertTrue(answer.success, answer.message)
        self.assertEqual(answer.file, str(file))
        self.assertRegex(answer.message, r"recorded \d+ updates in ")
        words = ["--replay", file, "--json", "--trace", self.folder / "a"]
        done = subprocess.run([program("ambf_batch"), *words], capture_output=True, text=True, check=False)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertNotIn("not whole", done.stderr)
        self.assertGreater(json.loads(done.stdout)["steps"], 300)
        heading, *rows = (self.folder / "a_bodies.csv").read_text().splitlines()
        place = heading.split(",").index("px")
        free = [float(row.split(",")[place]) for row in rows if ",Free," in row]
        self.assertAlmostEqual(free[0], 0.0, places=2)
        self.assertGreater(free[-1], 0.4)

    def test_what_cannot_begin_says_what_to_do(self):
        """Where it is not at its start, while it is recorded, into a file that is there, and by another name."""
        _, client, _ = self.with_state()
        self.assertTrue(client.call(Step, f"{WORLD}/Step", Step.Request(steps=2, patience=30.0)).success)
        for file, reset, part in (("", False, "reset"), (str(self.folder / "a.txt"), True, ".mcap")):
            answer = self.start_recording(client, file, reset)
            self.assertFalse(answer.success)
            self.assertIn(part, answer.message)
        answer = self.stop_recording(client)
        self.assertFalse(answer.success)
        self.assertIn("nothing is recorded", answer.message)
        file = str(self.folder / "twice.mcap")
        self.assertTrue(self.start_recording(client, file, True).success)
        answer = self.start_recording(client, str(self.folder / "other.mcap"), True)
        self.assertFalse(answer.success)
        self.assertIn("twice.mcap is recorded", answer.message)
        self.assertTrue(client.call(Step, f"{WORLD}/Step", Step.Request(steps=20, patience=30.0)).success)
        self.assertTrue(self.stop_recording(client).success)
        answer = self.start_recording(client, file, True)
        self.assertFalse(answer.success)
        self.assertIn("not overwritten", answer.message)
