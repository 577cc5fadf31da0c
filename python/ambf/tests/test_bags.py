"""Recordings exported as bags of ROS, read again by the package `rosbags`; notes that are added."""

import contextlib
import io
import pathlib
import sys
import tempfile
import unittest

import ambf
import numpy as np
from ambf import export

MODELS = pathlib.Path(__file__).resolve().parents[3] / "resources/models"
# As clients of ROS 1 know it.
SUM_OF_BODIES = "c0ba0eb38f2481828a038f3b17ce0623"
SUM_OF_WORLD = "6e545bb4d1457db0c1ee58df8e46d570"


class Exported(unittest.TestCase):
    """A recording of a pendulum."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.file = self.folder / "a.mcap"
        world = MODELS.parent / "world/world.yaml"
        with ambf.Simulation([MODELS / "pendulum.yaml"], world=world) as sim:
            sim.record(self.file)
            sim.note("stage: rest")
            sim.step(100)
            sim.body("Base").joint_kinds[:] = ambf.POSITION
            sim.body("Base").joint_commands[:] = 0.3
            sim.step(400)
            sim.stop_recording()
        with ambf.Recording(self.file) as recording:
            self.truth = recording.arrays(rate=100)
            self.bodies = recording.simulation.bodies

    def export(self, form, *more):
        """Runs the program; the folder."""
        out = self.folder / form
        said = io.StringIO()
        words = [
            str(self.file),
            "--to",
            form,
            "--out",
            str(out),
            "--rate",
            "100",
            "--note",
            "0.25",
            "stage: swing",
            *more,
        ]
        self.assertEqual(export.main(words, said), 0, said.getvalue())
        self.assertIn(f"{len(self.truth['time'])} frames", said.getvalue())
        return out


@unittest.skipIf(sys.version_info < (3, 10), "rosbags needs Python 3.10")
class Bags(Exported):
    def check(self, messages, sums):
        """`messages`: (topic, type, time in ns, message) of a bag."""
        times = self.truth["time"]
        of = {}
        for topic, kind, time, message in messages:
            of.setdefault((topic, kind), []).append((time, message))
        body, world, notes = "ambf_msgs/msg/RigidBodyState", "ambf_msgs/msg/WorldState", "std_msgs/msg/String"
        names = {(f"{name}/State", body) for name in self.bodies}
        self.assertEqual(set(of), names | {("/ambf/env/World/State", world), ("/ambf/notes", notes)})
        if sums:
            self.assertEqual((sums[body], sums[world]), (SUM_OF_BODIES, SUM_OF_WORLD))
        self.assertEqual([message.data for _, message in of["/ambf/notes", notes]], ["stage: rest", "stage: swing"])
        self.assertEqual(of["/ambf/notes", notes][1][0], 250_000_000)
        steps = [message.sim_step for _, message in of["/ambf/env/World/State", world]]
        self.assertEqual(len(steps), len(times))
        self.assertEqual(steps, sorted(set(steps)))
        for index, name in enumerate(self.bodies):
            found = of[f"{name}/State", body]
            self.assertEqual([time for time, _ in found], [round(time * 1e9) for time in times])
            for row, (time, message) in enumerate(found):
                stamp = message.header.stamp
                self.assertEqual(stamp.sec * 10**9 + stamp.nanosec, time)
                at, turn = message.pose.position, message.pose.orientation
                pose = [at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w]
                np.testing.assert_array_equal(pose, self.truth["poses"][row, index])
                twist = [*vars(message.twist.linear).values(), *vars(message.twist.angular).values()]
                twist = [number for number in twist if isinstance(number, float)]
                np.testing.assert_array_equal(twist, self.truth["twists"][row, index])
            if name.endswith("/Base"):
                self.assertEqual(list(message.joint_names), ["Base-Link"])
                self.assertEqual(message.joint_positions.dtype, np.float32)
                joint = np.float32(self.truth["joint_positions"][-1, 0])
                self.assertEqual(message.joint_positions[0], joint)
                self.assertGreater(abs(joint), 0.01)

    def test_ros_1(self):
        from rosbags.rosbag1 import Reader

        with Reader(self.export("rosbag1") / "episode_000000.bag") as reader:
            store = export.bags._store(1)
            sums = {connection.msgtype: connection.digest for connection in reader.connections}
            messages = [
                (connection.topic, connection.msgtype, time, store.deserialize_ros1(data, connection.msgtype))
                for connection, time, data in reader.messages()
            ]
        self.check(messages, sums)

    def test_ros_2(self):
        from rosbags.rosbag2 import Reader

        folder = self.export("rosbag2") / "episode_000000"
        self.assertEqual(sorted(path.suffix for path in folder.iterdir()), [".mcap", ".yaml"])
        with Reader(folder) as reader:
            store = export.bags._store(2)
            messages = [
                (connection.topic, connection.msgtype, time, store.deserialize_cdr(data, connection.msgtype))
                for connection, time, data in reader.messages()
            ]
        self.check(messages, None)


class Notes(Exported):
    def test_further_notes_are_instructions_from_their_time_on(self):
        rows = (self.export("csv") / "episode_000000.csv").read_text().splitlines()[1:]
        instructions = [(float(row.split(",")[0]), row.rsplit(",", 1)[1]) for row in rows]
        begin = self.truth["time"][0]
        for time, instruction in instructions:
            expected = "swing" if time + begin >= 0.25 else "rest"
            self.assertEqual(instruction, expected, time)

    def test_notes_that_cannot_be(self):
        def refused(*words):
            said = io.StringIO()
            with contextlib.redirect_stderr(said):
                status = export.main([*words, "--to", "csv", "--out", str(self.folder / "out")])
            self.assertEqual(status, 1)
            self.assertFalse((self.folder / "out").exists())
            return said.getvalue()

        self.assertIn("goes from 0.0 to", refused(str(self.file), "--note", "7", "late"))
        self.assertIn("expected a simulated time", refused(str(self.file), "--note", "now", "text"))
        self.assertIn("one by one", refused(str(self.file), str(self.file), "--note", "0", "text"))


if __name__ == "__main__":
    unittest.main()
