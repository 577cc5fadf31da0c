"""Runs the tests of this folder, or of others, against the simulator: run.py [MODULE | FILE | FOLDER]…

Each module gets its own process, since a process can be a ROS node only once. Ends with one line `N passed, N failed`
and exit status 1 if any failed."""

import pathlib
import subprocess
import sys
import time
import unittest

FOLDER = pathlib.Path(__file__).resolve().parent


def files(arguments):
    """The modules that the arguments name."""
    for argument in arguments or [FOLDER]:
        path = pathlib.Path(argument).resolve()
        if path.is_dir():
            yield from sorted(path.glob("test_*.py"))
        else:
            yield path if path.suffix == ".py" else FOLDER / f"{argument}.py"


def run_module(path):
    """Runs one module in this process; the last line printed holds the counts for `main`."""
    sys.path[:0] = [str(path.parent), str(FOLDER)]
    import harness  # pylint: disable=import-outside-toplevel

    harness.set_up()
    try:
        suite = unittest.defaultTestLoader.loadTestsFromName(path.stem)
        result = unittest.TextTestRunner(stream=sys.stdout, verbosity=2).run(suite)
    finally:
        harness.tear_down()
    failed = len(result.failures) + len(result.errors) + len(result.unexpectedSuccesses)
    passed = max(result.testsRun - failed - len(result.skipped), 0)
    print(f"counts {passed} {failed}", flush=True)


def main(arguments):
    """Runs all modules and returns the exit status."""
    passed = failed = 0
    for module in files(arguments):
        print(f"-- {module.stem}", flush=True)
        last, begin_s = "", time.monotonic()
        with subprocess.Popen(
            [sys.executable, "-u", __file__, "--here", module], stdout=subprocess.PIPE, text=True
        ) as child:
            for line in child.stdout:
                last = line
                if not line.startswith("counts "):
                    print(line, end="", flush=True)
        print(f"{module.stem}: {time.monotonic() - begin_s:.0f} s", flush=True)
        counts = last.split()
        if child.returncode == 0 and len(counts) == 3 and counts[0] == "counts" and counts[1:] != ["0", "0"]:
            passed += int(counts[1])
            failed += int(counts[2])
        else:
            print(f"{module.stem} ended with status {child.returncode}")
            failed += 1
    print(f"{passed} passed, {failed} failed")
    return 1 if failed or not passed else 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--here"]:
        run_module(pathlib.Path(sys.argv[2]))
    else:
        sys.exit(main(sys.argv[1:]))
