"""The simulation in this process, without ROS."""

import contextlib
import gc
import os
import pathlib
import pickle
import signal
import subprocess
import sys
import tempfile
import textwrap
import threading
import time
import unittest
import warnings

import ambf
import numpy as np

RESOURCES = pathlib.Path(__file__).resolve().parents[3] / "resources"
LAUNCH = RESOURCES / "launch.yaml"
ARM = RESOURCES / "models/arm7.yaml"
GRIPPER = RESOURCES / "models/gripper.yaml"


def arm(**options):
    """The arm of seven joints."""
    return ambf.Simulation(ARM, launch_file=LAUNCH, **{"profile": "accurate", **options})


def drive(sim, seed, calls=30, clock=True):
    """Random commands of all kinds; everything that is seen, as bytes."""
    rng = np.random.default_rng(seed)
    base, flange = sim.body("arm7/base"), sim.body("arm7/flange")
    seen = []
    for _ in range(calls):
        base.joint_kinds[:] = rng.integers(-1, 3, size=len(base.joints))
        base.joint_commands[:] = rng.uniform(-1, 1, size=len(base.joints))
        flange.kind = ambf.FORCE
        flange.wrench[:] = rng.uniform(-5, 5, size=6)
        sim.step(int(rng.integers(1, 20)))
        seen.append(look(sim, clock))
    return b"".join(seen)


def look(sim, clock=True):
    """All states, as bytes, with the clock or without."""
    arrays = (sim.poses, sim.twists, sim.joint_positions, sim.joint_velocities, sim.joint_efforts)
    arrays += (sim.joint_wrenches, sim.measurements)
    time = repr((sim.sim_step, sim.sim_time)).encode() if clock else b""
    return b"".join(array.tobytes() for array in arrays) + time


class Loading(unittest.TestCase):
    """From files to arrays."""

    def test_short_steps_are_sub_steps(self):
        """Of their own length: the error of the first order falls with it, and the motion goes on in each of them."""
        ends = []
        for step in (0.001, 0.0005, 0.00025):
            sim = arm(step=step, integrator="euler")
            sim.set_state(joint_positions={1: 0.5})
            # The first iteration shows the state that was set.
            sim.step(round(0.2 / step) + 1)
            before = sim.joint_positions.copy()
            sim.step(1)
            self.assertTrue((sim.joint_positions != before).any(), f"{step} s")
            ends.append(before)
        first, second = (abs(ends[k] - ends[k + 1]).max() for k in (0, 1))
        self.assertGreater(first, 1.5 * second)
        self.assertGreater(second, 1e-9)

    def test_steps_that_are_no_whole_number_of_sub_steps_are_named(self):
        """As their number changes."""
        self.assertTrue(any("sub-steps of 0.001 s" in warning for warning in arm(step=0.0015).warnings))
        self.assertFalse(any("sub-steps" in warning for warning in arm(step=0.003).warnings))

    def test_what_there_is(self):
        """Names, shapes, and where things stand at the start."""
        sim = arm()
        self.assertEqual(sim.body("arm7/base").joints[0], "yaw")
        self.assertEqual(len(sim.body("arm7/base").joints), 7)
        n, m = len(sim.bodies), len(sim.joints)
        shapes = [array.shape for array in (sim.poses, sim.twists, sim.joint_positions, sim.kinds, sim.target_poses)]
        self.assertEqual(shapes, [(n, 7), (n, 6), (m,), (n,), (n, 7)])
        self.assertEqual((sim.sim_step, sim.sim_time), (1, 0.001))
        np.testing.assert_allclose(np.linalg.norm(sim.poses[:, 3:], axis=1), 1.0)
        self.assertIs(sim.body("arm7/base"), sim.body(sim.body("arm7/base").index))
        self.assertEqual(arm(indexes=[2]).bodies[-1], "/ambf/env/Link")
        self.assertEqual(ambf.Simulation(launch_file=LAUNCH, indexes=[2], world=None).bodies[-1], "/ambf/env/Link")
        gripper = ambf.Simulation(str(GRIPPER))
        self.assertEqual([name.split("/")[-1] for name in gripper.sensors + gripper.actuators], ["proximity", "holder"])

    def test_what_can_not_be_loaded(self):
        """Each problem is said with its place."""
        with tempfile.TemporaryDirectory() as folder:
            bad, odd = pathlib.Path(folder) / "bad.yaml", pathlib.Path(folder) / "odd.yaml"
            bad.write_text("bodies: [A\n  B: {")
            odd.write_text("bodies: [BODY A]\nBODY A: {name: A, mass: 1, mesh: none.STL}\n")
            for message, options in {
                r"nothing.yaml: cannot be read": {"models": "/nothing.yaml"},
                r"bad.yaml:2:.*syntax error": {"models": bad},
                r"launch.*cannot be read": {"models": (), "launch_file": "/launch"},
                r"no model 99: the launch file's list has \d+ \(0 to \d+\)": {"launch_file": LAUNCH, "indexes": [99]},
                r'profile="fast": not known.*accurate': {"profile": "fast"},
                r'solver="magic".*dantzig': {"solver": "magic"},
                r'integrator="magic"': {"integrator": "magic"},
                r"iterations=0": {"iterations": 0},
                r"step=0: expected": {"step": 0.0},
                r"step=NaN": {"step": float("nan")},
            }.items():
                with self.subTest(message), self.assertRaisesRegex(ambf.LoadError, message) as caught:
                    ambf.Simulation(**options)
                again = pickle.loads(pickle.dumps(caught.exception))
                self.assertTrue(again.problems)
                self.assertEqual(again.problems, caught.exception.problems)
            with self.assertRaises(TypeError):
                ambf.Simulation(ARM, indexes=["one"])
            sim = ambf.Simulation([odd])
            self.assertTrue(any("odd.yaml:2" in line for line in sim.warnings), sim.warnings)

    def test_the_lines_of_the_guide(self):
        """They run, from the root of the repository."""
        guide = (RESOURCES.parent / "docs/python.md").read_text().split("## In the Python process")[1]
        text = textwrap.dedent("    import ambf\n" + guide.split("    import ambf\n")[1].split("\n\n")[0])
        command = [sys.executable, "-c", text]
        done = subprocess.run(command, cwd=RESOURCES.parent, capture_output=True, text=True, timeout=60, check=False)
        self.assertTrue(done.stdout.startswith("1.0"), done.stderr)

    def test_steps_that_are_too_long(self):
        """What is lost is told."""
        sim = arm(step=0.5)
        self.assertTrue(any("is lost" in line for line in sim.warnings), sim.warnings)
        self.assertGreater(sim.lost_time, 0.1)
        sim = arm(step=0.005)
        self.assertFalse(any("is lost" in line for line in sim.warnings), sim.warnings)
        sim.step(10)
        self.assertEqual((sim.lost_time, round(sim.sim_time, 9)), (0.0, 0.05))

    def test_names(self):
        """A part is enough if it is unique; what a whole name ends with comes before other parts."""
        with tempfile.TemporaryDirectory() as folder:
            scene = pathlib.Path(folder) / "boxes.yaml"
            body = "BODY {0}: {{name: {0}, mass: 1, mesh: '', collision shape: BOX, collision geometry: {{x: 1, y: 1, z: 1}}}}\n"
            names = ("TiltedBox", "Box", "BoxLid")
            scene.write_text(
                f"bodies: [{', '.join('BODY ' + name for name in names)}]\n" + "".join(map(body.format, names))
            )
            sim = ambf.Simulation(scene)
            self.assertTrue(sim.body("Box").name.endswith("/Box"))
            self.assertTrue(sim.body("Tilted").name.endswith("/TiltedBox"))
            self.assertRaisesRegex(ambf.NotFoundError, "none of the bodies; near it: TiltedBox", sim.body, "TitledBox")
        sim = arm()
        with self.assertRaisesRegex(ambf.NotFoundError, "several bodies: .*shoulder.*, "):
            sim.body("arm7")
        for name in ("nobody", 99, -1):
            self.assertRaises(ambf.NotFoundError, sim.body, name)
        self.assertRaises(LookupError, sim.sensor, "eye")
        self.assertRaises(LookupError, sim.actuator, 0)


class Accounts(unittest.TestCase):
    """What the solver did, and where the energy went."""

    def test_energy(self):
        """The ledger begins when it is switched on, closes, and changes no motion."""
        seen = []
        for enabled in (False, True):
            with arm() as sim:
                sim.set_energy_ledger(enabled)
                seen.append(drive(sim, 3))
                ledger = sim.energy()
                works = [work for name, work in ledger.items() if name not in ("kinetic", "potential", "elastic")]
                self.assertEqual(len(works), 12)
                if not enabled:
                    self.assertEqual(set(ledger.values()), {0.0})
                else:
                    self.assertNotEqual(ledger["motors"], 0)
                    self.assertNotEqual(ledger["wrenches"], 0)
        self.assertEqual(seen[0], seen[1])

    def test_solver_statistics(self):
        """They are taken: the next ones begin anew."""
        with ambf.Simulation(GRIPPER, launch_file=LAUNCH, profile="accurate") as sim:
            sim.step(100)
            self.assertGreater(sim.take_solver_statistics()["rows"], 0)
            self.assertEqual(sim.take_solver_statistics()["rows"], 0)


class Arrays(unittest.TestCase):
    """States and commands are arrays, for good."""

    def test_states_are_refreshed_in_place_and_can_not_be_written(self):
        """The same objects, other numbers."""
        sim = arm()
        flange, positions, before = sim.body("arm7/flange"), sim.joint_positions, sim.joint_positions.copy()
        pose = flange.pose.copy()
        base = sim.body("arm7/base")
        base.joint_kinds[:], base.joint_commands[:] = ambf.POSITION, 0.5
        sim.step(300)
        self.assertTrue((positions[:7] != before[:7]).all())
        self.assertFalse((flange.pose == pose).all())
        np.testing.assert_array_equal(base.joint_positions, positions[base.joint_indices])
        for array in (
            sim.poses,
            sim.twists,
            positions,
            sim.joint_efforts,
            sim.joint_wrenches,
            sim.holding,
            flange.pose,
        ):
            with self.assertRaises(ValueError):
                array[...] = 0

    def test_assignment_writes_into_the_arrays(self):
        """The arrays stay those that the simulator uses; what it can't use is refused at once, and changes nothing."""
        with arm() as sim:
            flange, base = sim.body("flange"), sim.body("arm7/base")
            wrench, twists, commands = flange.wrench, sim.target_twists, base.joint_commands
            flange.kind, flange.wrench = ambf.FORCE, (0, 0, 5, 0, 0, 0)
            flange.wrench += 1
            sim.target_twists = 0.25
            base.joint_kinds, base.joint_commands = ambf.POSITION, np.linspace(0, 0.6, 7)
            base.joint_commands[0] = 0.1
            self.assertIs(flange.wrench, wrench)
            self.assertEqual(list(sim.wrenches[flange.index]), [1, 1, 6, 1, 1, 1])
            self.assertTrue((twists == 0.25).all())
            self.assertEqual((commands[0], commands[6]), (0.1, 0.6))
            flange.wrench = 0
            sim.step(500)
            self.assertAlmostEqual(sim.joint_positions[base.joint_indices[6]], 0.6, delta=0.1)
            for name, value, message in (
                ("wrench", (1, 2), r"wrench: expected \(6,\) numbers, not \(2,\)"),
                ("wrench", (0, 0, 0, 0, 0, float("nan")), "not finite"),
                ("target_pose", np.zeros(7), "quaternion .* is zero"),
                ("kind", 9, "9 is no kind of command; expected NONE"),
                ("kind", -2, "-2 is no kind"),
                ("joint_kinds", [9], "9 is no kind"),
            ):
                with self.subTest(name, value=value), self.assertRaisesRegex(ValueError, message):
                    setattr(flange if name != "joint_kinds" else base, name, value)
            self.assertEqual(list(flange.wrench), [0] * 6)
            self.assertEqual(flange.kind, ambf.FORCE)
            for handle, name in ((sim, "poses"), (sim, "joint_positions"), (flange, "pose"), (base, "joint_positions")):
                with self.subTest(name), self.assertRaises(AttributeError):
                    setattr(handle, name, 0)
            flange.kind, flange.target_pose[3:] = ambf.POSITION, 0.0
            with self.assertRaisesRegex(ambf.InvalidCommand, "quaternion commanded to .*flange is zero"):
                sim.step()

    def test_steps_are_counted_from_zero(self):
        """Other numbers are refused in words."""
        with arm() as sim:
            for steps in (-1, 2**32):
                self.assertRaisesRegex(ValueError, r"expected 0 to 4294967295 iterations", sim.step, steps)
                self.assertRaisesRegex(ValueError, r"expected 0 to", ambf.step_all, [sim], [steps])
            self.assertRaises(TypeError, sim.step, 1.5)
            sim.step(np.int64(2))
            ambf.step_all([sim], np.array([2]))
            self.assertEqual(sim.sim_step, 4)

    def test_commands(self):
        """They stay in force until they are changed."""
        sim = ambf.Simulation(RESOURCES / "models/pendulum.yaml", world=RESOURCES / "world/world.yaml")
        root = next(sim.body(i) for i in range(len(sim.bodies)) if sim.body(i).joints)
        root.joint_kinds[0], root.joint_commands[0] = ambf.EFFORT, 0.4
        sim.step(50)
        pushed = sim.joint_positions[root.joint_indices[0]]
        other = ambf.Simulation(RESOURCES / "models/pendulum.yaml", world=RESOURCES / "world/world.yaml")
        other.step(50)
        self.assertNotEqual(pushed, other.joint_positions[root.joint_indices[0]])
        free = ambf.Simulation(launch_file=LAUNCH, indexes=[0], profile="accurate")
        ball = free.body("env/Sphere")
        ball.kind, ball.target_twist[:3] = ambf.VELOCITY, (0.0, 0.0, 0.2)
        free.step(10)
        self.assertAlmostEqual(ball.twist[2], 0.2, places=1)
        ball.kind = ambf.NONE
        free.step(100)
        self.assertLess(ball.twist[2], -0.5)
        ball.kind, ball.wrench[2] = ambf.FORCE, 1000.0
        height = ball.pose[2]
        free.step(200)
        self.assertGreater(ball.pose[2], height)
        ball.kind, ball.target_pose[:3] = ambf.POSITION, (0.0, 0.0, 1.0)
        free.step(1)
        self.assertEqual(free.kinds[ball.index], ambf.POSITION)

    def test_what_is_no_command(self):
        """Nothing moves, and it is said which."""
        sim = arm()
        base, flange = sim.body("arm7/base"), sim.body("arm7/flange")
        before = look(sim)
        base.joint_kinds[1] = ambf.POSITION
        for value in (np.nan, np.inf):
            base.joint_commands[1] = value
            self.assertRaisesRegex(ambf.InvalidCommand, "shoulder", sim.step, 3)
        base.joint_commands[1] = 0
        base.joint_kinds[2] = 7
        self.assertRaisesRegex(ambf.InvalidCommand, "roll.*kind 7", sim.step)
        base.joint_kinds[2] = ambf.NONE
        sim.kinds[flange.index] = -2
        self.assertRaisesRegex(ValueError, "flange: kind -2", sim.step)
        flange.kind, flange.wrench[4] = ambf.FORCE, np.nan
        self.assertRaisesRegex(ambf.InvalidCommand, "flange", sim.step)
        self.assertRaises(ambf.InvalidCommand, ambf.step_all, [arm(), sim])
        self.assertEqual(look(sim), before)
        flange.kind = ambf.NONE
        sim.step(3)
        for wrong in (lambda: base.joint_commands.__setitem__(slice(None), np.zeros(3)), lambda: sim.step(-1)):
            self.assertRaises((ValueError, OverflowError), wrong)
        with self.assertRaises(TypeError):
            sim.step(1.5)
        with self.assertRaises(ValueError):
            flange.wrench[:] = "force"

    def test_arrays_that_were_tampered_with(self):
        """Shape and type of what Python holds mean nothing to the simulation; what lies behind it is checked."""
        sim = arm()
        before = sim.kinds.copy()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            sim.kinds.shape = (1, len(before))
            sim.kinds.dtype = np.uint8
        sim.step()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            sim.wrenches.base.dtype = np.int64
        sim.kinds[0, 0] = ambf.FORCE
        self.assertRaises(TypeError, sim.step)

    def test_sensors_and_actuators(self):
        """A ray sees the floor; the holder takes the block."""
        sim = ambf.Simulation(GRIPPER, launch_file=LAUNCH, profile="accurate")
        eye, holder = sim.sensor("proximity"), sim.actuator("holder")
        self.assertRaises(ValueError, holder.hold)
        self.assertRaises(ValueError, holder.hold, sensor="a", body="b")
        sim.step(5)
        measured, seen = eye.readings()
        np.testing.assert_array_equal(measured, eye.measurements)
        self.assertEqual(len(seen), len(measured))
        holder.hold(body="BODY block")
        sim.step(5)
        self.assertTrue(holder.holding and sim.holding[0])
        holder.release()
        sim.step(5)
        self.assertFalse(holder.holding)
        holder.hold(body="BODY nobody")
        sim.step(2)
        self.assertTrue(any("nobody" in notice for notice in sim.notices()))
        self.assertEqual(sim.notices(), [])


class Life(unittest.TestCase):
    """Reset, save, close."""

    def test_the_same_commands_give_the_same_bits(self):
        """Also after a reset, but for time."""
        for profile in ("legacy", "accurate"):
            first, second = arm(profile=profile), arm(profile=profile)
            found = drive(first, 3)
            self.assertEqual(found, drive(second, 3))
            self.assertNotEqual(found, drive(second, 4))
        sim = arm()
        poses = []
        for _ in range(2):
            sim.kinds[:] = ambf.NONE
            sim.body("arm7/base").joint_kinds[:] = ambf.NONE
            sim.reset()
            sim.step(1)
            drive(sim, 5)
            poses.append(sim.poses.tobytes())
        self.assertEqual(*poses)

    def test_a_reset_is_the_start(self):
        """To the bit, whatever was before; only time goes on. Commands that were written are gone, what was held is let go."""
        for profile in ("legacy", "accurate"):
            sim = arm(profile=profile)
            flange = sim.body("arm7/flange")
            before, first = look(sim, clock=False), drive(sim, 3, clock=False)
            for speed in (None, 1e9, 1e300):
                if speed:
                    flange.kind, flange.target_twist[:] = ambf.VELOCITY, speed
                    self.assertRaises(ambf.NonFiniteError, sim.step, 20)
                step, now = sim.sim_step, sim.sim_time
                sim.reset()
                self.assertEqual(sim.sim_step, step + 1)
                self.assertAlmostEqual(sim.sim_time, now + 0.001, delta=1e-12)
                self.assertEqual(look(sim, clock=False), before, f"{profile} {speed}")
                self.assertTrue(
                    (sim.kinds == ambf.NONE).all() and (sim.body("arm7/base").joint_kinds == ambf.NONE).all()
                )
                self.assertFalse(sim.wrenches.any() or sim.target_twists.any())
                self.assertEqual(drive(sim, 3, clock=False), first, f"{profile} {speed}")
            gripper = ambf.Simulation(GRIPPER, launch_file=LAUNCH, profile=profile)
            holder = gripper.actuator("holder")
            holder.hold(body="block")
            gripper.step(5)
            self.assertTrue(holder.holding)
            gripper.reset()
            self.assertFalse(holder.holding)
            gripper.step(5)
            self.assertFalse(holder.holding)

    def test_saved_states(self):
        """What is restored goes on as it did, with its commands; as often as wanted."""
        for profile in ("legacy", "accurate"):
            sim = arm(profile=profile, saving=True)
            self.assertEqual(drive(sim, 1), drive(arm(profile=profile), 1), "saving changes nothing")
            state, seen = sim.save(), look(sim)
            commands = [array.copy() for array in (sim.wrenches, sim.body("arm7/base").joint_commands)]
            self.assertEqual((state.sim_step, state.sim_time), (sim.sim_step, sim.sim_time))
            self.assertGreater(state.size, 1000)
            sim.step(20)
            alone = look(sim)
            for seed in (2, 3):
                sim.restore(state)
                self.assertEqual(look(sim), seen)
                np.testing.assert_array_equal(sim.wrenches, commands[0])
                np.testing.assert_array_equal(sim.body("arm7/base").joint_commands, commands[1])
                sim.step(20)
                self.assertEqual(look(sim), alone)
                drive(sim, seed)
            sim.restore(state)
            drive(sim, 9)
            found = look(sim)
            sim.restore(state)
            drive(sim, 9)
            self.assertEqual(look(sim), found)
            self.assertRaises(ambf.StateError, arm(profile=profile, saving=True).restore, state)
            sim.close()
            self.assertRaises(ambf.ClosedError, sim.restore, state)
        with self.assertRaisesRegex(ambf.StateError, "saving=True"):
            arm().save()
        with self.assertRaises(TypeError):
            arm().restore(None)

    def test_what_is_lost_comes_back(self):
        """A force beyond all numbers is an error until the reset."""
        sim = arm(profile="legacy")
        flange = sim.body("arm7/flange")
        flange.kind, flange.wrench[0] = ambf.FORCE, 1e308
        seen = look(sim)
        with self.assertRaises(ambf.NonFiniteError) as caught:
            sim.step(50)
        error = caught.exception
        again = pickle.loads(pickle.dumps(error))
        self.assertEqual((str(again), vars(again)), (str(error), vars(error)))
        self.assertIn("arm7", error.body)
        self.assertGreater(error.step, 1)
        self.assertIn(error.body, str(error))
        self.assertEqual(look(sim), seen)
        flange.kind = ambf.NONE
        self.assertRaises(ArithmeticError, sim.step)
        good = arm()
        with self.assertRaises(ambf.NonFiniteError) as caught:
            ambf.step_all([good, sim], 5)
        self.assertEqual((caught.exception.index, good.sim_step), (1, 5))
        sim.reset()
        sim.step(50)
        self.assertTrue(np.isfinite(sim.poses).all())

    def test_views_outlive_the_simulation(self):
        """They keep the numbers that they have."""
        with arm() as sim:
            sim.step(10)
            pose = sim.body("arm7/flange").pose
            expected = pose.copy()
            state = sim.poses
        for use in (sim.step, sim.reset, sim.save, sim.notices, lambda: ambf.step_all([sim])):
            self.assertRaises(ambf.ClosedError, use)
        sim.close()
        np.testing.assert_array_equal(pose, expected)
        sim = None
        gc.collect()
        [arm().step(5) for _ in range(3)]
        np.testing.assert_array_equal(pose, expected)
        self.assertTrue(np.isfinite(state).all())


class Threads(unittest.TestCase):
    """One simulation a thread, many threads."""

    def test_many_at_once_are_as_many_alone(self):
        """Bit for bit, with and without saving."""
        for options in ({}, {"saving": True}, {"profile": "legacy"}):
            together, alone = [arm(**options) for _ in range(4)], [arm(**options) for _ in range(4)]
            for sims in (together, alone):
                for i, sim in enumerate(sims):
                    base = sim.body("arm7/base")
                    base.joint_kinds[:], base.joint_commands[:] = ambf.POSITION, 0.1 * (i + 1)
            counts = [5, 30, 0, 60]
            for _ in range(10):
                ambf.step_all(together, counts)
                for sim, count in zip(alone, counts):
                    sim.step(count)
                self.assertEqual([look(sim) for sim in together], [look(sim) for sim in alone])
        ambf.step_all([], 5)
        with self.assertRaisesRegex(ValueError, "simulations 0 and 2 are the same one: each can be given once"):
            ambf.step_all([together[0], together[1], together[0]])
        together[0].step()
        self.assertRaises(ValueError, ambf.step_all, together, [1, 2])

    def test_threads_of_python(self):
        """The lock is released; who reads meanwhile sees the states of one step."""
        sims = [arm() for _ in range(4)]
        found = [None] * 4
        torn, stop = [], threading.Event()

        def run(i):
            found[i] = drive(sims[i], 7, calls=60)

        def read():
            while not stop.is_set():
                before = sims[0].sim_step
                first, second = sims[0].poses.tobytes(), sims[0].poses.tobytes()
                if first != second and sims[0].sim_step == before:
                    torn.append(before)

        threads = [threading.Thread(target=run, args=(i,)) for i in range(4)]
        reader = threading.Thread(target=read)
        for thread in (*threads, reader):
            thread.start()
        for thread in threads:
            thread.join()
        stop.set()
        reader.join()
        self.assertEqual(found, [drive(arm(), 7, calls=60)] * 4)
        self.assertEqual(torn, [])

    def test_one_simulation_in_two_threads(self):
        """Is refused, not broken."""
        sim = arm()
        thread = threading.Thread(target=sim.step, args=(20_000,))
        thread.start()
        time.sleep(0.05)
        refused = 0
        while thread.is_alive():
            for use in (sim.step, sim.reset, sim.save, sim.notices, sim.close, lambda: ambf.step_all([sim])):
                with contextlib.suppress(ambf.BusyError, ambf.ClosedError, ambf.StateError):
                    use()
                    continue
                refused += 1
        thread.join()
        self.assertGreater(refused, 5)

    def test_many_threads_that_make_mistakes(self):
        """They get in nobody's way."""
        sim = arm()
        sim.body("arm7/base").joint_kinds[0] = 9
        found = []

        def run():
            for _ in range(200):
                for use in (sim.step, sim.notices, lambda: sim.body("flange").joint_kinds):
                    try:
                        use()
                    except (ambf.InvalidCommand, ambf.BusyError) as error:
                        found.append(type(error))

        threads = [threading.Thread(target=run) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        self.assertIn(ambf.InvalidCommand, found)
        self.assertEqual(sim.sim_step, 1)

    def test_a_long_step_is_interrupted(self):
        """By Ctrl+C, after a whole number of iterations; the simulation goes on."""
        text = (
            "import ambf, sys, threading, os, signal\n"
            # Shells let programs that they start in the background ignore it.
            "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
            "sims = [ambf.Simulation(sys.argv[1], launch_file=sys.argv[2]) for _ in range(2)]\n"
            "for step in (lambda n: sims[0].step(n), lambda n: ambf.step_all(sims, n)):\n"
            "    threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()\n"
            "    try:\n"
            "        step(2_000_000_000)\n"
            "    except KeyboardInterrupt:\n"
            "        before = sims[0].sim_step\n"
            "        sims[0].step(3)\n"
            "        print(before > 10, sims[0].sim_step - before)\n"
        )
        done = subprocess.run(
            [sys.executable, "-c", text, ARM, LAUNCH], capture_output=True, text=True, timeout=60, check=False
        )
        self.assertEqual(done.stdout.split(), ["True", "3"] * 2, done.stderr)

    @unittest.skipUnless(hasattr(os, "fork"), "no fork here")
    def test_after_a_fork(self):
        """The child has threads of its own."""
        sims = [arm(), arm()]
        ambf.step_all(sims, 5)
        child = os.fork()
        if child == 0:
            signal.alarm(30)
            ambf.step_all(sims, 5)
            os._exit(0 if sims[1].sim_step == 10 else 1)
        self.assertEqual(os.waitpid(child, 0)[1], 0)
        ambf.step_all(sims, 5)


class States(unittest.TestCase):
    """States that are set, and what is asked about the scene."""

    def test_a_state_is_set_and_shown(self):
        """By array or by name; the next iteration shows it again, and the one after it the motion."""
        with arm() as sim:
            base, flange = sim.body("arm7/base"), sim.body("arm7/flange")
            wanted = np.full(len(sim.joints), np.nan)
            wanted[base.joint_indices] = np.linspace(0.1, 0.7, 7)
            sim.set_state(joint_positions=wanted, joint_velocities={"yaw": 0.5})
            np.testing.assert_allclose(base.joint_positions, np.linspace(0.1, 0.7, 7), atol=1e-9)
            np.testing.assert_allclose(base.joint_velocities, [0.5, 0, 0, 0, 0, 0, 0], atol=0.02)
            seen = flange.pose.copy()
            sim.step(1)
            np.testing.assert_array_equal(flange.pose, seen)
            sim.step(1)
            self.assertAlmostEqual(base.joint_positions[0], 0.1005, delta=1e-4)
            sim.step(100)
            sim.set_state(joint_positions=wanted, joint_velocities=np.zeros(len(sim.joints)))
            np.testing.assert_allclose(flange.pose, seen, atol=1e-9)
            np.testing.assert_allclose(flange.twist, 0, atol=1e-9)

    def test_states_of_several_in_one_array(self):
        """In the order that is told, as copies; those of other scenes are refused."""
        with (
            ambf.Simulation(GRIPPER, launch_file=LAUNCH) as first,
            ambf.Simulation(GRIPPER, launch_file=LAUNCH) as second,
        ):
            second.actuator("holder").hold(sensor="proximity")
            first.step(3)
            second.step(5)
            found = ambf.stack_states([first, second])
            self.assertEqual(found.sim_steps.tolist(), [first.sim_step, second.sim_step])
            self.assertEqual(found.sim_times.tolist(), [first.sim_time, second.sim_time])
            for numbers, sim in zip(found.numbers, (first, second)):
                joints = (sim.joint_positions, sim.joint_velocities, sim.joint_efforts)
                expected = (sim.poses.ravel(), sim.twists.ravel(), *joints, sim.measurements, sim.holding, [0.0])
                np.testing.assert_array_equal(numbers, np.concatenate(expected))
            self.assertEqual(found.numbers[:, -2].tolist(), [0.0, 1.0])
            before = found.numbers.copy()
            first.step(5)
            np.testing.assert_array_equal(found.numbers, before)
            with arm() as other, self.assertRaisesRegex(ValueError, "simulation 1 has other numbers"):
                ambf.stack_states([first, other])
            self.assertEqual(ambf.stack_states([]).numbers.shape, (0, 0))

    def test_joints_say_what_they_carry(self):
        """The base of an arm at rest carries all of it, whatever the file says of feedback."""
        with arm() as sim:
            base = sim.body("arm7/base")
            base.joint_kinds, base.joint_commands = ambf.POSITION, 0  # seven zeros are no quaternion
            sim.step(4000)
            first = int(base.joint_indices[0])
            moving = sum(sim.masses[index] for index, name in enumerate(sim.bodies) if "arm7/" in name)
            self.assertEqual(sim.joint_wrenches.shape, (len(sim.joints), 6))
            np.testing.assert_allclose(sim.joint_wrenches[first][:3], (0, 0, moving * 9.81), atol=0.02)
            np.testing.assert_array_equal(base.joint_wrenches, sim.joint_wrenches[base.joint_indices])
            with arm(joint_wrenches=False) as other:
                base = other.body("arm7/base")
                base.joint_kinds, base.joint_commands = ambf.POSITION, 0
                other.step(4000)
                self.assertFalse(other.joint_wrenches.any())
                np.testing.assert_array_equal(other.poses, sim.poses)

    def test_a_moved_palm_carries_what_its_fingers_hold(self):
        """By velocity, then by poses that come every ten steps; the twist is there."""
        with ambf.Simulation(GRIPPER, launch_file=LAUNCH, profile="accurate") as sim:
            palm, finger, block = sim.body("palm"), sim.body("leftfinger"), sim.body("block")
            sim.step(500)
            start = block.pose.copy()
            palm.kind, palm.target_twist = ambf.VELOCITY, (0, 0.1, 0, 0, 0, 0)
            sim.step(400)
            self.assertAlmostEqual(palm.pose[1], 0.04, places=3)
            self.assertGreater(block.pose[1] - start[1], 0.035)
            np.testing.assert_allclose((palm.twist[1], finger.twist[1]), 0.1, atol=2e-3)
            palm.kind, palm.target_pose = ambf.POSITION, palm.pose
            low = block.pose[2]
            for _ in range(100):
                palm.target_pose[2] += 1e-3
                sim.step(10)
            self.assertGreater(block.pose[2] - low, 0.095)
            # A jump leaves the block where it was.
            palm.target_pose[0] += 1
            sim.step(1)
            self.assertLess(np.abs(block.twist).max(), 0.5)

    def test_a_block_is_placed(self):
        """Free bodies take poses and twists."""
        with ambf.Simulation(GRIPPER, profile="accurate") as sim:
            block = sim.body("block")
            sim.set_state(poses={"block": (0.1, 0.2, 0.5, 0, 0, 0, 2)}, twists={block.index: (0, 0, 1, 0, 0, 3)})
            np.testing.assert_allclose(block.pose, (0.1, 0.2, 0.5, 0, 0, 0, 1), atol=1e-12)
            np.testing.assert_allclose(block.twist, (0, 0, 1, 0, 0, 3), atol=1e-12)
            sim.step(101)
            self.assertAlmostEqual(block.pose[2], 0.5 + 0.1 - 9.81 * 0.01 / 2, delta=2e-3)

    def test_what_can_not_be_set(self):
        """Is said, and changes nothing."""
        with arm() as sim:
            before = look(sim)
            for error, message, options in (
                (ambf.StateError, "joint shoulder: 9 is not within its limits", {"joint_positions": {"shoulder": 9}}),
                (ambf.StateError, "pose of flange cannot be set: it hangs", {"poses": {"flange": [0] * 6 + [1]}}),
                (ambf.NotFoundError, "none of the joints; near it: shoulder", {"joint_positions": {"shuolder": 0}}),
                (ValueError, r"expected \(\d+,\) numbers, not \(1,\)", {"joint_positions": [1]}),
                (ValueError, r"poses of flange: expected \(7,\) numbers", {"poses": {"flange": [1]}}),
                (ValueError, "quaternion", {"poses": {"flange": [0] * 7}}),
            ):
                with self.subTest(message), self.assertRaisesRegex(error, message):
                    sim.set_state(**options)
            self.assertEqual(look(sim), before)

    def test_contacts(self):
        """A box of 2 kg at rest presses on the floor with its weight."""
        with tempfile.TemporaryDirectory() as folder:
            scene = pathlib.Path(folder) / "box.yaml"
            scene.write_text(
                "bodies: [BODY Floor, BODY Box]\n"
                "BODY Floor: {name: Floor, mass: 0, mesh: '', passive: true, collision shape: PLANE, collision geometry: "
                "{normal: {x: 0, y: 0, z: 1}, offset: 0}}\n"
                "BODY Box: {name: Box, mass: 2, mesh: '', collision shape: BOX, collision geometry: {x: 0.2, y: 0.2, z: 0.2},"
                " location: {position: {x: 0, y: 0, z: 0.1}}}\n"
            )
            with ambf.Simulation(scene, profile="accurate") as sim:
                sim.step(300)
                found = sim.contacts()
                self.assertAlmostEqual(found.forces.sum(), 2 * 9.8, delta=0.01)
                box = sim.body("Box").index
                for bodies, names in zip(found.bodies, found.names):
                    self.assertEqual(sorted(bodies), [-1, box])
                    self.assertEqual({name.split("/")[-1] for name in names}, {"Floor", "Box"})
                sign = np.where(found.bodies[:, :1] == box, 1.0, -1.0)
                np.testing.assert_allclose(found.normals * sign, [[0, 0, 1]] * len(sign), atol=1e-9)
                np.testing.assert_allclose(found.points[:, 2], 0, atol=1e-3)

    def test_rays(self):
        """They meet the block from above, in any shape of arguments."""
        with ambf.Simulation(GRIPPER, profile="accurate") as sim:
            block = sim.body("block")
            above, aside = block.pose[:3].copy(), np.array((1.0, 0, 0))
            down = sim.cast_rays(above - (0, 0, 5), (0, 0, 2), length=10)
            self.assertEqual(down.bodies.shape, (1,))
            several = sim.cast_rays(np.array([above + aside, above + 900 * aside]), (-1, 0, 0), 2)
            self.assertEqual(several.bodies[1], -2)
            self.assertEqual(several.distances[1], np.inf)
            self.assertTrue(0 < several.distances[0] < 1 and several.bodies[0] >= -1)
            np.testing.assert_allclose(several.normals[0], (1, 0, 0), atol=1e-6)
            for wrong in (((0, 0), (1, 0, 0)), ((0, 0, 0), (0, 0, 0)), ((0, 0, np.nan), (1, 0, 0))):
                self.assertRaises(ValueError, sim.cast_rays, *wrong)

    def test_couplings(self):
        """A follower stays with its leader under load, and says whom it follows."""
        link = (
            '<link name="{0}"><inertial><mass value="0.1"/>'
            '<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>'
        )
        slide = (
            '<joint name="{0}" type="prismatic"><parent link="world"/><child link="{1}"/><axis xyz="1 0 0"/>'
            '<limit lower="-1" upper="1" effort="50" velocity="9"/>{2}</joint>'
        )
        text = '<robot name="r"><link name="world"/>' + link.format("left") + link.format("right")
        text += slide.format("lead", "left", "")
        text += slide.format("follow", "right", '<mimic joint="lead" multiplier="-1" offset="0.02"/>') + "</robot>"
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "r.urdf"
            path.write_text(text)
            for profile in ("legacy", "accurate"):
                with ambf.Simulation(path, profile=profile) as sim:
                    lead, follow = (sim.joints.index(name) for name in sim.joints)
                    self.assertEqual(sim.couplings, (ambf.Coupling(follow, ((lead, -1.0),), 0.02),))
                    world = sim.body("r/world")
                    world.joint_kinds[0], world.joint_commands[0] = ambf.EFFORT, 5
                    sim.step(100)
                    q = world.joint_positions
                    self.assertAlmostEqual(q[0] + q[1], 0.02, 6)
                    self.assertAlmostEqual(q[0], 0.125, 2)
                    sim.set_state(joint_positions={sim.joints[lead]: 0.3})
                    np.testing.assert_allclose(world.joint_positions, (0.3, -0.28), atol=1e-9)

    def test_keyframes(self):
        """States that a file names can be set; those of two models with the same name are one."""
        text = """<mujoco model="{0}"><worldbody>
          <body name="box" pos="0 0 {1}"><freejoint/><geom type="box" size="0.1 0.1 0.1"/></body>
          <body name="arm" pos="2 0 {1}"><joint name="{0}_hinge" axis="0 1 0"/><geom type="box" size="0.1 0.1 0.1" pos="0.5 0 0"/></body>
          </worldbody><keyframe><key name="home" qpos="1 0 {1} 1 0 0 0 0.25" qvel="0 0 1 0 0 2 3"/>{2}</keyframe></mujoco>"""
        with tempfile.TemporaryDirectory() as folder:
            files = [pathlib.Path(folder) / name for name in ("a.xml", "b.xml")]
            files[0].write_text(text.format("a", 1, '<key name="low" qpos="0 0 0.5 1 0 0 0 -0.5"/>'))
            files[1].write_text(text.format("b", 3, ""))
            with ambf.Simulation(files) as sim:
                self.assertEqual(sorted(sim.keyframes), ["home", "low"])
                np.testing.assert_allclose(sim.joint_positions, 0, atol=1e-4, err_msg="the start is that of the bodies")
                sim.set_state(**sim.keyframes["home"])
                np.testing.assert_allclose(sim.joint_positions, 0.25)
                np.testing.assert_allclose(sim.joint_velocities, 3)
                boxes = [sim.body(f"{model}/box") for model in "ab"]
                np.testing.assert_allclose([box.pose[:3] for box in boxes], [[1, 0, 1], [1, 0, 3]])
                np.testing.assert_allclose([box.twist for box in boxes], [[0, 0, 1, 0, 0, 2]] * 2)
                sim.set_state(**sim.keyframes["low"])
                np.testing.assert_allclose(sim.joint_positions, [-0.5, 0.25])
                np.testing.assert_allclose(boxes[1].pose[:3], [1, 0, 3])

    def test_pairs_and_height_fields(self):
        """What a pair names collides although masks and parents say otherwise; a field has hollows, and the height of its elevations."""
        text = """<mujoco><asset><hfield name="h" nrow="3" ncol="3" elevation="1 1 1 1 0 1 1 1 1" size="1 1 0.5 0.1"/></asset><worldbody>
          <geom name="h" type="hfield" hfield="h" contype="0" conaffinity="0"/>
          <body name="ball" pos="0.01 0 1"><freejoint/><geom name="ball" size="0.1" contype="0" conaffinity="0"/></body>
          <body name="other" pos="0.01 0 2"><freejoint/><geom name="other" size="0.1"/></body>
          <body name="table" pos="5 0 2"><joint axis="0 0 1"/><geom name="table" type="box" size="0.2 0.2 0.2"/>
            <body name="lid" pos="0 0 0.5"><joint type="slide" axis="0 0 1"/><geom name="lid" size="0.1"/></body></body>
          </worldbody><contact>{}</contact></mujoco>"""
        pairs = '<pair geom1="h" geom2="ball"/><pair geom1="lid" geom2="table"/>'
        with tempfile.TemporaryDirectory() as folder:
            for has_pairs in (False, True):
                path = pathlib.Path(folder) / f"{has_pairs}.xml"
                path.write_text(text.format(pairs if has_pairs else ""))
                with ambf.Simulation(path) as sim:
                    sim.step(2000)
                    ball, other, lid = (sim.body(name).pose[2] for name in ("ball", "other", "lid"))
                    self.assertLess(other, -1, "it has no pair")
                    if not has_pairs:
                        self.assertTrue(ball < -1 and lid < 1.9, f"{ball} {lid}")
                    else:
                        # The hollow is a pyramid, in which the ball touches four sides.
                        self.assertTrue(0.1 <= ball < 0.15, ball)
                        self.assertAlmostEqual(lid, 2.3, 2)

    def test_constants(self):
        """Masses, inertias, limits and types are those of the file."""
        with arm() as sim:
            base = sim.body("arm7/base")
            self.assertEqual(sim.masses[base.index], 0)
            self.assertTrue((sim.inertias[sim.masses > 0] > 0).all())
            i = base.joint_indices[0]
            self.assertEqual((sim.joint_types[i], tuple(sim.joint_limits[i])), ("revolute", (-2.9, 2.9)))
            self.assertRaises(ValueError, sim.masses.__setitem__, 0, 1.0)


if __name__ == "__main__":
    unittest.main()
