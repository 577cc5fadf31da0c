"""Arms for CRTK clients in this process."""

import math
import pathlib
import tempfile
import unittest

import ambf
import numpy as np

RESOURCES = pathlib.Path(__file__).resolve().parents[3] / "resources"
FOLDER = RESOURCES / "peg_transfer"
STEP = 0.005


def scene(crtk="crtk.yaml", **options):
    """The peg transfer with its arms."""
    options = {"profile": "accurate", "step": STEP, "crtk": [FOLDER / crtk], **options}
    return ambf.Simulation(launch_file=FOLDER / "launch.yaml", indexes=[0, 1, 2, 4], **options)


def wait(sim, seconds):
    """Lets time pass."""
    sim.step(round(seconds / STEP))


def behind(gain, damping, time, duration=0.5, count=2000):
    """What is left of a move, as a share of it, of a joint that follows the polynomial of fifth degree by the velocity P e + D de/dt:
    its error obeys (1 + D) de/dt = dr/dt - P e, r being the set point.
    """
    left, step = 0.0, time / count
    for i in range(count):
        share = min((i + 0.5) * step / duration, 1.0)
        speed = 30.0 * (share * (1.0 - share)) ** 2 / duration
        left += step * (speed - gain * left) / (1.0 + damping)
    return left


SETTLED = 2.5
"""After so long a joint with the default gains, P 10 and D 1, is within 4e-6 of a step of its set point, s: its time constant is
(1 + D) / P = 0.2 s."""


class Arms(unittest.TestCase):
    """What is there, what moves, what is said."""

    def test_topics_are_those_of_ros(self):
        """By the dialect of the arm; names are found like those of bodies."""
        sim = scene()
        self.assertEqual(sim.arms, ("/CRTK/psm1", "/CRTK/psm2", "/CRTK/ecm"))
        arm = sim.arm("psm1")
        self.assertEqual(arm.name, "/CRTK/psm1")
        self.assertIn("jaw/servo_jp", arm.inputs)
        self.assertIn("/ambf/env/psm1/errors_model/set_errors", arm.inputs)
        self.assertLessEqual(
            {"measured_js", "measured_cp", "measured_cv", "T_b_w", "jaw/measured_js"}, set(arm.outputs)
        )
        with self.assertRaises(ambf.NotFoundError):
            sim.arm("psm3")
        with self.assertRaisesRegex(ambf.NotFoundError, "servo_jp"):
            arm.send("servo_jq", np.zeros(6))
        with self.assertRaises(ambf.NotFoundError):
            arm.read("servo_jp")
        sim.close()

    def test_what_is_commanded_is_reached_and_measured(self):
        """Joints, jaw and pose; a move of the challenge's dialect takes 0.5 s, and joints come after it as their controllers do."""
        sim = scene()
        arm = sim.arm("psm1")
        self.assertIsNone(arm.read("measured_js"))
        goal = np.array([0.1, -0.1, 0.12, 0.2, 0.1, -0.1])
        arm.send("move_jp", goal)
        arm.send("jaw/servo_jp", [0.3])
        # The wrist's yaw has gains of its own, the others have the default ones.
        gains = [(10.0, 1.0)] * 5 + [(30.0, 0.4)]
        wait(sim, 0.5)
        for time in (0.5, 0.6):
            left = 1.0 - arm.joints("measured_js").position / goal
            np.testing.assert_allclose(left, [behind(p, d, time) for p, d in gains], atol=1e-3, err_msg=f"{time} s")
            wait(sim, 0.1)
        wait(sim, 0.3)
        joints = arm.joints("measured_js")
        np.testing.assert_allclose(joints.position, goal, atol=5e-3)
        wait(sim, SETTLED)
        np.testing.assert_allclose(arm.joints("measured_js").position, goal, atol=1e-4)
        self.assertEqual((len(joints.names), len(joints.velocity)), (8, 6))
        self.assertAlmostEqual(arm.joints("jaw/measured_js").position[0], 0.3, delta=1e-3)
        pose = arm.cartesian("measured_cp")
        self.assertEqual(pose.frame, "psm1/baselink")
        target = pose.value.copy()
        target[0] += 0.01
        arm.send("servo_cp", target, frame="psm1/baselink")
        wait(sim, 1.0)
        np.testing.assert_allclose(arm.cartesian("measured_cp").value[:3], target[:3], atol=1e-4)
        self.assertAlmostEqual(arm.cartesian("measured_cp").stamp, sim.sim_time, delta=2 * STEP)
        sim.close()

    def test_what_is_refused_is_said(self):
        """A frame that nobody knows, a pose out of reach, numbers that are too few or none."""
        sim = scene()
        arm = sim.arm("psm1")
        wait(sim, 0.1)
        before = arm.joints("measured_js").position
        arm.send("servo_cp", (0, 0, -0.12, 0, 0, 0, 1), frame="nowhere")
        arm.send("servo_jp", np.zeros(5))
        wait(sim, 0.1)
        arm.send("servo_jp", np.full(6, np.nan))
        wait(sim, 0.1)
        np.testing.assert_allclose(arm.joints("measured_js").position, before, atol=1e-9)
        # They are said by another thread.
        said = ""
        for _ in range(200):
            said += "\n".join(sim.notices())
            if "nowhere" in said and "finite" in said:
                break
            wait(sim, 0.01)
        self.assertIn("nowhere", said)
        self.assertNotIn("middleware", said)
        for topic, value in (("servo_cp", np.zeros(6)), ("move_cp", ()), ("servo_jp", "home")):
            with self.assertRaises(ambf.InvalidCommand):
                arm.send(topic, value)
        sim.close()

    def test_runs_repeat_to_the_last_bit(self):
        """No thread and no clock is between what is sent and what moves."""
        seen = set()
        for _ in range(2):
            sim = scene(seed=3)
            arm = sim.arm("psm2")
            for i in range(100):
                arm.send("servo_jp", [0.002 * i, 0.001 * i, 0.001 * i, 0, 0, 0])
                arm.send("jaw/servo_jp", [0.003 * i])
                wait(sim, 0.01)
            seen.add(sim.poses.tobytes() + arm.joints("measured_js").position.tobytes())
            sim.close()
        self.assertEqual(len(seen), 1)

    def test_a_seed_draws_errors_and_places(self):
        """As the program's option does; measured joints don't show the errors, the tool does. A client sets others."""
        from ambf_peg_transfer import SYMMETRIC, draw

        sim = scene(seed=5)
        arm, body = sim.arm("psm1"), sim.body("psm1/baselink")
        arm.send("servo_jp", [0.1, 0.2, 0.1, 0, 0, 0])
        wait(sim, SETTLED)
        drawn = draw(5)
        np.testing.assert_allclose(arm.joints("measured_js").position[:3], (0.1, 0.2, 0.1), atol=1e-4)
        off = body.joint_positions[:3] - (0.1, 0.2, 0.1)
        np.testing.assert_allclose(off, drawn.errors["psm1"], atol=1e-4)
        for name, (peg, _) in drawn.blocks.items():
            self.assertLess(math.dist(sim.body(name).pose[:2], SYMMETRIC.pegs[peg]), 0.003)
        arm.send("/ambf/env/psm1/errors_model/set_errors", [0.05, -0.05, 0.004])
        arm.send("servo_jp", [0.1, 0.2, 0.1, 0, 0, 0])
        wait(sim, SETTLED)
        np.testing.assert_allclose(body.joint_positions[:3], (0.15, 0.15, 0.104), atol=1e-4)
        sim.close()

    def test_one_arm_has_two_names(self):
        """As announced and as shipped: either moves it, both measure it, each in its own frame."""
        sim = scene("crtk_both.yaml")
        self.assertEqual(sim.arms, ("/PSM1", "/CRTK/psm1", "/PSM2", "/CRTK/psm2", "/CRTK/ecm"))
        announced, shipped = sim.arm("PSM1"), sim.arm("psm1")
        self.assertEqual(announced.name, "/PSM1")
        shipped.send("servo_jp", [0, 0, 0.12, 0, 0, 0])
        shipped.send("jaw/servo_jp", [0.25])
        wait(sim, 1.5)
        for arm in (announced, shipped):
            np.testing.assert_allclose(arm.joints("measured_js").position, (0, 0, 0.12, 0, 0, 0), atol=1e-3)
            self.assertAlmostEqual(arm.joints("jaw/measured_js").position[0], 0.25, delta=1e-3)
        self.assertEqual(announced.joints("measured_js").names[0], "yaw")
        self.assertEqual(shipped.joints("measured_js").names[0], "baselink-yawlink")
        self.assertEqual(announced.cartesian("measured_cp").frame, "CameraFrame")
        self.assertEqual(shipped.cartesian("measured_cp").frame, "psm1/baselink")
        np.testing.assert_allclose(shipped.cartesian("measured_cp").value[:3], (0, 0, -0.1798), atol=1e-4)
        goal = announced.cartesian("measured_cp").value.copy()
        goal[0] -= 0.01
        announced.send("servo_cp", goal)
        wait(sim, 1.5)
        np.testing.assert_allclose(announced.cartesian("measured_cp").value[:3], goal[:3], atol=2e-4)
        self.assertEqual(announced.read("operating_state"), ("ENABLED", True, False))
        announced.send("move_jp", np.zeros(6))
        wait(sim, 0.05)
        self.assertTrue(announced.read("operating_state").is_busy)
        sim.close()

    def test_mistakes_in_files_are_load_errors(self):
        """With file, line, key and what was expected; so is a scene without the arms' joints."""
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder, "arms.yaml")
            path.write_text(
                "crtk:\n  - name: PSM1\n    kind: psm\n    joints: [psm1/a]\n    also: [{name: PSM1, dialct: src}]\n"
            )
            with self.assertRaisesRegex(ambf.LoadError, r"arms.yaml:5.*dialct"):
                scene(path)
            path.write_text("crtk:\n  - name: PSM1\n    kind: psm\n    joints: [psm1/a]\n    also: [{name: PSM1}]\n")
            with self.assertRaisesRegex(ambf.LoadError, "PSM1"):
                scene(path)
        with self.assertRaises(ambf.LoadError):
            ambf.Simulation(RESOURCES / "models/pendulum.yaml", crtk=[FOLDER / "crtk.yaml"])


if __name__ == "__main__":
    unittest.main()
