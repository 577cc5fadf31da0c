"""Masses, surfaces, limits, gains, gravity and colours that are changed while the simulation runs."""

import pathlib
import tempfile
import unittest

import ambf
import numpy as np

RESOURCES = pathlib.Path(__file__).resolve().parents[3] / "resources"
LAUNCH = RESOURCES / "launch.yaml"
PROFILES = ("accurate", "legacy")

BLOCK = """
bodies: [BODY block]
joints: []
BODY block:
  name: block
  mass: 2
  collision shape: Box
  collision geometry: {x: 0.2, y: 0.2, z: 0.2}
  location: {position: {x: 0, y: 0, z: 1}, orientation: {r: 0, p: 0, y: 0}}
  friction: {static: 0.5, rolling: 0}
  restitution: 0
  damping: {linear: 0, angular: 0}
"""

WORLD = """
gravity: {x: 0, y: 0, z: -10}
environment: ./ground.yaml
max iterations: 10
"""

GROUND = """
bodies: [BODY ground]
BODY ground:
  name: ground
  mass: 0
  collision shape: Plane
  collision geometry: {normal: {x: 0, y: 0, z: 1}, offset: 0}
  friction: {static: 1, rolling: 0}
  restitution: 1
"""

TWO = """
<robot name="two"><link name="world"/>
<joint name="a" type="continuous"><parent link="world"/><child link="upper"/><axis xyz="0 1 0"/></joint>
<link name="upper"><inertial><origin xyz="0.1 0 0.05"/><mass value="1.5"/>
  <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="b" type="prismatic"><origin xyz="0.3 0 0"/><parent link="upper"/><child link="lower"/>
  <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1000" velocity="100"/></joint>
<link name="lower"><inertial><mass value="0.7"/>
  <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>
"""

FREE = TWO.replace('<link name="world"/>', "").replace(
    '<joint name="a" type="continuous"><parent link="world"/><child link="upper"/><axis xyz="0 1 0"/></joint>', ""
)

SLED = """
<robot name="sled"><link name="sled"><inertial><mass value="2"/>
  <inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><box size="0.4 0.4 0.2"/></geometry></collision></link>
<joint name="j" type="revolute"><origin xyz="0 0 0.1"/><parent link="sled"/><child link="top"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1" effort="10" velocity="10"/></joint>
<link name="top"><inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>
"""

FILES = {
    "sled.urdf": SLED,
    "block.yaml": BLOCK,
    "world.yaml": WORLD,
    "ground.yaml": GROUND,
    "two.urdf": TWO,
    "free.urdf": FREE,
}


class Changes(unittest.TestCase):
    """They are seen in the motion."""

    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = pathlib.Path(folder.name)
        for name, text in FILES.items():
            (cls.folder / name).write_text(text)

    def load(self, name, profile, **options):
        return ambf.Simulation(self.folder / name, world=self.folder / "world.yaml", profile=profile, **options)

    def block(self, profile, **options):
        sim = self.load("block.yaml", profile, **options)
        return sim, sim.body("block")

    def arm(self, profile):
        """Two joints that nothing drives."""
        sim = self.load("two.urdf", profile)
        sim.body("two/world").joint_kinds = ambf.EFFORT
        sim.step(2)
        return sim, sim.tree("upper")

    def let_go(self, sim, tree):
        """Whether the accelerations are those that follow from the tree's masses."""
        sim.set_state(
            joint_positions=dict(zip(tree.joints, (0.4, 0.1))), joint_velocities=dict(zip(tree.joints, (0.8, -0.5)))
        )
        sim.step(4)
        rates, before = tree.rates, np.linalg.solve(tree.mass_matrix(), -tree.bias_forces())
        sim.step(4)
        after = np.linalg.solve(tree.mass_matrix(), -tree.bias_forces())
        np.testing.assert_allclose((tree.rates - rates) / 0.004, (before + after) / 2, rtol=0.04, atol=0.02)
        return before

    def test_a_pushed_body_has_the_new_mass_and_gravity(self):
        """Force and torque, before and after."""
        for profile in PROFILES:
            sim, block = self.block(profile)
            sim.set_parameters(gravity=(0, 0, 0))
            np.testing.assert_array_equal(sim.gravities[block.index], np.zeros(3))
            inertia = sim.inertias[block.index].copy()
            for mass in (2.0, 0.5, 8.0):
                sim.set_parameters(masses={"block": mass})
                self.assertEqual(sim.masses[block.index], mass)
                np.testing.assert_allclose(sim.inertias[block.index], inertia * mass / 2, rtol=1e-12)
                sim.set_state(twists={"block": np.zeros(6)})
                block.kind, block.wrench = ambf.FORCE, (4, 0, 0, 0, 0, 0.01)
                sim.step(101)
                expected = 0.1 * np.array([4 / mass, 0, 0, 0, 0, 0.01 / sim.inertias[block.index, 2]])
                np.testing.assert_allclose(block.twist, expected, rtol=0.011, atol=1e-9, err_msg=profile)
            sim.set_parameters(inertias={"block": (1, 2, 3)})
            np.testing.assert_array_equal(sim.inertias[block.index], (1, 2, 3))
            sim.set_state(twists={"block": np.zeros(6)})
            sim.step(101)
            self.assertAlmostEqual(block.twist[5], 0.1 * 0.01 / 3, delta=1e-5)
            sim.set_parameters(gravities={"block": (0, 1, 0)}, gravity=(0, 0, -3))
            block.kind = ambf.NONE
            sim.set_state(twists={"block": np.zeros(6)})
            sim.step(101)
            np.testing.assert_allclose(block.twist[:3], (0, 0.1, 0), atol=2e-3, err_msg="its own gravity")

    def test_trees_have_the_new_masses(self):
        """Those with a base that stands, and free ones."""
        for profile in PROFILES:
            sim, tree = self.arm(profile)
            first = self.let_go(sim, tree)
            matrix = tree.mass_matrix()
            sim.set_parameters(masses={"lower": 2.5, "upper": 0.4}, inertias={"upper": (0.1, 0.2, 0.15)})
            self.assertGreater(abs(tree.mass_matrix() - matrix).max(), 0.1)
            second = self.let_go(sim, tree)
            self.assertGreater(abs(second - first).max(), 0.5)
            sim.set_parameters(gravity=(0, 0, 5))
            self.assertGreater(abs(self.let_go(sim, tree) - second).max(), 5)
            sim.reset()
            self.assertEqual(sim.masses[sim.body("lower").index], 2.5, "resets keep it")
            sim.body("two/world").joint_kinds = ambf.EFFORT
            sim.step(2)
            self.let_go(sim, tree)
            free = self.load("free.urdf", profile)
            free.set_parameters(gravity=(0, 0, 0))
            free.body("upper").joint_kinds = ambf.EFFORT
            for masses in ((1.5, 0.7), (3.0, 9.0)):
                free.set_parameters(masses=dict(zip(("upper", "lower"), masses)))
                free.reset()
                free.body("upper").joint_kinds = ambf.EFFORT
                upper, lower = free.body("upper"), free.body("lower")
                lower.kind, lower.wrench = ambf.FORCE, (0, 6, 0, 0, 0, 0)
                free.step(101)
                momentum = masses[0] * upper.twist[:3] + masses[1] * lower.twist[:3]
                np.testing.assert_allclose(momentum, (0, 0.6, 0), rtol=0.02, atol=2e-3, err_msg=profile)

    def test_friction(self):
        """It holds or gives way, also of contacts that are there; the contacts tell its force."""
        for profile in PROFILES:
            sim, block = self.block(profile)
            sim.set_state(poses={"block": (0, 0, 0.1, 0, 0, 0, 1)})
            block.kind, block.wrench = ambf.FORCE, (6, 0, 0, 0, 0, 0)
            sim.step(300)
            self.assertLess(abs(block.twist[0]), 0.01, f"{profile}: 6 N are less than 0.5 · 20 N")
            contacts = sim.contacts()
            sign = np.where(contacts.bodies[:, 0] == block.index, 1.0, -1.0)
            np.testing.assert_allclose(contacts.frictions, 0.5)
            total = (sign[:, None] * contacts.friction_forces).sum(axis=0)
            np.testing.assert_allclose(total, (-6, 0, 0), atol=0.3, err_msg=profile)
            self.assertAlmostEqual(contacts.forces.sum(), 20, delta=0.4)
            sim.set_parameters(frictions={"block": 0.1})
            np.testing.assert_allclose(sim.contacts().frictions, 0.1)
            sim.step(1)
            before = block.twist[0]
            sim.step(200)
            self.assertAlmostEqual((block.twist[0] - before) / 0.2, (6 - 2) / 2, delta=0.1, msg=profile)

    def test_contacts_of_trees(self):
        """A tree that is pushed over the ground: friction and weight are those of now."""
        for profile in PROFILES:
            sim = self.load("sled.urdf", profile)
            sled = sim.body("sled/sled")
            sim.set_state(poses={"sled/sled": (0, 0, 0.1, 0, 0, 0, 1)})
            sled.kind, sled.wrench = ambf.FORCE, (4, 0, 0, 0, 0, 0)
            sim.step(300)
            contacts = sim.contacts()
            sign = np.where(contacts.bodies[:, 0] == sled.index, 1.0, -1.0)
            np.testing.assert_allclose((sign[:, None] * contacts.friction_forces).sum(axis=0), (-4, 0, 0), atol=0.05)
            sim.set_parameters(frictions={"sled/sled": 0.05})
            for top in (1.0, 4.0):
                sim.set_parameters(masses={"top": top})
                weight = 10 * (2 + top)
                sim.step(1)
                before = sled.twist[0]
                sim.step(100)
                self.assertAlmostEqual(
                    (sled.twist[0] - before) / 0.1, (4 - 0.05 * weight) / (2 + top), delta=0.02, msg=profile
                )
                self.assertAlmostEqual(sim.contacts().forces.sum(), weight, delta=3)

    def test_restitution_and_damping(self):
        """A block that bounces, and one that is braked."""
        for profile in PROFILES:
            for restitution, least, most in ((0.0, -1.0, 0.3), (0.8, 0.5, 3.0)):
                sim, block = self.block(profile)
                sim.set_parameters(restitutions={"block": restitution})
                sim.set_state(poses={"block": (0, 0, 0.3, 0, 0, 0, 1)})
                fastest = max((sim.step(1), block.twist[2])[1] for _ in range(400))
                self.assertTrue(least < fastest < most, f"{profile} {restitution}: {fastest}")
            sim, block = self.block(profile)
            sim.set_parameters(gravity=(0, 0, 0), dampings={"block": (0.9, 0.5)})
            sim.set_state(twists={"block": (1, 0, 0, 0, 0, 1)})
            sim.step(1001)
            np.testing.assert_allclose(block.twist, (0.1, 0, 0, 0, 0, 0.5), rtol=0.02, atol=1e-6)

    def test_damping_and_friction_of_joints(self):
        """The slider is braked as its damping says, from none on, and again when it changes."""
        for profile in PROFILES:
            sim, tree = self.arm(profile)
            sim.set_parameters(gravity=(0, 0, 0))
            b = tree.joints.index("b")
            for damping in (0.0, 3.5, 14.0, 0.0):
                sim.set_parameters(joint_dampings={"b": damping})
                sim.set_state(joint_positions={"a": 0, "b": 0}, joint_velocities={"a": 0, "b": 1.0})
                sim.step(102)
                expected = np.exp(-damping / 0.7 * 0.1)
                self.assertAlmostEqual(tree.rates[b], expected, delta=0.03, msg=f"{profile} {damping}")
            sim.set_parameters(joint_frictions={"b": 1.4})
            sim.set_state(joint_positions={"a": 0, "b": 0}, joint_velocities={"a": 0, "b": 1.0})
            sim.step(102)
            self.assertAlmostEqual(tree.rates[b], 0.8, delta=0.02, msg=profile)

    def test_limits_of_joints(self):
        """A slider is stopped where its limit is now, and set_state knows it."""
        for profile in PROFILES:
            sim, _ = self.arm(profile)
            sim.set_parameters(gravity=(0, 0, 0), joint_limits={"b": (-0.2, 0.15)})
            self.assertEqual(sim.joint_limits[sim.joints.index("b")].tolist(), [-0.2, 0.15])
            sim.set_state(joint_positions={"a": 0, "b": 0}, joint_velocities={"b": 1.0})
            sim.step(500)
            self.assertLess(sim.joint_positions[sim.joints.index("b")], 0.16, profile)
            self.assertRaises(ambf.StateError, sim.set_state, joint_positions={"b": 0.5})
            sim.set_parameters(joint_limits={"b": (-np.inf, np.inf)})
            sim.set_state(joint_positions={"a": 0, "b": 0}, joint_velocities={"b": 10.0})
            sim.step(300)
            self.assertGreater(sim.joint_positions[sim.joints.index("b")], 1.5, profile)

    def test_gains(self):
        """A joint goes twice as fast to its goal with twice the gain."""
        rates = []
        for profile in PROFILES:
            for gain in (2.0, 4.0):
                sim = self.load("two.urdf", profile)
                sim.set_parameters(joint_gains={"b": (gain, 0, 0)}, gravity=(0, 0, 0))
                self.assertEqual(sim.joint_gains[sim.joints.index("b")].tolist(), [gain, 0, 0])
                base = sim.body("two/world")
                base.joint_kinds[base.joints.index("b")] = ambf.POSITION
                base.joint_commands[base.joints.index("b")] = 0.5
                sim.step(10)
                rates.append(sim.joint_velocities[sim.joints.index("b")])
            self.assertAlmostEqual(rates[-1] / rates[-2], 2.0, delta=0.1, msg=profile)
            speeds = []
            for gain in (2.0, 4.0):
                sim, block = self.block(profile)
                sim.set_parameters(body_gains={"block": (gain, 0, gain, 0)}, gravity=(0, 0, 0))
                self.assertEqual(sim.body_gains[block.index].tolist(), [gain, 0, gain, 0])
                block.kind, block.target_pose = ambf.POSITION, (0.2, 0, 1, 0, 0, 0, 1)
                sim.step(10)
                speeds.append(block.twist[0])
            self.assertAlmostEqual(speeds[1] / speeds[0], 2.0, delta=0.1, msg=profile)

    def test_resets_keep_and_restores_bring_back(self):
        """And what follows is what it would be of a scene with such files."""
        for profile in PROFILES:
            sim, block = self.block(profile, saving=True)
            sim.step(50)
            state = sim.save()
            sim.step(100)
            expected = sim.poses.copy()
            sim.set_parameters(masses={"block": 1}, frictions={"block": 0.2}, gravity=(1, 0, -5))
            changed = sim.save()
            sim.step(100)
            other = sim.poses.copy()
            sim.restore(state)
            self.assertEqual((sim.masses[block.index], sim.gravity[2]), (2.0, -10.0))
            sim.step(100)
            np.testing.assert_array_equal(sim.poses, expected)
            sim.restore(changed)
            self.assertEqual((sim.masses[block.index], sim.gravity[2]), (1.0, -5.0))
            sim.step(100)
            np.testing.assert_array_equal(sim.poses, other)
            sim.reset()
            self.assertEqual(sim.frictions[block.index], 0.2)
            sim.step(200)
            fresh, _ = self.block(profile)
            fresh.set_parameters(masses={"block": 1}, frictions={"block": 0.2}, gravity=(1, 0, -5))
            fresh.reset()
            fresh.step(200)
            np.testing.assert_array_equal(sim.poses, fresh.poses, err_msg=profile)

    def test_what_is_refused_changes_nothing(self):
        """Numbers out of range, shapes, what stands still, other joints."""
        sim, block = self.block("accurate")
        wrong = (
            {"masses": {"block": 0}},
            {"masses": {"block": -1}},
            {"masses": {"block": np.inf}},
            {"masses": {"ground": 1}},
            {"masses": [1.0, 2.0, 3.0]},
            {"inertias": {"block": (1, 1)}},
            {"inertias": {"block": (1, 1, 0)}},
            {"frictions": {"block": -0.1}},
            {"restitutions": {"block": 1.5}},
            {"dampings": {"block": (0, 2)}},
            {"gravity": (0, 0, np.inf)},
            {"colors": {"block": (0, 0, 2, 1)}},
        )
        for values in wrong:
            with self.assertRaises(ValueError, msg=values):
                sim.set_parameters(**{"frictions": {"block": 0.3}, **values})
            self.assertEqual((sim.masses[block.index], sim.frictions[block.index]), (2.0, 0.5))
        self.assertRaises(ambf.NotFoundError, sim.set_parameters, masses={"blok": 1})
        with self.assertRaisesRegex(AttributeError, "set_parameters"):
            sim.masses = 3
        sim.set_parameters(masses=sim.masses * 2, inertias=sim.inertias, frictions=np.nan)
        self.assertEqual((sim.masses[block.index], sim.frictions[block.index]), (4.0, 0.5))
        four = ambf.Simulation(RESOURCES / "models/joints.yaml", launch_file=LAUNCH)
        balls = [i for i, kind in enumerate(four.joint_types) if kind not in ("revolute", "prismatic")]
        with self.assertRaisesRegex(ValueError, "neither revolute nor prismatic"):
            four.set_parameters(joint_limits={balls[0]: (0, 1)})
        for limits in ((1, 0), (0, np.inf)):
            with self.assertRaisesRegex(ValueError, "lower limit"):
                four.set_parameters(joint_limits={0: limits})


class Models(unittest.TestCase):
    """Models that come and go."""

    def test_models_come_and_go(self):
        """What was there keeps its state, commands and handles."""
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        robot = pathlib.Path(folder.name) / "two.urdf"
        robot.write_text(TWO)
        for profile in PROFILES:
            sim = ambf.Simulation(RESOURCES / "models/arm7.yaml", launch_file=LAUNCH, profile=profile)
            alone = ambf.Simulation(RESOURCES / "models/arm7.yaml", launch_file=LAUNCH, profile=profile)
            bodies, joints = sim.bodies, sim.joints
            for one in (sim, alone):
                arm = one.body("arm7/base")
                arm.joint_kinds, arm.joint_commands = ambf.POSITION, 0.2
                one.step(50)
            arm, flange = sim.body("arm7/base"), sim.body("arm7/flange")
            # It has nothing that collides.
            name = sim.add_model(robot)
            self.assertIn(name, sim.models)
            self.assertEqual(sim.bodies[: len(bodies)], bodies)
            self.assertGreater(len(sim.bodies), len(bodies))
            # As after `set_state`, the state before the next commands is shown, and shown once more by the next iteration.
            sim.step(1)
            alone.step(1)
            np.testing.assert_array_equal(flange.pose, alone.body("arm7/flange").pose)
            self.assertTrue((arm.joint_kinds == ambf.POSITION).all())
            self.assertIs(sim.body("arm7/base"), arm)
            upper = sim.body("two/upper")
            sim.step(100)
            alone.step(100)
            np.testing.assert_allclose(flange.pose, alone.body("arm7/flange").pose, atol=1e-6)
            self.assertEqual(sim.remove_model(name), name)
            self.assertEqual((sim.bodies, sim.joints), (bodies, joints))
            sim.step(100)
            alone.step(100)
            np.testing.assert_allclose(flange.pose, alone.body("arm7/flange").pose, atol=1e-6)
            self.assertEqual(upper.pose.shape, (7,), "its arrays stay what they are")
            again = sim.add_model(robot)
            sim.step(10)
            self.assertIn("/two/upper", " ".join(sim.bodies))
            self.assertEqual(len(sim.joints), len(joints) + 2)
            self.assertEqual(sim.tree("two/upper").joints, ("a", "b"))
            sim.reset()
            self.assertIn(again, sim.models)

    def test_handles_find_theirs(self):
        """Sensors, actuators and trees stand elsewhere when models before them are gone."""
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        robot = pathlib.Path(folder.name) / "two.urdf"
        robot.write_text(TWO)
        gripper = RESOURCES / "models/gripper.yaml"
        sim = ambf.Simulation([robot], launch_file=LAUNCH)
        first = sim.models[-1]
        sim.add_model(gripper)
        eye, holder, palm = sim.sensor("proximity"), sim.actuator("holder"), sim.body("gripper/palm")
        tree = sim.tree("two/upper")
        second = sim.add_model(robot)
        later = sim.tree(next(name for name in sim.bodies[::-1] if "upper" in name))
        matrix = later.mass_matrix(joint_positions=(0.1, 0.2))
        sim.remove_model(first)
        np.testing.assert_array_equal(later.mass_matrix(joint_positions=(0.1, 0.2)), matrix)
        self.assertEqual([sim.joints[i] for i in later.joint_indices], ["a", "b"])
        self.assertRaises(ambf.NotFoundError, tree.mass_matrix)
        eye.readings()
        holder.hold(body="BODY block")
        sim.step(5)
        self.assertTrue(holder.holding)
        self.assertEqual(palm.index, sim.bodies.index(palm.name))
        sim.remove_model("gripper")
        self.assertRaises(ambf.NotFoundError, eye.readings)
        self.assertRaises(ambf.NotFoundError, holder.release)
        self.assertIn(second, sim.models)

    def test_what_can_not_be_added_or_removed(self):
        """It is said, and nothing has changed."""
        sim = ambf.Simulation(RESOURCES / "models/arm7.yaml", launch_file=LAUNCH)
        bodies = sim.bodies
        with tempfile.TemporaryDirectory() as folder:
            empty = pathlib.Path(folder) / "empty.yaml"
            empty.write_text("bodies: [A\n  B: {")
            for file in (pathlib.Path(folder) / "none.yaml", empty):
                self.assertRaises(ambf.LoadError, sim.add_model, file)
        self.assertRaises(ambf.NotFoundError, sim.remove_model, "gripper")
        self.assertRaises(ambf.NotFoundError, sim.remove_model, sim.models[0])
        sim.step(3)
        self.assertEqual((sim.bodies, sim.sim_step), (bodies, 3))
        sim.close()
        self.assertRaises(ambf.ClosedError, sim.add_model, RESOURCES / "models/gripper.yaml")

    def test_what_is_said_of_it(self):
        """Profile, version, and words for each handle."""
        for options, profile in (
            ({}, "accurate"),
            ({"profile": "legacy"}, "legacy"),
            ({"profile": "pybullet"}, "pybullet"),
        ):
            sim = ambf.Simulation(RESOURCES / "models/gripper.yaml", launch_file=LAUNCH, **options)
            self.assertEqual(sim.profile, profile)
            self.assertEqual(sim.version, ambf.__version__)
            self.assertRegex(repr(sim), rf"<ambf.Simulation: {profile}, 2 models, {len(sim.bodies)} bodies")
        self.assertRegex(repr(sim.body("palm")), "gripper/palm, 2 joints below, at")
        self.assertRegex(repr(sim.sensor(0)) + repr(sim.actuator(0)), "1 rays.*holds nothing")
        sim.close()
        self.assertIn("closed", repr(sim))
        with tempfile.TemporaryDirectory() as folder:
            world = pathlib.Path(folder) / "world.yaml"
            world.write_text("physics: {profile: legacy}\n")
            self.assertEqual(ambf.Simulation(world=world).profile, "legacy")
            self.assertEqual(ambf.Simulation(world=world, profile="accurate").profile, "accurate")


if __name__ == "__main__":
    unittest.main()
