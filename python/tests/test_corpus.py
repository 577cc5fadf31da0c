"""Scenes and programs as users of the C++ simulator write them, of tests/corpus.

The scene is an operating room with two instrument arms, a phantom, a needle and a thread."""

import csv
import math
import os
import subprocess
import sys
import unittest

import harness

CORPUS = harness.REPOSITORY / "tests/corpus"
LAUNCH = CORPUS / "launch.yaml"
ALL = ("-l", "0,1,2,3,4,5,6,7")
# As such projects start it: fixed steps of 5 ms.
STEPPED = ("-p", "200", "-t", "1")
OFTEN = ("--override_min_comm_freq", "100", "--override_max_comm_freq", "100")
# A program ends long before, and says itself what it waits for; on a busy machine it may take this long, s.
PATIENCE_S = 300.0


class Scenes(unittest.TestCase):
    """Without ROS."""

    def check(self, *arguments):
        """What `--check` finds, after nothing was dropped or refused."""
        command = [harness.simulator_path(), "--check", *map(str, arguments)]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
        self.assertEqual(done.returncode, 0, done.stdout)
        self.assertIn("errors: 0,", done.stdout)
        return [line for line in done.stdout.splitlines() if ": warning: " in line]

    def test_check(self):
        """The files hold what nobody uses, and say so; nothing else is found."""
        true = ("collides with nothing", "`joint erp` is not used", "`joint cfm` is not used", "detached` is not used")
        for line in self.check(LAUNCH):
            self.assertTrue(any(text in line for text in true), line)

    def test_check_together(self):
        """All models in one world: nothing is dropped."""
        self.check("--launch_file", LAUNCH, *ALL)

    def test_five_seconds(self):
        """Nobody commands anything: everything comes to rest where it lies."""
        for profile in ("legacy", "accurate"):
            with self.subTest(profile):
                trace = harness.folder / f"corpus-{profile}"
                run = ("--steps", "5000", "--every", "250", "--profile", profile, "--trace", trace)
                program = harness.simulator_path().with_name("ambf_batch")
                command = [program, "--launch_file", LAUNCH, *ALL, *run]
                done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
                self.assertEqual(done.returncode, 0, done.stdout)
                with open(f"{trace}_bodies.csv", encoding="utf-8") as file:
                    rows = [row for row in csv.DictReader(file) if float(row["sim_time"]) >= 1.0]
                self.assertEqual(len({row["body"] for row in rows}), 75)
                for row in rows:
                    speed = math.hypot(*(float(row[axis]) for axis in ("vx", "vy", "vz")))
                    self.assertLess(speed, 0.05, row)
                    self.assertGreater(float(row["pz"]), -1.6, row)
                needle = [row for row in rows if row["body"] == "Needle"][-1]
                self.assertAlmostEqual(float(needle["pz"]), 0.014, delta=0.005)


class Programs(unittest.TestCase):
    """A master and a simulator with all models, and the programs one after the other."""

    OPTIONS = ()

    @classmethod
    def setUpClass(cls):
        """The simulator ends before its master, and has never panicked."""
        cls.master = harness.Master()
        cls.addClassCleanup(cls.master.stop)
        cls.simulator = harness.Simulator(cls.master.port, *STEPPED, *ALL, *cls.OPTIONS, "--launch_file", LAUNCH)
        cls.addClassCleanup(cls.simulator.check_log)
        cls.addClassCleanup(cls.simulator.stop)
        cls.simulator.wait_for_topics("/ambf/env/World/State", "/ambf/env/Thread24/State")

    def run_program(self, name, *arguments, held=None):
        """It ends with status 0, and nothing is lost. It runs again if the machine kept the commands of the object `held` back so long that
        the watchdog cleared them."""

        def attempt():
            path = CORPUS / "clients" / f"{name}.py"
            with harness.Program(
                [sys.executable, "-u", path, *arguments], harness.environment(self.master.port)
            ) as program:
                harness.wait_for(
                    lambda: not program.running() or not self.simulator.running(), f"{name} ends", PATIENCE_S
                )
                log = program.log()
                self.assertTrue(self.simulator.running(), self.simulator.log())
                self.assertEqual(program.status(), 0, log)
            self.assertIn("\ndone", log)
            if os.environ.get("AMBF_CORPUS_VERBOSE"):
                print(f"--- {name}\n{log}", flush=True)

        self.simulator.while_commanded(held, attempt) if held else attempt()
        self.assertNotIn("lost at step", self.simulator.log())

    def folder(self):
        """For bags."""
        folder = harness.folder / f"corpus-{type(self).__name__}"
        folder.mkdir(exist_ok=True)
        return folder


class Legacy(Programs):
    """Profile `legacy`, states at 100 Hz."""

    OPTIONS = OFTEN

    def test_parents(self):
        """Each ghost in a jaw finds its own arm's jaw by a short name that the other arm has too."""
        self.assertNotIn("it stays where it is", self.simulator.log())

    def test_look_up(self):
        """Names, handles, passive states."""
        self.run_program("look_up")

    def test_jump_joints(self):
        """Seven joints of both arms at once."""
        self.run_program("jump_joints")

    def test_circle(self):
        """Cartesian set points by inverse kinematics, and pose commands."""
        self.run_program("circle")

    def test_grasp(self):
        """Ghosts in the jaws, an actuator."""
        self.run_program("grasp", held="Actuator0")

    def test_touch(self):
        """A contact sensor."""
        self.run_program("touch")

    def test_evaluate(self):
        """A score from a bag."""
        self.run_program("evaluate", self.folder(), held="Needle")

    def test_record_play(self):
        """Commands from a bag."""
        self.run_program("record_play", self.folder(), held="baselink")

    def test_throttle(self):
        """Two hundred clock edges."""
        self.run_program("throttle", held="World")


class Accurate(Programs):
    """Profile `accurate`, states at 50 Hz until commands come."""

    OPTIONS = ("--profile", "accurate")

    def test_jump_joints(self):
        """Seven joints of both arms at once."""
        self.run_program("jump_joints")

    def test_circle(self):
        """Cartesian set points by inverse kinematics, and pose commands."""
        self.run_program("circle")

    def test_grasp(self):
        """Ghosts in the jaws, an actuator."""
        self.run_program("grasp", held="Actuator0")
