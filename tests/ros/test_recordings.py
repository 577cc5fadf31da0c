"""Recordings that clients begin and end while the simulation runs, and what becomes of commands while one is replayed."""

import json
import subprocess

import harness
import node
import rospy
from ambf_msgs.msg import RigidBodyCmd, RigidBodyState, WorldCmd, WorldState
from ambf_msgs.srv import StartRecording, Step, StopRecording
from scenes import NOWHERE, box, model
from simulated import WORLD, Ros, Simulated, written

setUpModule, tearDownModule = Ros.start, Ros.stop

FLYER = "/ambf/env/Flyer"


def push(x):
    """A force along x, N."""
    command = RigidBodyCmd()
    command.wrench.force.x = x
    return command


class Recorded(Simulated):
    """A simulator with a body that flies freely, and clients of its services."""

    def setUp(self):
        body = {**box("Flyer", 1.0, z=5.0), "gravity": NOWHERE}
        self.FILES = (written("flyer.yaml", model({"BODY Flyer": body})),)
        super().setUp()
        self.start_recording = self.service("start_recording", StartRecording)
        self.stop_recording = self.service("stop_recording", StopRecording)
        self.flyer = self.listen(f"{FLYER}/State", RigidBodyState)

    def recorded(self, file):
        """Records from a reset on while the body is pushed; its last state."""
        answer = self.start_recording(str(file), True)
        self.assertTrue(answer.success, answer)
        self.assertEqual(answer.file, str(file))
        with node.Stream(f"{FLYER}/Command", push(2.0)):
            self.flyer.until(lambda state: state.pose.position.x > 0.5, "it is pushed")
        answer = self.stop_recording()
        self.assertTrue(answer.success, answer)
        self.assertEqual(answer.file, str(file))
        self.assertRegex(answer.message, r"recorded \d+ updates in ")


class Services(Recorded):
    """Beginning and ending."""

    def test_a_recording_is_replayed_by_a_batch_run(self):
        """It begins with a reset, ends when it is told, and ambf_batch makes the same motion; a second one too."""
        batch = harness.simulator_path().with_name("ambf_batch")
        for name in ("a.mcap", "b.mcap"):
            file = harness.folder / name
            self.recorded(file)
            done = subprocess.run(
                [batch, "--replay", file, "--json", "--trace", harness.folder / name],
                capture_output=True,
                text=True,
                check=False,
            )
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertNotIn("not whole", done.stderr)
            self.assertGreater(json.loads(done.stdout)["steps"], 300)
            rows = (harness.folder / f"{name}_bodies.csv").read_text().splitlines()
            cells = [row.split(",") for row in rows if ",Flyer," in row]
            place = rows[0].split(",").index("px")
            first, last = float(cells[0][place]), float(cells[-1][place])
            self.assertAlmostEqual(first, 0.0, places=2)
            self.assertGreater(last, 0.4)

    def test_what_cannot_begin_says_what_to_do(self):
        """While it moves, while it is recorded, and into a file that is there."""
        self.pass_time(0.1)
        answer = self.start_recording("", False)
        self.assertFalse(answer.success)
        self.assertIn("reset", answer.message)
        self.assertEqual(answer.file, "")
        answer = self.stop_recording()
        self.assertFalse(answer.success)
        self.assertIn("nothing is recorded", answer.message)
        file = harness.folder / "twice.mcap"
        self.assertTrue(self.start_recording(str(file), True).success)
        answer = self.start_recording(str(harness.folder / "other.mcap"), True)
        self.assertFalse(answer.success)
        self.assertIn("twice.mcap is recorded", answer.message)
        self.assertFalse((harness.folder / "other.mcap").exists())
        self.assertTrue(self.stop_recording().success)
        answer = self.start_recording(str(file), True)
        self.assertFalse(answer.success)
        self.assertIn("not overwritten", answer.message)
        answer = self.start_recording(str(self.FILES[0] / "a.mcap"), True)
        self.assertFalse(answer.success, answer)
        self.assertIn("flyer.yaml", answer.message)

    def test_while_a_client_steps(self):
        """A recording begins between the halves of an iteration, too."""
        step = self.service("step", Step)
        self.assertTrue(step(steps=3, patience=30.0).success)
        file = harness.folder / "stepped.mcap"
        self.assertTrue(self.start_recording(str(file), True).success)
        for _ in range(5):
            answer = step(steps=10, patience=30.0, body_names=[FLYER], body_commands=[push(1.0)])
            self.assertTrue(answer.success, answer)
        answer = self.stop_recording()
        self.assertTrue(answer.success, answer)
        # The first one was under way when it began.
        self.assertIn("recorded 51 updates", answer.message)
        batch = harness.simulator_path().with_name("ambf_batch")
        done = subprocess.run([batch, "--replay", file, "--json"], capture_output=True, text=True, check=False)
        self.assertEqual(done.returncode, 0, done.stderr)


class Replayed(Recorded):
    """A recording in real time, with its topics."""

    def test_topics_tell_what_was_recorded_and_commands_are_refused(self):
        """Clients see the motion, hold it, and can't change it; at the end the simulation is paused."""
        file = harness.folder / "live.mcap"
        self.recorded(file)
        # Ends the simulator.
        self.doCleanups()
        simulator = harness.Simulator(Ros.master.port, "--replay", file, "--hold", "--launch_file", self.LAUNCH)
        self.addCleanup(simulator.stop)
        simulator.wait_for_topics(f"{WORLD}/State", f"{FLYER}/State")
        self.simulator = simulator
        flyer = self.listen(f"{FLYER}/State", RigidBodyState)
        self.world = self.listen(f"{WORLD}/State", WorldState)
        step = self.service("step", Step)
        first = step(steps=1, patience=60.0, observe=[FLYER])
        self.assertTrue(first.success, first)
        self.assertAlmostEqual(first.bodies[0].pose.position.x, 0.0, places=3)
        refused = step(steps=1, patience=60.0, body_names=[FLYER], body_commands=[push(-100.0)])
        self.assertFalse(refused.success)
        self.assertIn("a recording is replayed", refused.message)
        answer = self.service("start_recording", StartRecording)("", True)
        self.assertFalse(answer.success)
        self.assertIn("a recording is replayed", answer.message)
        with node.Stream(f"{FLYER}/Command", push(-100.0)):
            self.reset()
            publisher = rospy.Publisher(f"{WORLD}/Command", WorldCmd, queue_size=1)
            harness.wait_for(publisher.get_num_connections, "the simulator listens")
            # Lets it run.
            publisher.publish(WorldCmd())
            flyer.until(lambda state: state.pose.position.x > 0.4, "it moves as it was pushed then")
            self.wait_for_log("live.mcap is over")
        self.assertEqual(self.count_in_log("this is said once"), 1, simulator.log())
        self.assertEqual(simulator.interrupt(), 0)
        simulator.check_log()
