"""Episodes of an environment that are recorded, exported and read again."""

import pathlib
import tempfile
import unittest

import ambf_gym
import gymnasium
import h5py
import numpy as np
from ambf import Recording, export
from ambf.mapping import MappingOf

INCREMENT = 0.08


class Reach(unittest.TestCase):
    """`ambf/Reach-v0`, and the mapping `reach`."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.env = gymnasium.make("ambf/Reach-v0", in_process=True)
        self.addCleanup(self.env.close)

    def play(self, seed, file=None, steps=10):
        """Observations before the actions, and the actions."""
        if file is not None:
            self.env.unwrapped.record(file)
        observation, _ = self.env.reset(seed=seed)
        seen, done = [], []
        rng = np.random.default_rng(seed)
        for _ in range(steps):
            action = rng.uniform(-1.0, 1.0, 7).astype(np.float32)
            seen.append(observation)
            done.append(action)
            observation, *_ = self.env.step(action)
        return np.array(seen), np.array(done)

    def test_a_frame_is_what_was_observed_and_what_was_done_then(self):
        """Of two episodes; one between them is not recorded, and changes nothing."""
        files = [self.folder / f"{seed}.mcap" for seed in (1, 2)]
        played = [self.play(1, files[0])]
        self.play(7)
        played.append(self.play(2, files[1]))
        updates = self.env.unwrapped.stop_recording()
        with Recording(files[1]) as recording:
            self.assertEqual((recording.updates, recording.ended), (updates, "stopped"))
        self.assertIsNone(self.env.unwrapped.stop_recording())
        made = MappingOf.load("reach")
        export.export([str(file) for file in files], "robomimic", self.folder / "data", mapping=made)
        with h5py.File(self.folder / "data/data.hdf5") as read:
            for index, (seen, done) in enumerate(played):
                demo = read[f"data/demo_{index}"]
                count = demo.attrs["num_samples"]
                self.assertGreaterEqual(count, len(seen) - 1)
                # Frames are of the update in which a command begins to act, 1 ms after the observation.
                np.testing.assert_allclose(demo["obs/state"][:count], seen[:count, :7], atol=5e-3)
                np.testing.assert_allclose(demo["obs/flange"][:count], seen[:count, 14:17], atol=2e-3)
                np.testing.assert_allclose(demo["obs/goal"][:count], seen[:count, 17:], atol=1e-6)
                set_points = np.concatenate([seen[:1, :7], demo["actions"][:count]])
                np.testing.assert_allclose(np.diff(set_points, axis=0), INCREMENT * done[:count], atol=1e-4)

    def test_what_cannot_be(self):
        """Over ROS; into a file that is there."""
        file = self.folder / "there.mcap"
        file.write_text("")
        with self.assertRaisesRegex(Exception, "there.mcap"):
            self.play(1, file)
        self.assertEqual(file.read_text(), "")
        env = gymnasium.make("ambf/Reach-v0", in_process=False)
        with self.assertRaises(ambf_gym.InvalidDescription):
            env.unwrapped.record(file)
        env.close()


if __name__ == "__main__":
    unittest.main()
