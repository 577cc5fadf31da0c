"""What is checked: the jobs of the whole suite."""

import dataclasses
import json
import os
import pathlib
import subprocess

from jobs import Job

ROOT = pathlib.Path(__file__).resolve().parents[2]
TARGET = ROOT / os.environ.get("CARGO_TARGET_DIR", "target")
DEBIAN_PYTHON = "/usr/bin/python3"
# Lints and documentation get what the tests leave.
PATIENT = 14
# What scripts/simulate builds where there is no display. All packages but those that ask for windows are chosen, so that cargo compiles
# what they have in common with the features that it has already.
WITHOUT_WINDOWS = (
    *("--workspace", "--lib", "--bins", "--no-default-features", "--features", "ambf-app/pictures,ambf-app/ros2"),
    *(
        word
        for package in ("bench", "packaging", "python", "test-support")
        for word in ("--exclude", f"ambf-{package}")
    ),
)
# What a job of bash prints at its end: variables that it has exported.
SHOWN = ("AMBF_PYTHON", "AMBF_ROS2_PYTHON", "PYTHONPATH", "LD_LIBRARY_PATH")
SHOW = "".join(f'\necho "{name}=${{{name}-}}"' for name in SHOWN)
PACKAGES = ("ambf", "ambf_client", "ambf_gym")
# The modules of tests/crtk that talk to the arms, rather than to what is inside them, run over ROS 2 as well.
CRTK_OVER_ROS2 = ("contract", "robot", "restart", "pause")


def cargo(name, *words, **more):
    """A job that calls cargo."""
    return Job(name, ["cargo", *words], ROOT, cargo=True, **more)


def shell(name, text, **more):
    """A job of bash."""
    return Job(name, ["bash", "-ec", text], ROOT, **more)


def first():
    """Jobs that need none before them: formats, the build of programs and tests, environments of Python."""
    build = ("test", "--workspace", "--no-run", "--timings", "--message-format", "json-render-diagnostics")
    return [
        cargo("format", "fmt", "--all", "--check"),
        cargo("build", *build, needs=("format",)),
        # They fetch packages and compile messages. The module of Python is built after the tests, of the same parts.
        shell("ROS 2 packages", ". scripts/ros2-venv" + SHOW),
        shell("Python module", ". scripts/python-venv" + SHOW, cargo=True, needs=("build",)),
    ]


def shown(job):
    """The variables that a job with `SHOW` has printed and that are not empty."""
    lines = job.output.read_text().splitlines()[-len(SHOWN) :]
    return {name: value for name, _, value in (line.partition("=") for line in lines) if value}


def lints():
    """Lints of Rust, its documentation and the examples in it, after the build."""
    return [
        cargo("examples in documentation", "test", "--workspace", "--doc", nice=PATIENT, needs=("build",)),
        cargo(
            "lints", "clippy", "--workspace", "--all-targets", "--", "-D", "warnings", nice=PATIENT, needs=("build",)
        ),
        cargo(
            "lints without windows", "clippy", *WITHOUT_WINDOWS, "--", "-D", "warnings", nice=PATIENT, needs=("build",)
        ),
        cargo(
            *("documentation", "doc", "--workspace", "--no-deps"),
            nice=PATIENT,
            needs=("build",),
            environment={"RUSTDOCFLAGS": "-D warnings"},
        ),
    ]


def fast():
    """Format, lints and unit tests."""
    return [
        cargo("format", "fmt", "--all", "--check"),
        cargo("unit tests", "test", "--workspace", "--lib", needs=("format",)),
        *(dataclasses.replace(job, needs=("format",), nice=0) for job in lints() if job.name.startswith("lints")),
    ]


def again(job, time):
    """The same job for another time."""
    return dataclasses.replace(job, name=f"{job.name} ({time})")


def programs():
    """What tests that start programs are told: they were built, with their assertions on."""
    return {
        "AMBF_SIMULATOR": os.environ.get("AMBF_SIMULATOR", str(TARGET / "debug/ambf_simulator")),
        "AMBF_EXAMPLES_ARE_BUILT": "1",
    }


def rust_tests(build):
    """A job for each test program that the job `build` has made."""
    jobs = []
    libraries = subprocess.run(
        ["rustc", "--print", "target-libdir"], check=True, capture_output=True, text=True, cwd=ROOT
    ).stdout.strip()
    for line in build.output.read_text().splitlines():
        if not line.startswith("{"):
            continue
        made = json.loads(line)
        if made.get("reason") == "compiler-artifact" and made["profile"]["test"] and made["executable"]:
            folder = pathlib.Path(made["manifest_path"]).parent
            name = f"{folder.relative_to(ROOT)} {made['target']['kind'][0]} {made['target']['name']}"
            where = {
                "CARGO_MANIFEST_DIR": str(folder),
                "LD_LIBRARY_PATH": f"{TARGET}/debug/deps:{TARGET}/debug:{libraries}",
            }
            jobs.append(Job(name, [made["executable"]], folder, programs() | where))
    return jobs


def modules(folder):
    """The test modules of a folder."""
    return sorted((ROOT / folder).glob("test_*.py"))


def ros1_tests():
    """Real ROS 1 programs against the simulator; first a teleoperation while clients, arms and masters come and go."""
    run = [DEBIAN_PYTHON, ROOT / "tests/ros/run.py"]
    soak = [DEBIAN_PYTHON, "python/benchmarks/soak.py", "docs/benchmarks", "--minutes", "1"]
    jobs = [Job("soak", soak, ROOT, programs(), needs=("build",))]
    for folder in ("tests/ros", "tests/crtk"):
        for path in modules(folder):
            jobs.append(Job(f"{folder} {path.stem}", [*run, path], ROOT, programs(), needs=("build",)))
    return jobs


def python_tests(module):
    """Tests, lints and types of the Python packages, with the variables that the job `module` has printed."""
    variables = shown(module)
    python = variables["AMBF_PYTHON"]
    sources = [f"{package}/{'python' if package == 'ambf' else 'src'}/{package}" for package in PACKAGES]
    sources += [f"ambf_gym/src/{package}" for package in ("ambf_peg_transfer", "ambf_ring_on_wire")]
    folder, ruff = ROOT / "python", (python, "-m", "ruff")
    suite = ("--config", "python/ruff.toml", "tests/suite", "tests/domains.py")
    jobs = [
        Job("Python format", [*ruff, "format", "--check", "."], folder),
        Job("Python lints", [*ruff, "check", "."], folder),
        Job("Python format of the suite", [*ruff, "format", "--check", *suite], ROOT),
        Job("Python lints of the suite", [*ruff, "check", *suite], ROOT),
        Job("Python types", [python, "-m", "mypy", "--config-file", "mypy.ini", *sources], folder),
    ]
    for folder in (*(f"python/{package}/tests" for package in PACKAGES), "python/tests"):
        for path in modules(folder):
            jobs.append(Job(f"{folder} {path.stem}", [python, "tests/ros/run.py", path], ROOT, variables | programs()))
    return jobs


def ros2_tests(packages):
    """Real ROS 2 programs against the simulator, with the variables that the job `packages` has printed."""
    variables = shown(packages) | programs()
    discover = [variables["AMBF_ROS2_PYTHON"], "-W", "ignore", "-m", "unittest", "discover", "--verbose", "-s"]
    jobs = [
        Job(f"tests/ros2 {path.stem}", [*discover, "tests/ros2", "-p", path.name], ROOT, variables, needs=("build",))
        for path in modules("tests/ros2")
    ]
    for name in CRTK_OVER_ROS2:
        command = [*discover, "tests/crtk", "-p", f"test_{name}.py"]
        jobs.append(
            Job(f"tests/crtk test_{name} over ROS 2", command, ROOT, variables | {"CRTK_ROS": "2"}, needs=("build",))
        )
    return jobs
