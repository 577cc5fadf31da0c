"""Jacobians, mass matrices, forces and inverse kinematics of trees."""

import pathlib
import tempfile
import unittest

import ambf
import numpy as np

RESOURCES = pathlib.Path(__file__).resolve().parents[3] / "resources"
LAUNCH = RESOURCES / "launch.yaml"
HANGING_ARM = RESOURCES / "models/hanging_arm.urdf"
PROFILES = ("accurate", "legacy")

ARM = tuple(0.2 * n - 0.5 for n in range(7))


def arm(profile="accurate"):
    """The hanging arm of seven joints, bent."""
    sim = ambf.Simulation(HANGING_ARM, launch_file=LAUNCH, profile=profile)
    tree = sim.tree("hanging_arm/base")
    sim.set_state(joint_positions=dict(zip(tree.joints, ARM)))
    return sim, tree


def rotation(quaternion):
    """Matrix of a quaternion x, y, z, w."""
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


PARALLEL = (
    '<robot name="parallel"><link name="world"/>'
    + "".join(
        f'<link name="{name}"><inertial><mass value="0.5"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
        "</inertial></link>"
        for name in ("upper_arm", "forearm", "hand", "left_finger", "right_finger")
    )
    + "".join(
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{origin}"/>'
        f'<axis xyz="{axis}"/><limit lower="{low}" upper="{high}" effort="100" velocity="10"/>{mimic}</joint>'
        for name, kind, parent, child, origin, axis, low, high, mimic in (
            ("shoulder", "revolute", "world", "upper_arm", "0 0 1", "0 1 0", -2, 2, ""),
            ("elbow", "revolute", "upper_arm", "forearm", "0.3 0 0", "0 1 0", -2, 2, ""),
            (
                *("wrist", "revolute", "forearm", "hand", "0.3 0 0", "0 1 0", -3, 3),
                '<mimic joint="elbow" multiplier="-1" offset="0.2"/>',
            ),
            ("left", "prismatic", "hand", "left_finger", "0.1 0.05 0", "0 1 0", -0.05, 0.05, ""),
            (
                *("right", "prismatic", "hand", "right_finger", "0.1 -0.05 0", "0 1 0", -0.03, 0.05),
                '<mimic joint="left" multiplier="-1"/>',
            ),
        )
    )
    + "</robot>"
)
"""An arm in a plane, whose hand turns against the elbow, with two fingers."""


class Trees(unittest.TestCase):
    """What is said of a tree is what it does."""

    def test_what_belongs_to_it(self):
        """Names, order, and the poses that are seen."""
        for profile in PROFILES:
            sim, tree = arm(profile)
            self.assertEqual((tree.is_free, tree.size, len(tree.joints)), (False, 7, 7))
            self.assertEqual(tree.joints, tuple(sim.joints[index] for index in tree.joint_indices))
            self.assertIn("base", tree.bodies[0])
            self.assertIn("7 joints", repr(tree))
            for name, pose in zip(tree.bodies, tree.poses()):
                # Joints of `legacy` give way to their loads.
                close = 1e-9 if profile == "accurate" else 1e-5
                np.testing.assert_allclose(pose[:3], sim.body(name).pose[:3], atol=close)
                np.testing.assert_allclose(rotation(pose[3:]), rotation(sim.body(name).pose[3:]), atol=close)

    def test_jacobians_are_differences_of_poses(self):
        """Of a point of the flange, world axes."""
        _, tree = arm()
        point = (0.1, -0.2, 0.3)
        jacobian = tree.jacobian("flange", point)
        self.assertEqual(jacobian.shape, (6, 7))
        link = next(index for index, name in enumerate(tree.bodies) if name.endswith("flange"))
        at = np.array(ARM)

        def place(positions):
            pose = tree.poses(joint_positions=positions)[link]
            return pose[:3] + rotation(pose[3:]) @ point, rotation(pose[3:])

        for joint in range(7):
            by = np.eye(7)[joint] * 1e-5
            (ahead, turned), (behind, before) = place(at + by), place(at - by)
            np.testing.assert_allclose(jacobian[:3, joint], (ahead - behind) / 2e-5, atol=1e-6)
            spin = (turned - before) / 2e-5 @ place(at)[1].T
            np.testing.assert_allclose(jacobian[3:, joint], [spin[2, 1], spin[0, 2], spin[1, 0]], atol=1e-6)

    def test_both_profiles_have_the_same(self):
        """Masses, frames and coordinates decide."""
        found = []
        for profile in PROFILES:
            _, tree = arm(profile)
            matrix, bias = tree.mass_matrix(joint_positions=ARM), tree.bias_forces(joint_positions=ARM, rates=ARM)
            np.testing.assert_array_equal(matrix, matrix.T)
            self.assertGreater(np.linalg.eigvalsh(matrix).min(), 0)
            accelerations = np.linalg.solve(matrix, -bias)
            rest = tree.inverse_dynamics(accelerations, rates=ARM, joint_positions=ARM)
            np.testing.assert_allclose(rest, np.zeros(7), atol=1e-10)
            found.append((matrix, bias))
        np.testing.assert_allclose(found[0][0], found[1][0], atol=1e-9)
        np.testing.assert_allclose(found[0][1], found[1][1], atol=1e-4)

    def test_what_is_computed_is_what_the_simulation_does(self):
        """A mechanism that is let go while it moves: its accelerations are those of M and the bias forces."""
        text = """
            <robot name="two"><link name="world"/>
            <joint name="a" type="continuous"><parent link="world"/><child link="upper"/><axis xyz="0 1 0"/></joint>
            <link name="upper"><inertial><origin xyz="0.1 0 0.05"/><mass value="1.5"/>
              <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial></link>
            <joint name="b" type="prismatic"><origin xyz="0.3 0 0"/><parent link="upper"/><child link="lower"/>
              <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="100" velocity="100"/></joint>
            <link name="lower"><inertial><mass value="0.7"/>
              <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""
        with tempfile.TemporaryDirectory() as folder:
            file = pathlib.Path(folder) / "two.urdf"
            file.write_text(text)
            for profile in PROFILES:
                sim = ambf.Simulation(file, launch_file=LAUNCH, profile=profile)
                tree, base = sim.tree("upper"), sim.body("world")
                base.joint_kinds = ambf.EFFORT
                sim.step(2)
                sim.set_state(
                    joint_positions=dict(zip(tree.joints, (0.4, 0.1))),
                    joint_velocities=dict(zip(tree.joints, (0.8, -0.5))),
                )
                # What `legacy` reads of a slider follows an iteration late.
                sim.step(4)
                rates, before = tree.rates, np.linalg.solve(tree.mass_matrix(), -tree.bias_forces())
                sim.step(4)
                after = np.linalg.solve(tree.mass_matrix(), -tree.bias_forces())
                found = (tree.rates - rates) / 0.004
                np.testing.assert_allclose(found, (before + after) / 2, rtol=0.01, atol=0.01, err_msg=profile)

    def test_rotors_and_couplings(self):
        """Accelerations of a mechanism that is let go, with the inertia of rotors, and a joint that follows another one."""
        text = """
            <mujoco><worldbody><body name="upper"><joint name="a" axis="0 1 0" armature="0.2"/>
              <geom type="capsule" size="0.03" fromto="0 0 0 0.4 0 0"/>
              <body name="lower" pos="0.4 0 0"><joint name="b" axis="0 1 0" armature="0.05"/>
              <geom type="capsule" size="0.03" fromto="0 0 0 0.3 0 0.1"/></body></body></worldbody>
            <equality><joint joint1="b" joint2="a" polycoef="0 -1.5 0 0 0"/></equality></mujoco>"""
        with tempfile.TemporaryDirectory() as folder:
            file = pathlib.Path(folder) / "two.xml"
            file.write_text(text)
            sim = ambf.Simulation(file, launch_file=LAUNCH)
            plain = pathlib.Path(folder) / "plain.xml"
            plain.write_text(text.replace(' armature="0.2"', "").replace(' armature="0.05"', ""))
            without = ambf.Simulation(plain, launch_file=LAUNCH).tree("upper")
        tree, place = sim.tree("upper"), (0.3, -0.45)
        added = tree.mass_matrix(joint_positions=place) - without.mass_matrix(joint_positions=place)
        np.testing.assert_allclose(added, np.diag([0.2, 0.05]), atol=1e-12)
        np.testing.assert_array_equal(tree.coupling_rows(), [[1.5, 1]])

        def accelerations():
            mass, rows = tree.mass_matrix(), tree.coupling_rows()
            system = np.block([[mass, -rows.T], [rows, np.zeros((1, 1))]])
            return np.linalg.solve(system, np.append(-tree.bias_forces(), 0))[:2]

        sim.step(50)
        rates, before = tree.rates, accelerations()
        np.testing.assert_allclose(tree.coupling_rows() @ rates, 0, atol=1e-9)
        sim.step(4)
        found = (tree.rates - rates) / 0.004
        np.testing.assert_allclose(found, (before + accelerations()) / 2, rtol=1e-3)

    def test_a_base_that_is_free(self):
        """A cube that falls: its 6 rates are its twist."""
        with tempfile.TemporaryDirectory() as folder:
            file = pathlib.Path(folder) / "cube.yaml"
            file.write_text(
                "bodies: [BODY cube]\nBODY cube: {name: cube, mass: 2, inertia: {ix: 0.1, iy: 0.2, iz: 0.3}, "
                "inertial offset: {position: {x: 0.1, y: 0, z: 0}, orientation: {r: 0, p: 0, y: 0}}, "
                "location: {position: {x: 0, y: 0, z: 3}, orientation: {r: 0, p: 0, y: 0}}}\n"
            )
            sim = ambf.Simulation(file, launch_file=LAUNCH)
        tree = sim.tree("cube")
        self.assertEqual((tree.is_free, tree.size, tree.joints), (True, 6, ()))
        np.testing.assert_allclose(tree.mass_matrix(), np.diag([2, 2, 2, 0.1, 0.2, 0.3]), atol=1e-12)
        np.testing.assert_allclose(tree.gravity_forces(), [0, 0, 2 * 9.81, 0, 0, 0], atol=1e-9)
        np.testing.assert_allclose(tree.jacobian(0)[:, 5], [0, -0.1, 0, 0, 0, 1], atol=1e-12)
        np.testing.assert_allclose(
            tree.coriolis_forces(rates=(0, 0, 0, 1, 1, 1)), [0, 0, 0, 0.1, -0.2, 0.1], atol=1e-12
        )

    def test_inverse_kinematics(self):
        """A pose that is within reach, and one that is not."""
        sim, tree = arm()
        flange = sim.body("hanging_arm/flange").pose.copy()
        found = tree.inverse_kinematics("flange", flange[:3], flange[3:], start=np.array(ARM) + 0.2)
        self.assertTrue(found.reached)
        sim.set_state(joint_positions=dict(zip(tree.joints, found.joint_positions)))
        np.testing.assert_allclose(sim.body("hanging_arm/flange").pose[:3], flange[:3], atol=2e-6)
        far = tree.inverse_kinematics("flange", (10, 0, 0))
        self.assertFalse(far.reached)
        self.assertGreater(far.position_error, 1)
        limits = sim.joint_limits[tree.joint_indices]
        self.assertTrue((limits[:, 0] <= far.joint_positions).all() and (far.joint_positions <= limits[:, 1]).all())

    def test_inverse_kinematics_of_joints_that_follow_others(self):
        """A planar arm whose hand stays level, as that of a parallelogram, and whose second finger mirrors the first."""
        with tempfile.TemporaryDirectory() as folder:
            file = pathlib.Path(folder) / "parallel.urdf"
            file.write_text(PARALLEL)
            sim = ambf.Simulation(file, launch_file=LAUNCH)
        tree = sim.tree("hand")
        self.assertEqual(len(tree.coupling_rows()), 2)
        rng = np.random.default_rng(2)
        finger = next(i for i, name in enumerate(tree.bodies) if name.endswith("right_finger"))
        joints = list(tree.joints)
        shoulder, elbow, wrist, left, right = (
            joints.index(name) for name in ("shoulder", "elbow", "wrist", "left", "right")
        )
        for _ in range(20):
            asked = np.zeros(5)
            asked[[shoulder, elbow, left]] = rng.uniform((-1, 0.3, 0.0), (1, 1.5, 0.03))
            asked[wrist], asked[right] = -asked[elbow] + 0.2, -asked[left]
            wanted = tree.poses(joint_positions=asked)[finger]
            start = asked + rng.uniform(-0.2, 0.2, 5)
            found = tree.inverse_kinematics("right_finger", wanted[:3], start=start)
            self.assertTrue(found.reached, found)
            q = found.joint_positions
            np.testing.assert_allclose((q[wrist], q[right]), (-q[elbow] + 0.2, -q[left]), atol=1e-12)
            place = tree.poses(joint_positions=q)[finger]
            np.testing.assert_allclose(place[:3], wanted[:3], atol=2e-6)
            # It is a state that the simulation takes, which those are not in which a follower goes its own way.
            sim.set_state(joint_positions=dict(zip(joints, q)))
            np.testing.assert_allclose(sim.joint_positions[tree.joint_indices], q, atol=1e-9)
        far = tree.inverse_kinematics("right_finger", (0, 0, 5))
        self.assertFalse(far.reached)
        # The second finger's limit is nearer than the first one's.
        self.assertLessEqual(far.joint_positions[left], 0.03 + 1e-9)
        sim.set_parameters(joint_limits={"right": (0.06, 0.08)})
        with self.assertRaisesRegex(ambf.TreeError, "those of right are not kept"):
            tree.inverse_kinematics("right_finger", (0, 0, 0.5))

    def test_what_is_wrong_is_said(self):
        """Shapes, numbers, names, and bodies that are no tree."""
        _, tree = arm()
        for call in (
            lambda: tree.mass_matrix(joint_positions=np.zeros(6)),
            lambda: tree.mass_matrix(joint_positions=np.full(7, np.nan)),
            lambda: tree.inverse_dynamics(np.zeros(8)),
            lambda: tree.bias_forces(rates=np.zeros(3)),
            lambda: tree.poses(base_pose=np.zeros(7)),
            lambda: tree.jacobian("flange", (1, 2)),
            lambda: tree.inverse_kinematics("flange"),
            lambda: tree.inverse_kinematics("flange", (1, 2, np.inf)),
            lambda: tree.inverse_kinematics("flange", (1, 2, 3), tolerance=(-1, 0)),
            lambda: tree.inverse_kinematics("flange", (1, 2, 3), iterations=-1),
        ):
            self.assertRaises(ValueError, call)
        self.assertRaises(ambf.NotFoundError, tree.jacobian, "nobody")
        self.assertRaises(ambf.NotFoundError, tree.jacobian, 99)
        loop = ambf.Simulation(RESOURCES / "models/four_bar.yaml", launch_file=LAUNCH)
        with self.assertRaisesRegex(ambf.TreeError, "closes a loop"):
            [loop.tree(body) for body in loop.bodies]
        joints = ambf.Simulation(RESOURCES / "models/joints.yaml", launch_file=LAUNCH)
        with self.assertRaisesRegex(ambf.TreeError, "is of type"):
            [joints.tree(body) for body in joints.bodies]


if __name__ == "__main__":
    unittest.main()
