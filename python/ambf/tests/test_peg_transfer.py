"""The peg-transfer scene, in this process: what stands where, what holds, what stops, and what a reset brings back.

Numbers are those of the competition's scene, computed from its files.
"""

import math
import pathlib
import unittest

import ambf
import numpy as np
import yaml
from ambf_peg_transfer import ASYMMETRIC, SYMMETRIC
from ambf_peg_transfer.arms import LOWER, UPPER, about, forward, inverse, matrix_of
from ambf_peg_transfer.player import GRIPS, OPEN, Arm, Place, Player, place_of, upright

RESOURCES = pathlib.Path(__file__).resolve().parents[3] / "resources"
FOLDER = RESOURCES / "peg_transfer"
WHOLE = (0, 1, 2, 3, 4, 5)
STEP = 0.005
TOP = SYMMETRIC.top


def scene(models=WHOLE, **options):
    """Models of the launch file."""
    options = {"profile": "accurate", "step": STEP, "crtk": [FOLDER / "crtk.yaml"], **options}
    if not {2, 4} <= set(models):
        del options["crtk"]
    return ambf.Simulation(launch_file=FOLDER / "launch.yaml", indexes=models, **options)


def wait(sim, seconds):
    """Lets time pass."""
    sim.step(round(seconds / STEP))


def tilt(pose):
    """Angle between a body's z and the vertical, rad."""
    return math.acos(min(1.0, matrix_of(pose[3:])[2, 2]))


def with_block(x, y, z, turn=0.0):
    """A pose of a block that stands."""
    return (x, y, z, 0.0, 0.0, math.sin(turn / 2), math.cos(turn / 2))


class Scene(unittest.TestCase):
    """What there is, and where."""

    def test_what_has_topics(self):
        """As many bodies, joints and cameras as in the competition's scene, under its names; pegs and links have no topics."""
        sim = scene()
        names = {name.removeprefix("/ambf/env/") for name in sim.bodies}
        arms = {
            f"psm{i}/{part}" for i in (1, 2) for part in ("baselink", "toolpitchlink", "toolyawlink", "tool_id_420006")
        }
        board = {
            f"phantom/{part}" for part in ("BlackGround_Plane", "peg_board_s", "peg_board_wall_s", "block1", "block2")
        }
        self.assertEqual(names, arms | board | {"Plane", "CameraFrame"})
        self.assertEqual((len(sim.joints), len(sim.body("psm1/baselink").joints)), (16, 8))
        self.assertEqual([name.split("/env/")[1] for name in sim.cameras], ["stereo/left", "stereo/right"])
        self.assertEqual(
            [name.split("/env/")[1] for name in sim.actuators], [f"ghosts/psm{i}/Actuator0" for i in (1, 2)]
        )
        files = ["board", "camera_frame", "psm1", "psm1_ghosts", "psm2", "psm2_ghosts"]
        loaded = [yaml.safe_load((FOLDER / f"{file}.yaml").read_text()) for file in files]
        count = lambda key: sum(len(model.get(key) or ()) for model in loaded)  # noqa: E731
        # And the plane of the world.
        self.assertEqual(
            (count("bodies") + 1, count("joints"), count("ghost objects"), count("actuators")), (45, 16, 4, 2)
        )
        # Actuators hang on bodies of another model, by their full names; nothing else is guessed or left out.
        warnings = [warning for warning in sim.warnings if ": warning: " in warning]
        self.assertTrue(all("is taken from another model" in warning for warning in warnings), warnings)

    def test_pegs_are_where_the_referee_takes_them_to_be(self):
        """Its table agrees with the files of both boards."""
        for file, board in (("board", SYMMETRIC), ("board_asymmetric", ASYMMETRIC)):
            model = yaml.safe_load((FOLDER / f"{file}.yaml").read_text())
            pegs = {
                key.split()[1]: model[key]["location"]["position"]
                for key in model["bodies"]
                if " peg" in key and "board" not in key
            }
            self.assertEqual({name: (at["x"], at["y"]) for name, at in pegs.items()}, board.pegs)
            blocks = [key.split()[1] for key in model["bodies"] if " block" in key]
            self.assertEqual(tuple(blocks), board.blocks)
        self.assertEqual((len(SYMMETRIC.pegs), len(ASYMMETRIC.pegs)), (18, 13))
        listed = {name for name in ASYMMETRIC.pegs if not model[f"BODY {name}"].get("passive")}
        self.assertEqual(listed, {f"peg{i}" for i in (4, 6, 7, 10, 13, 14)})

    def test_passive_bodies_can_be_looked_at(self):
        """Pegs and fingers have no rows, but poses."""
        sim = scene()
        self.assertEqual(len(sim.passive_bodies), 45 - len(sim.bodies))
        peg = sim.passive_body("peg4_s")
        np.testing.assert_allclose(peg.pose[:3], (*SYMMETRIC.pegs["peg4_s"], TOP + 0.01), atol=1e-9)
        np.testing.assert_allclose(peg.twist, 0, atol=1e-12)
        finger, link = sim.passive_body("psm1/toolgripperleftlink"), sim.body("psm1/toolyawlink")
        np.testing.assert_allclose(finger.pose[:3], link.pose[:3], atol=1e-6)
        with self.assertRaises(ambf.NotFoundError):
            sim.passive_body("block1")

    def test_surfaces_are_where_they_belong(self):
        """Board, peg and wall, by rays from above."""
        sim = scene()
        peg = SYMMETRIC.pegs["peg1_s"]
        places = [(0.05, 0.19), peg, (0.01937, 0.24)]
        rays = sim.cast_rays([(x, y, 0.9) for x, y in places], (0, 0, -1))
        np.testing.assert_allclose(0.9 - rays.distances, (TOP, TOP + 0.02, TOP + 0.1), atol=2e-5)
        beyond = sim.cast_rays((0.01937, 0.2, 0.9), (0, 0, -1))
        self.assertAlmostEqual(0.9 - beyond.distances[0], TOP, delta=2e-5, msg="the far 20 mm are open")

    def test_blocks_stay_where_they_are(self):
        """Untouched for 20 s: they fall by 5 mm, and then don't move."""
        for profile in ("legacy", "accurate"):
            sim = scene(profile=profile)
            wait(sim, 20)
            for name, x, y in (("block1", 0.09912, 0.23199), ("block2", -0.06075, 0.20176)):
                body = sim.body(name)
                np.testing.assert_allclose(body.pose[:2], (x, y), atol=1e-4)
                self.assertTrue(0.7240 < body.pose[2] < 0.7253, body.pose)
                self.assertLess(tilt(body.pose), math.radians(0.1))
                self.assertLess(np.abs(body.twist[:3]).max(), 1e-4)

    def test_six_blocks_stay_too(self):
        """On the asymmetric board."""
        sim = scene((6, 1))
        wait(sim, 3)
        for name in ASYMMETRIC.blocks:
            body = sim.body(name)
            self.assertTrue(0.7240 < body.pose[2] < 0.7253, (name, body.pose))
            self.assertLess(np.abs(body.twist[:3]).max(), 1e-4)

    def test_holes_are_open_on_all_pegs(self):
        """A block that falls from 20 mm above each peg settles on the board."""
        sim = scene((0, 1))
        # The other one is out of the way.
        sim.set_state(poses={"block2": with_block(0.0194, 0.19, 0.7241)})
        for i, (peg, (x, y)) in enumerate(SYMMETRIC.pegs.items()):
            sim.set_state(poses={"block1": with_block(x, y, TOP + 0.0225, 0.3 * i)}, twists={"block1": np.zeros(6)})
            wait(sim, 1)
            pose = sim.body("block1").pose
            self.assertTrue(0.7240 < pose[2] < 0.7253, (peg, pose))
            self.assertLess(math.hypot(pose[0] - x, pose[1] - y), 0.0028, peg)
            self.assertLess(tilt(pose), math.radians(1.0), peg)

    def test_a_block_has_its_play(self):
        """Pushed towards a wall it stops after 2.0 to 2.5 mm."""
        sim = scene((0, 1))
        x, y = SYMMETRIC.pegs["peg5_s"]
        for turn in (0.0, 1.0, 2.5):
            sim.set_state(poses={"block1": with_block(x, y, 0.7241, turn)}, twists={"block1": np.zeros(6)})
            body = sim.body("block1")
            way = about(2, turn) @ np.array([0.0, 1.0, 0.0])  # a wall is on the other side of the axis
            body.kind = ambf.FORCE
            body.wrench[:3] = 1.0 * way
            wait(sim, 1.5)
            body.wrench[:] = 0
            moved = (np.array(body.pose[:2]) - (x, y)) @ way[:2]
            self.assertTrue(0.0020 < moved < 0.0025, moved)

    def test_the_wall_stops_blocks(self):
        """From either side, at 0.5 m/s; behind its end, nothing does."""
        sim = scene((0, 1))
        body = sim.body("block1")
        for side in (1, -1):
            for y, passes in ((0.24, False), (0.189, True)):
                start = (0.01937 + side * 0.03, y, 0.78)
                sim.set_state(poses={"block1": with_block(*start)}, twists={"block1": (-side * 0.5, 0, 0, 0, 0, 0)})
                body.kind = ambf.VELOCITY
                for _ in range(40):
                    body.target_twist[:] = (-side * 0.5, 0, 0, 0, 0, 0)
                    sim.step(1)
                body.kind = ambf.NONE
                crossed = (0.01937 - body.pose[0]) * side
                self.assertEqual(crossed > 0, passes, (side, y, body.pose))


class Arms(unittest.TestCase):
    """Frames and joints."""

    def test_frames_are_those_of_the_table(self):
        """At all joints 0 and in other places, for both arms; the tool's frame of a dVRK follows from the body's."""
        sim = scene()
        rng = np.random.default_rng(1)
        tool = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]])
        for arm in ("psm1", "psm2"):
            base, link = sim.body(f"{arm}/baselink"), sim.body(f"{arm}/toolyawlink")
            for q in (np.zeros(6), [0, 0, 0.12, 0, 0, 0], *rng.uniform(LOWER, UPPER, size=(5, 6))):
                joints = [i + 8 * (arm == "psm2") for i in range(6)]
                sim.set_state(joint_positions=dict(zip(joints, q)))
                world = place_of(base.pose).inverse()
                seen = world.times(place_of(link.pose))
                position, axes = forward(q)
                np.testing.assert_allclose(seen.position, position, atol=1e-6)
                np.testing.assert_allclose(seen.axes, axes, atol=1e-6)
            sim.set_state(joint_positions=dict.fromkeys(joints, 0.0))
            seen = place_of(base.pose).inverse().times(place_of(link.pose))
            np.testing.assert_allclose(seen.position, (0, 0, -0.0598), atol=1e-6)
            np.testing.assert_allclose(seen.axes @ tool, [[0, 1, 0], [1, 0, 0], [0, 0, -1]], atol=1e-6)

    def test_tips_are_where_they_belong(self):
        """Both wrists with the insertion at 0.12 m."""
        sim = scene()
        sim.set_state(joint_positions={2: 0.12, 10: 0.12})
        for arm, place in (("psm1", (0.0633, 0.2811, 0.7580)), ("psm2", (0.0011, 0.2830, 0.7576))):
            np.testing.assert_allclose(sim.body(f"{arm}/toolyawlink").pose[:3], place, atol=5e-4)

    def test_inverse_kinematics_find_what_forward_kinematics_say(self):
        """All over the limits; beyond the reach there is nothing."""
        rng = np.random.default_rng(2)
        for q in rng.uniform(LOWER, UPPER, size=(200, 6)):
            found = inverse(*forward(q))
            self.assertIsNotNone(found)
            for a, b in zip(forward(q), forward(found)):
                np.testing.assert_allclose(a, b, atol=1e-9)
        self.assertIsNone(inverse((0, 0, -0.31), forward(np.zeros(6))[1]))

    def test_one_arm_alone_is_not_enough(self):
        """PSM1 does not reach block2, so that blocks must change hands."""
        sim = scene()
        base, far = sim.body("psm1/baselink").pose[:3], sim.body("block2").pose[:3]
        self.assertAlmostEqual(math.dist(base, far), 0.3115, delta=5e-4)
        arm = Arm(sim, "psm1")
        block = upright((far[0], far[1], 0.7241), 0.0)
        self.assertTrue(all(arm.solve(grip.tool(block)) is None for grip in GRIPS))

    def test_fingers_stay_where_they_were_told_to_be(self):
        """While the joints of the arm alone are commanded; and the joints stay while the jaw alone is."""
        sim = scene()
        base = sim.body("psm1/baselink")
        base.joint_kinds[:] = ambf.POSITION
        base.joint_commands[:] = (0, 0, 0.12, 0, 0, 0, 0.5, 0.5)
        wait(sim, 3)
        before = base.joint_positions.copy()
        base.joint_commands[:6] = (0.1, -0.1, 0.1, 0.3, 0.2, -0.2)
        for _ in range(10):
            wait(sim, 1)
            np.testing.assert_allclose(base.joint_positions[6:], 0.5, atol=0.01)
        base.joint_commands[:6] = before[:6]
        wait(sim, 3)
        base.joint_commands[6:] = 0.1
        wait(sim, 1)
        np.testing.assert_allclose(base.joint_positions[:6], before[:6], atol=1e-3)


class Grips(unittest.TestCase):
    """Friction alone, in the profile accurate, without ghosts."""

    def setUp(self):
        """Both arms, and block1 in the jaws of the first, lifted."""
        self.sim = scene((0, 1, 2, 4))
        self.player = Player(self.sim, STEP)
        self.player.wait(1.0)
        self.arm = self.player.arms[1]
        block = self.player.block("block1")
        usable = [grip for grip in GRIPS if self.arm.margin(grip.tool(block)) > 0.05]
        self.grip = max(usable, key=lambda grip: self.arm.margin(grip.tool(block)))
        tool = self.grip.tool(block)
        over = Place(tool.position + np.array([0, 0, 0.035]), tool.axes)
        self.player._approach(self.arm, over)
        self.player.line(self.arm, tool)
        self.player.set_jaw(self.arm, 0.0)
        self.player.line(self.arm, over)

    def held(self):
        """The block, seen from the tool."""
        return self.arm.tool.inverse().times(self.player.block("block1"))

    def test_a_lifted_block_does_not_slip(self):
        """35 mm above the board for 10 s; open jaws let go."""
        self.player.wait(1.0)
        self.assertGreater(self.player.block("block1").position[2], TOP + 0.03)
        before = self.held()
        self.player.wait(10.0)
        after = self.held()
        self.assertLess(np.linalg.norm(after.position - before.position), 2e-4)
        self.assertLess(np.abs(after.axes - before.axes).max(), 1e-3)
        self.assertLess(np.abs(self.sim.body("block1").twist).max(), 1e-3)
        self.player.set_jaw(self.arm, OPEN)
        self.player.wait(1.0)
        self.assertLess(self.player.block("block1").position[2], TOP + 0.02)

    def test_a_reset_brings_it_back(self):
        """While it is held: to where the file has it; the arms are at rest, and ten resets are equal to the last bit."""
        seen = set()
        for _ in range(3):
            self.sim.reset()
            self.sim.body("psm1/baselink").joint_kinds[:] = ambf.POSITION
            self.sim.body("psm1/baselink").joint_commands[:] = (0.1, 0.1, 0.1, 0, 0, 0, 0.3, 0.3)
            wait(self.sim, 2)
            np.testing.assert_allclose(self.sim.body("block1").pose[:2], (0.09912, 0.23199), atol=1e-4)
            seen.add(self.sim.poses.tobytes() + self.sim.twists.tobytes() + self.sim.joint_positions.tobytes())
        self.assertEqual(len(seen), 1)
        self.assertLess(np.abs(self.sim.joint_velocities).max(), 1e-3)


class Transfer(unittest.TestCase):
    """The whole way."""

    def test_a_block_changes_hands_and_counts(self):
        """block1 goes to a peg of the right side; nothing runs away while both arms hold it."""
        sim = scene((0, 1, 2, 4))
        player = Player(sim, STEP)
        player.wait(1.0)
        fastest = 0.0
        tick = player.tick

        def watching():
            nonlocal fastest
            score = tick()
            fastest = max(fastest, float(np.abs(sim.body("block1").twist[:3]).max()))
            return score

        player.tick = watching
        player.transfer("block1", "peg18_s")
        player.wait(0.5)
        score = player.referee.score
        self.assertEqual((score.points, score.hand_offs, score.drops), (1, 1, 0))
        self.assertEqual(score.on_peg["block1"], "peg18_s")
        self.assertLess(fastest, 0.2)


class Cameras(unittest.TestCase):
    """What the cameras see."""

    def test_things_are_at_their_pixels(self):
        """The published edges of the wall and of the board, in the left picture; the right one is shifted by the baseline."""
        sim = scene((0, 1))
        wait(sim, 1)
        try:
            picture = sim.render("stereo/left", rgb=True, depth=True)
        except ambf.RenderError as error:
            self.skipTest(f"nothing can be drawn: {error}")
        rgb, depth = picture["rgb"], picture["depth"]
        self.assertEqual(rgb.shape, (480, 640, 3))
        # The far right corner of the board, 0.339 m away: beyond it is the ground, 0.12 m lower.
        self.assertTrue(self.corner(depth, 554.0, 202.6))
        block = np.add(sim.body("block1").pose[:3], (0, 0, 0.014))
        self.assertEqual(self.hue(rgb, self.pixel(block)), "red")
        self.assertEqual(self.hue(rgb, self.pixel(np.add(sim.body("block2").pose[:3], (0, 0, 0.014)))), "blue")

    def pixel(self, point, x=-0.001):
        """Of a point in the world, in the picture of a camera at x of its frame."""
        frame = Place(np.array([0.01937, 0.35456, 0.90445]), about(2, -3.14159) @ about(0, 0.69813))
        seen = frame.inverse().times(Place(np.asarray(point), np.eye(3))).position - (x, 0, -0.05)
        f = 240 / math.tan(0.9599310886 / 2)
        return 320 + f * seen[0] / -seen[2], 240 - f * seen[1] / -seen[2]

    def corner(self, depth, u, v):
        """Whether, within a pixel of there, it is near on one side and far on the other."""
        around = depth[round(v) - 3 : round(v) + 4, round(u) - 3 : round(u) + 4]
        return around.max() - around.min() > 0.08

    def hue(self, rgb, pixel):
        """Of the pixels around."""
        u, v = (round(value) for value in pixel)
        around = rgb[v - 8 : v + 9, u - 8 : u + 9].reshape(-1, 3).astype(float)
        # The peg in the middle is grey.
        r, _, b = around[np.argmax(np.abs(around[:, 0] - around[:, 2]))]
        return "red" if r > 1.5 * b else "blue" if b > 1.5 * r else f"{r} {b}"

    def test_projection_is_the_published_one(self):
        """By pose and angle: pixels of two points, and their shift to the right picture."""
        wall, corner = (0.01937, 0.28199, 0.82391), (-0.08073, 0.18199, 0.72391)
        np.testing.assert_allclose(self.pixel(wall), (327.9, 209.8), atol=1.0)
        np.testing.assert_allclose(self.pixel(corner), (554.0, 202.6), atol=1.0)


if __name__ == "__main__":
    unittest.main()
