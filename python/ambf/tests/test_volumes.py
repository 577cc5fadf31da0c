"""Volumes: cuts, distances, files."""

import pathlib
import tempfile
import unittest

import ambf
import numpy as np

MODEL = """
volumes: [VOLUME bone]
VOLUME bone:
  name: bone
  nrrd: bone.nrrd
  location: {position: {x: 0.1, y: 0.0, z: 0.0}, orientation: {r: 0, p: 0, y: 1.5707963267948966}}
bodies: []
"""

HEADER = """NRRD0004
type: unsigned char
dimension: 3
space: left-posterior-superior
sizes: 20 16 12
space directions: (1,0,0) (0,1,0) (0,0,1)
encoding: raw
Segment0_ID:=Segment_1
Segment0_Name:=bone
Segment0_Color:=1 0.5 0
Segment0_LabelValue:=1
Segment1_ID:=Segment_2
Segment1_Name:=nerve
Segment1_Color:=1 1 0
Segment1_LabelValue:=2

"""


class Volumes(unittest.TestCase):
    def setUp(self) -> None:
        kept = tempfile.TemporaryDirectory()
        self.addCleanup(kept.cleanup)
        self.folder = pathlib.Path(kept.name)
        voxels = np.ones((12, 16, 20), np.uint8)
        voxels[:, :, :2] = 0
        voxels[4:8, 6:10, 10:14] = 2
        (self.folder / "bone.nrrd").write_bytes(HEADER.encode() + voxels.tobytes())
        (self.folder / "model.yaml").write_text(MODEL)
        self.simulation = ambf.Simulation(self.folder / "model.yaml", saving=True)

    def test_cuts_are_arrays_and_undone_by_states_and_resets(self) -> None:
        bone = self.simulation.volume("bone")
        self.assertTrue((bone.size, bone.spacing.tolist()) == ((20, 16, 12), [0.001] * 3))
        self.assertTrue([label.name for label in bone.labels] == ["", "bone", "nerve"])
        density, labels = bone.voxels()
        self.assertTrue(density.shape == (12, 16, 20) and (labels[:, :, :2] == 0).all() and labels[5, 7, 11] == 2)
        start = self.simulation.save()
        # The x axis of the volume is y of the world.
        carved = bone.carve((0.1, 0.004, 0.0), radius=0.003)
        self.assertTrue(
            carved.indices.shape[1:] == (3,) and len(carved.indices) == len(carved.colors) == len(carved.labels) > 80
        )
        self.assertAlmostEqual(carved.volume, len(carved.indices) * 1e-9, delta=1e-15)
        after, _ = bone.voxels()
        x, y, z = carved.indices.T
        self.assertTrue((after[z, y, x] == 0).all() and np.count_nonzero(density) - np.count_nonzero(after) == len(x))
        self.assertTrue({tuple(color) for color in carved.colors.tolist()} == {(255, 128, 0, 255), (255, 255, 0, 255)})
        self.assertTrue(bone.carve(voxels=[[3, 7, 5], [3, 7, 5], [99, 0, 0]]).indices.tolist() == [[3, 7, 5]])
        slow = bone.carve((-0.004, 0.0, 0.0), radius=0.003, rate=5e-9, interval=1.0, frame="volume")
        self.assertTrue(len(slow.indices) == 5)
        box = bone.carve((-0.004, 0, 0), (-0.002, 0, 0), edges=(0.004, 0.002, 0.002), count=3, frame="volume")
        self.assertEqual(len(box.indices), 3)
        self.assertTrue(len(bone.carve((-0.004, 0.004, 0.0), radius=0.001, length=0.004, frame="volume").indices) > 10)
        self.simulation.restore(start)
        self.assertTrue((bone.voxels()[0] == density).all())
        bone.carve((0.1, 0.004, 0.0), radius=0.003)
        self.simulation.reset()
        self.assertTrue((bone.voxels()[0] == density).all())
        bone.carve((0.1, 0.004, 0.0), radius=0.003)
        bone.restore()
        self.assertTrue((bone.voxels()[0] == density).all())

    def test_distances_follow_the_cuts(self) -> None:
        bone = self.simulation.volume(0)
        # 5 mm above the upper face, which is 6 mm above the middle.
        distance, gradient = bone.distance((0.1, 0.0, 0.011))
        self.assertAlmostEqual(float(distance), 0.005, delta=3e-4)
        self.assertGreater(gradient[2], 0.95)
        to_nerve, _ = bone.distance([(0.1, 0.002, 0.011), (0.1, 0.002, 0.0)], "nerve")
        self.assertAlmostEqual(to_nerve[0], 0.009, delta=5e-4)
        self.assertLess(to_nerve[1], 0)
        self.assertTrue(bone.distance((5.0, 0.0, 0.0), most=0.1)[0] == np.inf)
        bone.carve((0.1, 0.0, 0.005), radius=0.004)
        self.assertTrue(bone.distance((0.1, 0.0, 0.011))[0] > 0.0051)

    def test_what_is_saved_is_read_again(self) -> None:
        bone = self.simulation.volume("bone")
        bone.carve((0.1, 0.004, 0.0), radius=0.003)
        density, labels = bone.voxels()
        bone.save(self.folder / "bone.nrrd")
        again = ambf.Simulation(self.folder / "model.yaml").volume("bone")
        self.assertTrue((again.voxels()[0] == density).all() and (again.voxels()[1] == labels).all())
        bone.save(self.folder / "slices", "p0")
        self.assertTrue(len(list((self.folder / "slices").glob("p0*.png"))) == 12)
        bone.save(self.folder / "bone.stl")
        self.assertTrue((self.folder / "bone.stl").stat().st_size > 1000)
        with self.assertRaisesRegex(OSError, "unknown format"):
            bone.save(self.folder / "bone.doc")

    def test_unusable_cuts_are_refused(self) -> None:
        bone = self.simulation.volume("bone")
        before = bone.voxels()[0]
        for arguments in (
            {},
            {"radius": -1.0},
            {"radius": float("nan")},
            {"radius": 0.001, "edges": (1, 1, 1)},
            {"length": 1.0},
            {"radius": 0.001, "rate": 1e-9},
            {"radius": 0.001, "frame": "moon"},
            {"voxels": [[0.5, 1, 2]]},
            {"edges": (1, 1)},
            {"radius": 0.001, "start": (0, 0)},
            {"radius": 0.001, "end": (float("inf"), 0, 0)},
        ):
            with self.assertRaises(ValueError):
                bone.carve(**arguments)  # type: ignore[arg-type]
        with self.assertRaises(ambf.NotFoundError):
            self.simulation.volume("brain")
        with self.assertRaises(ambf.NotFoundError):
            bone.distance((0, 0, 0), "brain")
        self.assertTrue((bone.voxels()[0] == before).all())


if __name__ == "__main__":
    unittest.main()
