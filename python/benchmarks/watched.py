"""What benchmarks that run for long ask of the system and compute from what they saw."""

import json
import os
import pathlib
import subprocess
import sys
import time

TICKS_S = os.sysconf("SC_CLK_TCK")


def percentile(values, part):
    """The value below which are `part` of `values`."""
    ordered = sorted(values)
    return ordered[min(int(part * len(ordered)), len(ordered) - 1)] if ordered else float("nan")


class Watched:
    """What the system says about a process."""

    def __init__(self, pid):
        self.folder = pathlib.Path(f"/proc/{pid}")
        self.before = (time.monotonic(), self.ticks())

    def ticks(self):
        """Its processor time, ticks."""
        return sum(int(field) for field in (self.folder / "stat").read_text().rsplit(")", 1)[1].split()[11:13])

    def processor(self):
        """Processor time since it was asked before, % of a core."""
        before, self.before = self.before, (time.monotonic(), self.ticks())
        return 100.0 * (self.before[1] - before[1]) / TICKS_S / (self.before[0] - before[0])

    def status(self, key):
        """A number of its status."""
        lines = (self.folder / "status").read_text().splitlines()
        return next(float(line.split()[1]) for line in lines if line.startswith(key))

    def memory(self):
        """What it holds, MB: its own and pages of files."""
        return self.status("VmRSS:") / 1024

    def own_memory(self):
        """What it holds of its own, MB: without pages of programs, libraries and other files, which the system takes in and drops."""
        return self.status("RssAnon:") / 1024

    def threads(self):
        """How many it has."""
        return int(self.status("Threads:"))

    def files(self):
        """How many it has open."""
        return len(list((self.folder / "fd").iterdir()))

    def row(self):
        """Processor, % of a core; memory, MB; threads; open files."""
        return f"{self.processor():.0f} | {self.memory():.1f} | {self.threads()} | {self.files()}"


class Client:
    """A program that is a client until its input ends, and answers each line of it with one of JSON."""

    def __init__(self, command, environment):
        self.process = subprocess.Popen(
            [sys.executable, *map(str, command)],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def ask(self):
        """What a reader got since it was asked before."""
        self.process.stdin.write("?\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    def end(self, seconds):
        """Lets it end by itself within `seconds`, or kills it; whether it ended well."""
        self.process.stdin.close()
        try:
            self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            self.kill()
        self.process.stdout.close()
        return self.process.returncode == 0

    def kill(self):
        """Ends it without a chance to say good-bye."""
        self.process.kill()
        self.process.wait()
