"""Runs commands side by side, and says what each took."""

import contextlib
import dataclasses
import os
import pathlib
import re
import signal
import subprocess
import threading
import time

# A command that takes longer hangs, s.
LONGEST_S = 1500.0
# Lines of a failed command's output that are shown; its file holds all.
SHOWN_LINES = 150
# A test's name in the output of Rust's tests and of Python's.
RUST_TEST = re.compile(r"^test (\S.*?)(?: - should panic)? \.\.\. ", re.MULTILINE)
PYTHON_TEST = re.compile(r"^test\w* \((\S+)\)", re.MULTILINE)


@dataclasses.dataclass(eq=False)
class Job:
    """A command: its name, the words of the command, its working directory, changes of its environment, how much it gives way to
    others (`nice`), whether it calls cargo, which only one can at a time, and the names of the jobs that must have passed before."""

    name: str
    command: list
    folder: pathlib.Path
    environment: dict = dataclasses.field(default_factory=dict)
    nice: int = 0
    cargo: bool = False
    needs: tuple = ()
    # What happened: status (None before it ended), seconds from start to end, seconds of processors, its output and its tests.
    status: int | None = None
    wall_s: float = 0.0
    cpu_s: float = 0.0
    output: pathlib.Path | None = None
    tests: list = dataclasses.field(default_factory=list)

    def run(self, output, started):
        """Runs it; `started` is told the process. Returns whether it passed."""
        self.output = output
        begin_s = time.monotonic()
        with output.open("wb") as file:
            process = subprocess.Popen(
                ["nice", "-n", str(self.nice), *map(str, self.command)],
                cwd=self.folder,
                env=os.environ | self.environment,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            started(process)
            late = threading.Timer(LONGEST_S, end, [process])
            late.start()
            _, status, usage = os.wait4(process.pid, 0)
            late.cancel()
        process.returncode = os.waitstatus_to_exitcode(status)
        # What it has left behind must not disturb others.
        end(process)
        self.wall_s = time.monotonic() - begin_s
        self.cpu_s = usage.ru_utime + usage.ru_stime
        text = output.read_text(errors="replace")
        self.tests = RUST_TEST.findall(text) + PYTHON_TEST.findall(text)
        self.status = process.returncode
        return self.status == 0

    def line(self):
        """What came of it, in a line."""
        state = "ok    " if self.status == 0 else "FAILED"
        tests = f"{len(self.tests)} tests" if self.tests else ""
        return f"{state} {self.wall_s:6.1f} s  {self.cpu_s:6.1f} s of processors  {self.name}  {tests}".rstrip()

    def failure(self):
        """The end of its output."""
        lines = self.output.read_text(errors="replace").splitlines()
        left_out = [f"[{len(lines) - SHOWN_LINES} lines before: {self.output}]"] if len(lines) > SHOWN_LINES else []
        why = (
            "took too long"
            if self.status == -signal.SIGKILL and self.wall_s >= LONGEST_S
            else f"ended with {self.status}"
        )
        return "\n".join([f"== {self.name} {why}:", *left_out, *lines[-SHOWN_LINES:]])


def end(process):
    """Ends a process with all that it has started in its session's group."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)


class Runner:
    """Runs jobs as soon as those that they need have passed: one that calls cargo, and `lanes` others, at a time."""

    def __init__(self, lanes, folder):
        self.lanes = lanes
        self.folder = folder
        self.done = []
        self._waiting = []
        self._running = {}
        # Names of the jobs that have failed or were left out.
        self._lacking = set()
        self._changed = threading.Condition()
        folder.mkdir(parents=True, exist_ok=True)

    def add(self, jobs):
        """More jobs; jobs may add others while they run."""
        with self._changed:
            self._waiting += jobs
            self._changed.notify_all()

    def run(self, then=lambda job: None):
        """Runs all jobs; `then` is called with each that has passed, before those that need it start. Returns whether all passed."""
        try:
            with self._changed:
                while True:
                    for job in self._ready():
                        self._start(job, then)
                    if not self._running:
                        break
                    self._changed.wait()
        except BaseException:
            for process in self._running.values():
                if process:
                    end(process)
            raise
        return not self._lacking and not self._waiting

    def _ready(self):
        """The waiting jobs that may start now; those that never can are dropped."""
        passed = {job.name for job in self.done if job.status == 0}
        while left_out := [job for job in self._waiting if self._lacking & set(job.needs)]:
            for job in left_out:
                self._waiting.remove(job)
                self._lacking.add(job.name)
                print(f"left out: {job.name}, which needs {', '.join(self._lacking & set(job.needs))}", flush=True)
        busy = sum(not job.cargo for job in self._running)
        cargo = any(job.cargo for job in self._running)
        ready = []
        for job in self._waiting:
            if not set(job.needs) <= passed or (cargo if job.cargo else busy >= self.lanes):
                continue
            ready.append(job)
            cargo, busy = cargo or job.cargo, busy + (not job.cargo)
        return ready

    def _start(self, job, then):
        self._waiting.remove(job)
        self._running[job] = None

        def work():
            output = self.folder / f"{re.sub(r'[^A-Za-z0-9_.-]', '-', job.name)}.log"
            try:
                passed = job.run(output, lambda process: self._running.update({job: process}))
                print(job.line(), flush=True)
                if passed:
                    then(job)
                else:
                    print(job.failure(), flush=True)
            except BaseException:
                job.status = job.status or -1
                raise
            finally:
                with self._changed:
                    del self._running[job]
                    self.done.append(job)
                    if job.status != 0:
                        self._lacking.add(job.name)
                    self._changed.notify_all()

        threading.Thread(target=work, daemon=True).start()
