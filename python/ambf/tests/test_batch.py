"""Many worlds of one scene in one object."""

import pathlib
import tempfile
import threading
import unittest

import ambf
import numpy as np

RESOURCES = pathlib.Path(__file__).resolve().parents[3] / "resources"
LAUNCH = RESOURCES / "launch.yaml"
ARM = RESOURCES / "models/arm7.yaml"
N = 5


def batch(n=N, model=ARM, **options):
    return ambf.Batch(model, n, launch_file=LAUNCH, **options)


class Batches(unittest.TestCase):
    """Each world does what it would do alone."""

    def test_contacts_are_those_of_simulations(self):
        """Of a box on the ground, in each world with its own mass; what hovers has none."""
        model = (
            "bodies: [BODY ground, BODY box]\n"
            "BODY ground: {name: ground, mass: 0, collision shape: Box, collision geometry: {x: 1, y: 1, z: 0.1},"
            " location: {position: {x: 0, y: 0, z: -0.05}}}\n"
            "BODY box: {name: box, mass: 1, collision shape: Box, collision geometry: {x: 0.1, y: 0.1, z: 0.1},"
            " location: {position: {x: 0, y: 0, z: 0.05}}}\n"
        )
        with tempfile.TemporaryDirectory() as folder:
            file = pathlib.Path(folder) / "box.yaml"
            file.write_text(model)
            worlds, sim = (
                batch(3, file, profile="accurate"),
                ambf.Simulation(file, launch_file=LAUNCH, profile="accurate"),
            )
        masses = np.array([1.0, 2.0, 3.0])
        worlds.set_parameters(masses={"box": masses})
        poses = np.full_like(worlds.poses, np.nan)
        poses[1, worlds.body("box")] = (0, 0, 0.5, 0, 0, 0, 1)
        worlds.reset(np.array([False, True, False]), poses=poses)
        worlds.step(100)
        sim.step(100)
        found, alone = worlds.contacts(), sim.contacts()
        self.assertEqual(set(found.worlds.tolist()), {0, 2})
        first = found.worlds == 0
        np.testing.assert_array_equal(found.bodies[first], alone.bodies)
        for name in ("points", "normals", "distances", "forces", "friction_forces", "frictions"):
            np.testing.assert_array_equal(getattr(found, name)[first], getattr(alone, name), err_msg=name)
        weights = found.normal_forces(3, worlds.body("box"))
        np.testing.assert_allclose(weights, [9.81, 0.0, 3 * 9.81], rtol=1e-6)

    def test_sensors_are_those_of_simulations(self):
        """Rays that see and that push, and contacts, of boxes of other masses in each world, through a reset; in both profiles."""
        models = [RESOURCES / "models" / name for name in ("touch.yaml", "gripper.yaml")]
        for profile in ("accurate", "legacy"):
            worlds = batch(N, models, profile=profile)
            self.addCleanup(worlds.close)
            sims = [ambf.Simulation(models, launch_file=LAUNCH, profile=profile) for _ in range(N)]
            self.assertEqual(worlds.sensors, sims[0].sensors)
            self.assertEqual(worlds.sensor_types, ("resistance", "contact", "proximity"))
            self.assertEqual((worlds.measurements.shape, worlds.sensed.shape), ((N, 5), (N, 5)))
            self.assertEqual((worlds.contact_forces.shape, worlds.touching.shape), ((N, 1), (N, 1)))
            masses = np.linspace(0.1, 0.5, N)
            worlds.set_parameters(masses={"plate": masses, "touch/box": masses})
            for sim, mass in zip(sims, masses):
                sim.set_parameters(masses={"plate": mass, "touch/box": mass})
            seen, touched = set(), set()
            for call in range(40):
                if call == 30:
                    worlds.reset(np.arange(N) % 2 == 0)
                    for sim in sims[::2]:
                        sim.reset()
                worlds.step(20)
                ambf.step_all(sims, 20)
                np.testing.assert_array_equal(worlds.measurements, [sim.measurements for sim in sims])
                for i, sim in enumerate(sims):
                    for name, kind in zip(worlds.sensors, worlds.sensor_types):
                        measured, names = sim.sensor(name).readings()
                        columns = worlds.columns(name)
                        if kind == "contact":
                            forces, counts = worlds.contact_forces[i, columns], worlds.touching[i, columns]
                            self.assertEqual((forces.tolist(), counts.tolist()), ([sum(measured)], [len(measured)]))
                            touched.add(len(measured))
                            continue
                        np.testing.assert_array_equal(worlds.measurements[i, columns], measured)
                        places = worlds.sensed[i, columns]
                        found = [worlds.bodies[place].split("/")[-1] if place >= 0 else "" for place in places]
                        self.assertEqual(found, list(names))
                        np.testing.assert_array_equal(places == -2, measured == 0.0)
                        seen.update(found)
            self.assertTrue({"", "plate", "block"} <= seen, seen)
            self.assertEqual(touched, {0, 1})
            self.assertRaises(ambf.NotFoundError, worlds.columns, "eye")

    def test_actuators_are_those_of_simulations(self):
        """What the palm's ray sees, or a body, is held in some worlds, at different times; resets let go."""
        model = RESOURCES / "models/gripper.yaml"
        for names in ({"sensor": "proximity"}, {"body": "gripper/block"}):
            worlds = batch(N, model)
            self.addCleanup(worlds.close)
            sims = [ambf.Simulation(model, launch_file=LAUNCH) for _ in range(N)]
            holders = [sim.actuator("holder") for sim in sims]
            self.assertEqual((worlds.actuators, worlds.holding.shape), (sims[0].actuators, (N, 1)))
            rng = np.random.default_rng(1)
            seen = set()
            for call in range(40):
                if call >= 8:
                    hold, mask = rng.random(N) < 0.6, rng.random(N) < 0.5
                    worlds.hold("holder", hold, mask, **names)
                    for i in np.flatnonzero(mask):
                        holders[i].hold(**names) if hold[i] else holders[i].release()
                if call == 30:
                    worlds.reset(np.arange(N) % 2 == 0)
                    for sim in sims[::2]:
                        sim.reset()
                worlds.step(100 if call == 0 else 5)
                ambf.step_all(sims, 100 if call == 0 else 5)
                np.testing.assert_array_equal(worlds.holding, [sim.holding for sim in sims])
                np.testing.assert_array_equal(worlds.poses, [sim.poses for sim in sims])
                seen.update(worlds.holding.ravel().tolist())
            self.assertEqual(seen, {False, True}, names)
        worlds.hold("holder", body="block")
        worlds.step(2)
        self.assertTrue(worlds.holding.all())
        worlds.release("holder", np.arange(N) == 1)
        worlds.step(2)
        self.assertEqual(np.flatnonzero(~worlds.holding[:, 0]).tolist(), [1])

    def test_wrong_commands_of_actuators(self):
        """They are said, and nothing is held."""
        worlds = batch(2, RESOURCES / "models/gripper.yaml")
        self.addCleanup(worlds.close)
        for name, names in (("hand", {"body": "block"}), ("holder", {"body": "brick"}), ("holder", {"sensor": "nose"})):
            self.assertRaises(ambf.NotFoundError, worlds.hold, name, **names)
        for wrong in (
            lambda: worlds.hold("holder"),
            lambda: worlds.hold("holder", body="block", sensor="proximity"),
            lambda: worlds.hold("holder", np.ones(3, dtype=bool), body="block"),
            lambda: worlds.hold("holder", True, np.ones((2, 1), dtype=bool), body="block"),
            lambda: worlds.hold("holder", 1.0, body="block"),
        ):
            self.assertRaises(ValueError, wrong)
        worlds.step(5)
        self.assertFalse(worlds.holding.any())
        worlds.close()
        self.assertRaises(ambf.ClosedError, worlds.release, "holder")

    def test_a_scene_without_sensors(self):
        """The arrays are empty."""
        worlds = batch(2)
        self.addCleanup(worlds.close)
        worlds.step(1)
        self.assertEqual((worlds.sensors, worlds.sensor_types), ((), ()))
        for array in (worlds.measurements, worlds.sensed, worlds.contact_forces, worlds.touching):
            self.assertEqual(array.shape, (2, 0))

    def test_worlds_are_those_of_simulations_to_the_bit(self):
        """Under commands of all kinds, through resets of some, with parameters of their own; in both profiles."""
        for profile in ("accurate", "legacy"):
            worlds = batch(profile=profile)
            sims = [ambf.Simulation(ARM, launch_file=LAUNCH, profile=profile) for _ in range(N)]
            self.assertEqual((worlds.bodies, worlds.joints), (sims[0].bodies, sims[0].joints))
            flange = sims[0].body("arm7/flange").index
            rng = np.random.default_rng(1)
            masses = rng.uniform(0.2, 2, size=N)
            worlds.set_parameters(masses={"flange": masses}, frictions=0.7, joint_gains=[20.0, 0.0, 1.0])
            for sim, mass in zip(sims, masses):
                sim.set_parameters(masses={"flange": mass}, frictions=0.7, joint_gains=[20.0, 0.0, 1.0])
            np.testing.assert_array_equal(worlds.parameters()["masses"], [sim.masses for sim in sims])
            for call in range(12):
                base = sims[0].body("arm7/base")
                kinds = rng.integers(-1, 3, size=(N, len(base.joints)))
                values = rng.uniform(-1, 1, size=(N, len(base.joints)))
                wrenches = rng.uniform(-2, 2, size=(N, 6))
                worlds.joint_kinds[:, base.joint_indices] = kinds
                worlds.joint_commands[:, base.joint_indices] = values
                worlds.kinds[:, flange], worlds.wrenches[:, flange] = ambf.FORCE, wrenches
                for sim, kind, value, wrench in zip(sims, kinds, values, wrenches):
                    arm = sim.body("arm7/base")
                    arm.joint_kinds, arm.joint_commands = kind, value
                    sim.body("arm7/flange").kind, sim.body("arm7/flange").wrench = ambf.FORCE, wrench
                worlds.step(7)
                ambf.step_all(sims, 7)
                for name in ("poses", "twists", "joint_positions", "joint_velocities", "joint_efforts"):
                    expected = np.array([getattr(sim, name) for sim in sims])
                    np.testing.assert_array_equal(getattr(worlds, name), expected, err_msg=f"{profile} {name} {call}")
                if call % 4 == 3:
                    mask = rng.random(N) < 0.5
                    states = rng.uniform(-0.3, 0.3, size=(N, len(worlds.joints)))
                    states[:, [i for i, kind in enumerate(sims[0].joint_types) if kind != "revolute"]] = np.nan
                    worlds.reset(mask, joint_positions=states)
                    for sim, state, is_reset in zip(sims, states, mask):
                        if is_reset:
                            sim.reset()
                            sim.set_state(joint_positions=state)
                    self.assertTrue((worlds.kinds[mask] == ambf.NONE).all())

    def test_arrays_are_shared(self):
        """Contiguous, the same object for good, and by DLPack without a copy."""
        worlds = batch()
        poses = worlds.poses
        other = np.from_dlpack(poses)
        self.assertTrue(poses.flags.c_contiguous and np.shares_memory(poses, other))
        before = other.copy()
        worlds.step(100)
        self.assertIs(worlds.poses, poses)
        self.assertTrue((other != before).any() and (other == poses).all())
        self.assertEqual(poses.shape, (N, len(worlds.bodies), 7))
        np.testing.assert_allclose(worlds.times, 0.1)
        self.assertIn(f"{N} worlds", repr(worlds))
        worlds.close()
        np.testing.assert_array_equal(other, poses)
        self.assertRaises(ambf.ClosedError, worlds.step)

    def test_random_starts(self):
        """The same seed gives a world the same, whoever else is reset; within limits."""
        worlds = batch()
        places = [i for i, name in enumerate(worlds.joints) if name in ("yaw", "shoulder", "elbow")]
        noise = np.zeros(len(worlds.joints))
        noise[places] = 0.1
        worlds.reset(noise=noise, seed=3)
        start = np.array([batch(1).joint_positions[0, places]])
        first = worlds.joint_positions[:, places].copy()
        self.assertGreater(np.ptp(first, axis=0).min(), 0.0)
        self.assertLessEqual(abs(first - start).max(), 0.1 + 1e-9)
        worlds.step(50)
        only = np.arange(N) == 2
        moved = worlds.joint_positions.copy()
        worlds.reset(only, noise=noise, seed=3)
        np.testing.assert_array_equal(worlds.joint_positions[2, places], first[2])
        np.testing.assert_array_equal(worlds.joint_positions[~only], moved[~only])

    def test_what_is_lost_stands_still(self):
        """The others go on; a reset brings it back."""
        worlds = batch(model=RESOURCES / "models/free_bodies.yaml")
        body = next(i for i, mass in enumerate(worlds.parameters()["masses"][0]) if mass > 0)
        worlds.kinds[1, body], worlds.target_twists[1, body] = ambf.VELOCITY, 1e300
        worlds.step(3)
        self.assertEqual(worlds.lost.tolist(), [False, True, False, False, False])
        self.assertIn("became", worlds.problems()[1])
        times = worlds.times.copy()
        worlds.step(2)
        self.assertTrue((np.delete(worlds.times - times, 1) > 0).all())
        worlds.reset(worlds.lost.copy())
        self.assertFalse(worlds.lost.any())
        worlds.step(5)
        self.assertFalse(worlds.lost.any())

    def test_what_is_wrong_is_said(self):
        """And nothing moves."""
        worlds = batch(2)
        self.assertRaises(ValueError, batch, 0)
        self.assertRaises(ambf.LoadError, ambf.Batch, "/none.yaml", 2)
        before = worlds.poses.copy()
        worlds.joint_kinds[1, 0], worlds.joint_commands[1, 0] = ambf.POSITION, np.nan
        with self.assertRaisesRegex(ambf.InvalidCommand, "world 1"):
            worlds.step(5)
        worlds.joint_kinds[1, 0] = 9
        self.assertRaises(ambf.InvalidCommand, worlds.step)
        np.testing.assert_array_equal(worlds.poses, before)
        worlds.joint_kinds[:] = ambf.NONE
        for call in (
            lambda: worlds.step(-1),
            lambda: worlds.reset([True]),
            lambda: worlds.reset(noise=-1.0),
            lambda: worlds.reset(seed=-1),
            lambda: worlds.reset(joint_positions=np.zeros(3)),
            lambda: worlds.set_parameters(mass=1),
            lambda: worlds.set_parameters(masses={"flange": [1, -1]}),
            lambda: worlds.set_parameters(masses={"flange": [1, 2, 3]}),
        ):
            self.assertRaises(ValueError, call)
        self.assertRaises(ambf.NotFoundError, worlds.set_parameters, masses={"none": 1})
        masses = worlds.parameters()["masses"]
        np.testing.assert_array_equal(masses[0], masses[1])
        far = np.full((2, len(worlds.joints)), np.nan)
        far[1, worlds.joints.index("elbow")] = 100.0
        with self.assertRaisesRegex(ambf.StateError, "world 1"):
            worlds.reset(joint_positions=far)

    def test_one_thread_at_a_time(self):
        """Another one gets a BusyError; Python goes on meanwhile."""
        worlds = batch(4)
        ticks = []
        thread = threading.Thread(target=worlds.step, args=(3000,))
        thread.start()
        while thread.is_alive():
            ticks.append(1)
            try:
                worlds.step(0)
            except ambf.BusyError:
                break
        thread.join()
        self.assertTrue(ticks)


if __name__ == "__main__":
    unittest.main()
