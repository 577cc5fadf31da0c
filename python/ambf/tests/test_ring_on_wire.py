"""The ring on the wire, in this process: what stands where, what holds, and a script that brings the ring to the end."""

import pathlib
import unittest

import ambf
import numpy as np
from ambf_peg_transfer.arms import quaternion_of
from ambf_ring_on_wire import plan, wire
from ambf_ring_on_wire.player import Player, scene

RESOURCES = pathlib.Path(__file__).resolve().parents[3] / "resources"
LAUNCH = RESOURCES / "ring_on_wire/launch.yaml"
STEP = 0.005


class Scene(unittest.TestCase):
    """The files are those that the package's numbers describe."""

    def test_the_wire_is_where_the_package_says(self):
        """Rays from in front of it meet its surface; the ring is around it."""
        sim = ambf.Simulation(launch_file=LAUNCH, indexes=[0, 1], step=STEP)
        warnings = [warning for warning in sim.warnings if ": warning: " in warning]
        self.assertEqual(warnings, [])
        for along in np.linspace(0.05, wire.LENGTH - 0.02, 40):
            point, tangent = wire.at(along)
            side = np.cross(tangent, (0.0, 1.0, 0.0))
            side /= np.linalg.norm(side)
            ray = sim.cast_rays(point + 0.003 * side, -side, 0.006)
            self.assertAlmostEqual(ray.distances[0], 0.003 - wire.WIRE_RADIUS, delta=1.5e-4, msg=f"{along}")
        pose = sim.body("ring_visual").pose
        np.testing.assert_allclose(pose[:3], wire.at(wire.START)[0], atol=1e-6)
        sim.close()

    def test_a_ring_that_nobody_holds_hangs(self):
        """Over a part of the wire that lies, without falling through, and comes to rest; on the leg it falls to the board."""
        sim = ambf.Simulation(launch_file=LAUNCH, indexes=[0, 1], step=STEP)
        body = sim.body("ring_visual")
        along = wire.nearest((0.012, 0.2, 0.768)).along
        at = plan.ring_at(along, 0.0)
        sim.set_state(poses={body.name: (*at.position, *quaternion_of(at.axes))}, twists={body.name: np.zeros(6)})
        sim.step(round(4.0 / STEP))
        self.assertGreater(body.pose[2], wire.TOP)
        ring = np.array(body.pose[:3])
        self.assertLess(wire.nearest(ring).distance, wire.OUTER)
        self.assertLess(np.abs(body.twist).max(), 0.05)
        sim.reset()
        sim.step(round(2.0 / STEP))
        self.assertLess(body.pose[2], wire.TOP + 0.01)
        self.assertLess(np.abs(body.twist).max(), 0.05)
        sim.close()


class Script(unittest.TestCase):
    """The scripted player."""

    def test_it_brings_the_ring_to_the_end(self):
        """Without and with errors of the joints, which it sees by the tool; without a drop."""
        for errors in (False, True):
            sim = scene(RESOURCES, 1, step=STEP, errors=errors)
            score = Player(sim, STEP).play(plan.draw(1))
            self.assertTrue(score.is_there, (errors, score))
            self.assertEqual((score.drops, score.touches), (0, 0), (errors, score))
            sim.close()


if __name__ == "__main__":
    unittest.main()
