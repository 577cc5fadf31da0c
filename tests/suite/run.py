"""Runs the whole suite: what `scripts/test` starts. `scripts/test --help` says more."""

import argparse
import collections
import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time

import changed
import plan
from jobs import Runner

# Jobs beside the one that calls cargo: tests wait for most of their time.
LANES = (os.cpu_count() or 1) + 1
# Rows of the table of jobs, and of compiled parts.
SHOWN_JOBS = 25
SHOWN_PARTS = 12
SHORTEST_PART_S = 0.1


def options():
    """What the command line asks for."""
    parser = argparse.ArgumentParser(prog="scripts/test", description="Checks everything: format, lints, documentation, Rust tests, "
        "then real ROS programs against the simulator.")  # fmt: skip
    parser.add_argument(
        "--fast", action="store_true", help="format, lints and unit tests only: what to run before each commit"
    )
    parser.add_argument("--changed", metavar="BASE", nargs="?", const="", help="only what the difference to BASE can touch; "
        "default: origin/main if there is one, else main")  # fmt: skip
    parser.add_argument("--only", metavar="PATTERN", help="only the jobs whose name the pattern is found in")
    parser.add_argument("--times", metavar="N", type=int, default=1, help="the tests N times")
    parser.add_argument("--busy", metavar="N", type=int, default=0, help="beside N programs that keep a processor busy")
    parser.add_argument("--list", action="store_true", help="says which jobs it would run after the build, and ends")
    return parser.parse_args()


def chosen(arguments):
    """Whether a job is asked for."""
    base = arguments.changed
    if base == "":
        base = "origin/main" if changed.git("branch", "--remotes", "--list", "origin/main") else "main"
    files = None if base is None else changed.files(base)

    def wanted(job):
        if arguments.only and not re.search(arguments.only, job.name):
            return False
        return files is None or any(changed.touches(file, job) for file in files)

    return wanted


@contextlib.contextmanager
def busy(count):
    """Programs that keep `count` processors busy meanwhile."""
    programs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for program in programs:
            program.kill()
            program.wait()


def compiled():
    """Seconds that compiling took, from cargo's report of the last build with `--timings`: (name, seconds) of each part."""
    report = plan.TARGET / "cargo-timings/cargo-timing.html"
    found = re.search(r"UNIT_DATA = (\[.*?\]);\n", report.read_text(), re.DOTALL) if report.exists() else None
    units = json.loads(found[1]) if found else []
    return [
        (f"{unit['name']}{unit['target']}", unit["duration"]) for unit in units if unit["duration"] >= SHORTEST_PART_S
    ]


def table(jobs, parts):
    """Where the time goes."""
    groups = collections.Counter()
    for name, seconds in parts:
        groups["compiling test programs" if "(test)" in name else "compiling other parts"] += seconds
    lines = ["", "  seconds  of processors  what"]
    lines += [f"{seconds:9.1f}                 {name}" for name, seconds in groups.items()]
    for job in sorted(jobs, key=lambda job: -job.wall_s)[:SHOWN_JOBS]:
        lines.append(f"{job.wall_s:9.1f} {job.cpu_s:14.1f}  {job.name}")
        if job.name == "build":
            lines += [
                f"{seconds:9.1f}                    {name}"
                for name, seconds in sorted(parts, key=lambda p: -p[1])[:SHOWN_PARTS]
            ]
    rest = sorted(jobs, key=lambda job: -job.wall_s)[SHOWN_JOBS:]
    lines.append(f"{sum(job.wall_s for job in rest):9.1f} {sum(job.cpu_s for job in rest):14.1f}  {len(rest)} others")
    lines.append(f"{sum(job.wall_s for job in jobs):9.1f} {sum(job.cpu_s for job in jobs):14.1f}  in all, side by side")
    return "\n".join(lines)


def repeated(jobs, times):
    """Each job so often."""
    return [job if i == 0 else plan.again(job, i + 1) for i in range(times) for job in jobs]


def main():
    """Runs what is asked for and returns the exit status."""
    arguments = options()
    # As Ctrl+C: what runs is ended.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    wanted = chosen(arguments)
    begin_s = time.monotonic()
    runner = Runner(LANES, plan.TARGET / "tests")

    def add(jobs):
        jobs = [job for job in jobs if wanted(job)]
        if arguments.list:
            print("\n".join(job.name for job in jobs))
        else:
            runner.add(repeated(jobs, arguments.times))

    def then(job):
        if job.name == "build" and not arguments.fast:
            add(plan.ros1_tests())
            add(plan.rust_tests(job))
        elif job.name == "Python module":
            add(plan.python_tests(job))
        elif job.name == "ROS 2 packages":
            add(plan.ros2_tests(job))

    if arguments.fast:
        runner.add(plan.fast())
    else:
        runner.add(plan.first())
        add(plan.lints())
    with busy(arguments.busy):
        passed = runner.run(then)
    checks = sorted(f"{job.name.removeprefix('tests/')}: {test}" for job in runner.done for test in job.tests)
    (runner.folder / "checks.txt").write_text("\n".join([*checks, ""]))
    report = table(runner.done, compiled())
    (runner.folder / "table.txt").write_text(report + "\n")
    print(report)
    failed = [job for job in runner.done if job.status != 0]
    if failed:
        print("\nwhat failed, once more:")
        for job in failed:
            print(job.failure())
    minutes, seconds = divmod(round(time.monotonic() - begin_s), 60)
    verdict = "all passed" if passed else f"{len(failed)} failed: {', '.join(job.name for job in failed)}"
    print(f"\n{len(runner.done)} jobs, {len(checks)} tests in {minutes} min {seconds:02d} s: {verdict}")
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
