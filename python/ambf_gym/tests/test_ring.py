"""The wire, and the judge of a ring on it."""

import math
import unittest

import numpy as np
from ambf_peg_transfer.arms import about, forward, inverse, matrix_of, quaternion_of
from ambf_ring_on_wire import plan, wire
from ambf_ring_on_wire.judge import TIME_LIMIT, Judge


def ring(along, turn=0.3, aside=0.0):
    """Pose of the ring around the wire, its middle off the wire along its x."""
    at = plan.ring_at(along, turn)
    return (*(at.position + aside * at.axes[:, 0]), *quaternion_of(at.axes))


class Wire(unittest.TestCase):
    """Geometry."""

    def test_it_is_one_smooth_line(self):
        """Its tangent turns by no more than a bend does; a place along it is found again."""
        self.assertGreater(wire.LENGTH, 0.2)
        np.testing.assert_allclose((wire.POINTS[0], wire.POINTS[-1]), (wire.CORNERS[0], wire.CORNERS[-1]))
        alongs = np.linspace(0.0, wire.LENGTH, 500)
        tangents = np.array([wire.at(along)[1] for along in alongs])
        np.testing.assert_allclose(np.linalg.norm(tangents, axis=1), 1.0)
        turns = np.arccos(np.clip((tangents[1:] * tangents[:-1]).sum(axis=1), -1.0, 1.0))
        self.assertLess(turns.max(), 1.5 * (alongs[1] - alongs[0]) / wire.BEND)
        for along in alongs[5:-5:7]:
            point, tangent = wire.at(along)
            side = np.cross(tangent, (0.3, 0.9, 0.2))
            found = wire.nearest(point + 0.002 * side / np.linalg.norm(side))
            self.assertAlmostEqual(found.along, along, delta=6e-4)
            self.assertAlmostEqual(found.distance, 0.002, delta=1e-4)

    def test_clearance_is_the_play_of_a_ring(self):
        """On a straight leg: in the middle, aside, and turned."""
        play = 0.5 * (wire.INNER + wire.OUTER) - 0.5 * (wire.OUTER - wire.INNER) - wire.WIRE_RADIUS
        at = plan.ring_at(wire.START, 0.0)
        self.assertAlmostEqual(wire.clearance(at.position, at.axes), play, delta=1e-5)
        aside = at.position + 0.003 * at.axes[:, 0]
        self.assertAlmostEqual(wire.clearance(aside, at.axes), play - 0.003, delta=3e-5)
        self.assertLess(wire.clearance(at.position + play * at.axes[:, 1], at.axes), 5e-5)
        self.assertTrue(wire.is_threaded(aside, at.axes))
        self.assertFalse(wire.is_threaded(at.position + 0.02 * at.axes[:, 0], at.axes))


class Rotations(unittest.TestCase):
    """Quaternions of the arms' module."""

    def test_there_and_back(self):
        """A quaternion of a matrix of a quaternion, also of half a turn."""
        rng = np.random.default_rng(0)
        for quaternion in (*rng.normal(size=(50, 4)), (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)):
            axes = matrix_of(quaternion)
            np.testing.assert_allclose(matrix_of(quaternion_of(axes)), axes, atol=1e-12)
        np.testing.assert_allclose(quaternion_of(about(2, math.pi / 3)), (0, 0, 0.5, math.sqrt(0.75)), atol=1e-12)


class Ways(unittest.TestCase):
    """What the arm can reach."""

    def test_the_arm_follows_each_way(self):
        """From each start: within its limits all along, without jumps, and away from the wire."""
        ways = plan.ways()
        starts = ways.starts()
        self.assertGreater(len(starts), 10)
        for start in starts[::5]:
            turns = ways.way(start)
            self.assertLess(np.abs(np.diff(turns)).max(), 0.2)
            before = None
            for along, turn in zip(ways.alongs, turns):
                at = plan.ring_at(along, turn)
                q = plan.joints("psm1", plan.tool_of(at))
                self.assertIsNotNone(q)
                if before is not None:
                    self.assertLess(np.abs(q - before).max(), 0.6)
                before = q
        self.assertEqual(inverse(*forward(before)).round(9).tolist(), before.round(9).tolist())

    def test_seeds_draw_starts(self):
        """The same seed the same one; many are drawn."""
        drawn = [plan.draw(seed) for seed in range(30)]
        self.assertEqual(drawn, [plan.draw(seed) for seed in range(30)])
        self.assertGreater(len(set(drawn)), 8)


class Judging(unittest.TestCase):
    """Runs in poses."""

    def test_a_ring_that_follows_the_wire_is_there(self):
        """Without a touch, and over when it is there."""
        judge = Judge()
        alongs = np.linspace(wire.START, wire.LENGTH - wire.GOAL, 200)
        for i, along in enumerate(alongs):
            score = judge.update(5.0 + 0.1 * i, ring(along))
            self.assertAlmostEqual(score.along, along, delta=1e-3)
        self.assertTrue(score.is_there and score.is_over)
        self.assertEqual((score.touches, score.touch_time, score.progress, score.reason), (0, 0.0, 1.0, "there"))
        self.assertLess(score.time, 0.1 * len(alongs))

    def test_touches_are_counted_and_timed(self):
        """Two of them; a ring that stays near is one touch."""
        judge = Judge()
        for i, aside in enumerate((0.0, 0.0059, 0.00595, 0.0, 0.0, 0.006, 0.0)):
            score = judge.update(0.1 * i, ring(wire.START + 0.005, aside=aside))
        self.assertEqual(score.touches, 2)
        self.assertAlmostEqual(score.touch_time, 0.3)

    def test_a_ring_off_the_wire_ends_the_run(self):
        """So does the time; a ring that the tool no longer has is a drop."""
        judge = Judge()
        judge.update(0.0, ring(wire.START))
        score = judge.update(0.1, ring(wire.START, aside=0.02))
        self.assertTrue(score.is_over and not score.is_there)
        self.assertEqual(score.reason, "the ring is off the wire")
        judge.reset()
        hand = plan.tool_of(plan.ring_at(0.05, 0.3)).position
        judge.update(0.0, ring(0.05), hand)
        self.assertEqual(judge.update(0.1, ring(0.046), hand).drops, 0)
        self.assertEqual(judge.update(0.2, ring(wire.START), hand).drops, 1)
        self.assertEqual(judge.update(0.3, ring(wire.START), hand).drops, 1)
        self.assertEqual(judge.update(TIME_LIMIT + 0.1, ring(wire.START), hand).reason, "time")


if __name__ == "__main__":
    unittest.main()
