"""The ring on the wire, in this process: what stands where, what holds, and a script that brings the ring to the end."""

import pathlib
import unittest

import ambf
import numpy as np
from ambf_peg_transfer.arms import matrix_of, quaternion_of
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
        # A new simulation has made its first iteration, in which the ring, which nobody holds, has begun to fall.
        self.assertEqual(sim.sim_step, 1)
        fallen = wire.at(wire.START)[0] - (0.0, 0.0, 0.5 * 9.8 * STEP**2)
        np.testing.assert_allclose(sim.body("ring_visual").pose[:3], fallen, atol=1e-6)
        sim.close()

    def test_a_ring_that_nobody_holds_hangs(self):
        """In the hollow of the wire, where it comes to rest; on the leg it falls to the board and lies there."""
        sim = ambf.Simulation(launch_file=LAUNCH, indexes=[0, 1], step=STEP)
        body = sim.body("ring_visual")
        mass, inertia = sim.masses[body.index], sim.inertias[body.index]
        hollow = wire.POINTS[np.argmin(np.where(np.abs(wire.POINTS[:, 0] - 0.045) < 0.02, wire.POINTS[:, 2], 1.0))]
        at = plan.ring_at(wire.nearest(hollow).along, 0.0)

        def energy():
            """Kinetic, and that by which it is above its lowest place on the wire, J."""
            spin = matrix_of(body.pose[3:]).T @ body.twist[3:]
            height = body.pose[2] - (hollow[2] + wire.WIRE_RADIUS - wire.INNER)
            return 0.5 * mass * (body.twist[:3] @ body.twist[:3]) + 0.5 * inertia @ spin**2 + mass * 9.8 * height

        sim.set_state(poses={body.name: (*at.position, *quaternion_of(at.axes))}, twists={body.name: np.zeros(6)})
        # A ring on a thin wire swings as a pendulum that rolls: little but the scene's damping of 0.1/s stops it. 0.02 is a swing of
        # 8 degrees and the 64 um by which the sides of the ring are nearer to its axis than their corners.
        begin = mass * 9.8 * wire.INNER
        seen = []
        for _ in range(4):
            sim.step(round(2.0 / STEP))
            seen.append(energy())
            self.assertTrue(wire.is_threaded(body.pose[:3], matrix_of(body.pose[3:])))
        self.assertEqual(seen, sorted(seen, reverse=True))
        self.assertLess(max(seen), 0.02 * begin, seen)
        self.assertGreater(wire.clearance(body.pose[:3], matrix_of(body.pose[3:])), -5e-5)
        sim.reset()
        sim.step(round(2.0 / STEP))
        self.assertLess(body.pose[2], wire.TOP + 0.01)
        self.assertLess(np.abs(body.twist).max(), 1e-3)
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
