"""The reach task in Ray RLlib: runners sample, what is killed comes back, nothing is left over.

`scripts/train-rllib --check` runs these; they are apart from the others because Ray and PyTorch are large.
"""

import contextlib
import itertools
import json
import math
import os
import pathlib
import secrets
import signal
import sys
import unittest

import harness

TRAIN = harness.REPOSITORY / "python/examples/train_reach_rllib.py"
RAY = pathlib.Path(sys.executable).parent / "ray"
MARK = "AMBF_RLLIB_TEST"
# Starting Ray takes long on a busy machine.
PATIENCE_S = 240.0


def wait_for(condition, what):
    """As in the harness, with more patience."""
    return harness.wait_for(condition, what, PATIENCE_S)


class Ray:
    """Environment of programs that use Ray, and the processes that carry it."""

    def __init__(self):
        self.mark = secrets.token_hex(8)
        folder = harness.folder / secrets.token_hex(2)
        folder.mkdir()
        self.env = {name: value for name, value in harness.environment(1).items() if name != "ROS_MASTER_URI"}
        self.env |= {
            MARK: self.mark,
            "AMBF_SIMULATOR": str(harness.simulator_path()),
            "RAY_TMPDIR": str(folder),
            "RAY_USAGE_STATS_ENABLED": "0",
            # Otherwise Ray writes one into the user's home.
            "RAY_AUTH_MODE": "token",
            "RAY_AUTH_TOKEN": secrets.token_hex(16),
        }

    def processes(self):
        """Those that were started with this environment, however far down: command line by process id."""
        found = {}
        for entry in pathlib.Path("/proc").iterdir():
            with contextlib.suppress(OSError):
                if entry.name.isdigit() and f"{MARK}={self.mark}".encode() in (entry / "environ").read_bytes():
                    found[int(entry.name)] = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        return found

    def simulators(self):
        """Process ids of the simulators."""
        program = self.env["AMBF_SIMULATOR"]
        return {pid for pid, command in self.processes().items() if command.startswith(program)}

    def train(self, *arguments, **more):
        """The example, as a program."""
        return Training([sys.executable, "-u", TRAIN, *arguments], self.env | more)


class Training(harness.Program):
    """The example while it runs."""

    def status(self):
        """The exit status; training takes a while."""
        wait_for(lambda: not self.running(), "training ends")
        return super().status()

    def iterations(self):
        """What it has printed of each iteration."""
        return [json.loads(line) for line in self.log().splitlines() if line.startswith('{"steps":')]

    def wait_for(self, condition, what):
        """The first iteration from now on for which `condition` holds; fails if the program ends."""
        known = len(self.iterations())

        def found():
            if not self.running():
                raise AssertionError(f"it ended before {what}:\n{self.log()}")
            return next((line for line in self.iterations()[known:] if condition(line)), None)

        return wait_for(found, what)


def both(line):
    """Whether two runners have sampled."""
    return len(line["runners"]) == 2 and all(count > 0 for count in line["runners"].values())


class Rllib(unittest.TestCase):
    """Training in two runners."""

    def ray(self):
        """Fails at the end if anything is left of it, and ends that."""
        ray = Ray()

        def nothing_left():
            try:
                wait_for(lambda: not ray.processes(), "all processes have ended")
            except AssertionError as error:
                left = ray.processes()
                for pid in left:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)
                raise AssertionError(f"left over: {left}") from error

        self.addCleanup(nothing_left)
        return ray

    def check(self, iterations):
        """Both runners have sampled all along, numbers are numbers."""
        pids = {pid for line in iterations for pid in line["runners"]}
        self.assertEqual(len(pids), 2)
        for before, line in itertools.pairwise([{"steps": 0}, *iterations]):
            self.assertTrue(both(line), line)
            self.assertEqual(sum(line["runners"].values()), line["steps"] - before["steps"])
            for name in ("return", "success", "distance_m"):
                self.assertTrue(math.isfinite(line[name]), line)
            self.assertTrue(0 < line["distance_m"] < 2 and 0 <= line["success"] <= 1, line)

    def test_two_runners_train(self):
        """Some iterations with two worlds in each; both sample, in processes of their own."""
        ray = self.ray()
        record = harness.folder / "record.json"
        with ray.train("--steps", 6000, "--envs", 2, "--record", record) as program:
            self.assertEqual(program.status(), 0, program.log())
        found = json.loads(record.read_text())
        self.check(found["iterations"])
        self.assertEqual(len(found["iterations"]), 3)

    def test_a_runner_that_is_killed(self):
        """Ray starts it anew, the other one is the same. Then Ctrl+C, as in a terminal."""
        ray = self.ray()
        with ray.train("--steps", 10_000_000) as program:
            line = program.wait_for(both, "both sample")
            killed = min(line["runners"])
            os.kill(int(killed.split(":")[1]), signal.SIGKILL)
            again = program.wait_for(lambda line: both(line) and killed not in line["runners"], "both sample again")
            self.assertEqual(len(set(again["runners"]) & set(line["runners"])), 1)
            os.killpg(program.process.pid, signal.SIGINT)
            self.assertNotEqual(program.status(), 0)

    def test_a_simulator_that_is_killed(self):
        """Over ROS its runner starts another one. Then the program is killed, and all its processes end."""
        ray = self.ray()
        with ray.train("--steps", 10_000_000, "--backend", "ros") as program:
            line = program.wait_for(both, "both sample")
            killed, *others = ray.simulators()
            self.assertEqual(len(others), 1)
            os.kill(killed, signal.SIGKILL)
            wait_for(lambda: len(ray.simulators() - {killed}) == 2, "another simulator runs")
            again = program.wait_for(both, "both sample with the new simulator")
            self.assertEqual(set(again["runners"]), set(line["runners"]), "the runners are the same")
            os.kill(program.process.pid, signal.SIGKILL)
            wait_for(lambda: not ray.processes(), "all processes have ended")

    def test_a_cluster(self):
        """Two nodes of one core each, started by hand as on two machines: a runner in each."""
        ray = self.ray()
        address = f"127.0.0.1:{harness.free_port()}"
        start = [RAY, "start", "--block", "--num-cpus=1", "--node-ip-address=127.0.0.1"]
        head = [*start, "--head", f"--port={address.split(':')[1]}", "--include-dashboard=false"]
        with harness.Program(head, ray.env) as first:
            wait_for(lambda: "Ray runtime started" in first.log() or not first.running(), "the head runs")
            with harness.Program([*start, f"--address={address}"], ray.env) as second:
                wait_for(lambda: "Ray runtime started" in second.log() or not second.running(), "it joins")
                with ray.train("--steps", 4000, "--address", address) as program:
                    self.assertEqual(program.status(), 0, f"{program.log()}\n{first.log()}\n{second.log()}")
                    self.check(program.iterations())

    def test_a_simulator_that_does_not_start(self):
        """The program ends, and says why."""
        with self.ray().train("--backend", "ros", AMBF_SIMULATOR="/nonexistent") as program:
            self.assertNotEqual(program.status(), 0)
            self.assertIn("/nonexistent", program.log())
            self.assertIn("no runner could be started", program.log())


if __name__ == "__main__":
    unittest.main()
