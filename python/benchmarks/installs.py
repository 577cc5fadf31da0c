"""From nothing to the first state, by each way to install: installs.py FILE [--ways WAY…]. `scripts/bench installs` starts it.

pip: what `pip download` fetches into an empty folder, then `pip install` of that into an empty virtual environment. apt: `scripts/deb
--test`, which installs in a clean root (as root). Source: `scripts/simulate` in a new clone, with crates downloaded and Debian's packages
there, until the topics of a scene are published; without and with windows. Rewrites what is between the markers of FILE.
"""

import argparse
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/ros"))

import harness  # noqa: E402

MARKS = ("<!-- measured: begin -->\n", "<!-- measured: end -->\n")
ARM = ROOT / "resources/models/hanging_arm.urdf"
HEAD = "| | fetched, MB | installed, MB | fetch, s | install, s | first state, s |\n|---|--:|--:|--:|--:|--:|\n"
# What is installed, and a program that loads an arm, steps it and reads a joint.
PIP = {
    "pip install ambf": (None, f"import ambf; s = ambf.Simulation({str(ARM)!r}); s.step(1); print(s.sim_time)"),
    "pip install mujoco": (
        ["mujoco"],
        f"import mujoco as m; a = m.MjModel.from_xml_path({str(ARM)!r}); d = m.MjData(a); m.mj_step(a, d); print(d.qpos[0])",
    ),
    # Its wheel does not say that it needs NumPy.
    "pip install pybullet numpy": (
        ["pybullet", "numpy"],
        f"import pybullet as p; p.connect(p.DIRECT); a = p.loadURDF({str(ARM)!r}); p.stepSimulation(); print(p.getJointState(a, 1)[0])",
    ),
}
SOURCE = {"source, no display": "", "source, with windows": ":99"}


def run(*command, **options):
    """(Seconds, output) of a program; ends this one with its output when it fails."""
    begin = time.monotonic()
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False, **options)
    if done.returncode:
        sys.exit(f"{command[0]} ended with status {done.returncode}\n{done.stdout}{done.stderr}")
    return time.monotonic() - begin, done.stdout


def megabytes(folder):
    """Size of all files below a folder."""
    return sum(file.lstat().st_size for file in folder.rglob("*") if file.is_file() and not file.is_symlink()) / 1e6


def pip(name, folder):
    """A row of the table."""
    what, program = PIP[name]
    if not what:
        run(ROOT / "scripts/wheel")
        wheels = sorted((ROOT / "target/wheels").glob("ambf-*.whl"), key=lambda file: file.stat().st_mtime)
        what = [wheels[-1]]
    venv, fetched = folder / "venv", folder / "fetched"
    run(sys.executable, "-m", "venv", venv)
    before = megabytes(venv)
    common = (venv / "bin/pip", "--disable-pip-version-check", "--no-cache-dir")
    fetch, _ = run(*common, "download", "--quiet", "--only-binary", ":all:", "-d", fetched, *what)
    local = ("--no-index", "--find-links", fetched, *what)
    install, _ = run(*common, "install", "--quiet", *local)
    # The second start: the first one compiles Python.
    first = [run(venv / "bin/python", "-c", program)[0] for _ in range(2)][-1]
    return f"{megabytes(fetched):.1f} | {megabytes(venv) - before:.0f} | {fetch:.1f} | {install:.1f} | {first:.2f}"


def apt():
    """The row of Debian's packages."""
    _, said = run(ROOT / "scripts/deb", "--test")
    package = max((ROOT / "target/debian").glob("ambf_*.deb"), key=lambda file: file.stat().st_mtime)
    _, size = run("dpkg-deb", "--field", package, "Installed-Size")
    seconds = re.search(r"^installed in (\d+) s", said, re.MULTILINE)[1]
    return f"{package.stat().st_size / 1e6:.1f} | {int(size) / 1e3:.0f} | – | {seconds} | below 1"


def source(name, folder):
    """The row of a build from a new clone; no window is opened."""
    clone = folder / "clone"
    run("git", "clone", "--quiet", "--depth", "1", f"file://{ROOT}", clone)
    port = harness.free_port()
    left_out = ("DISPLAY", "WAYLAND_DISPLAY", "CARGO_TARGET_DIR")
    env = {key: value for key, value in harness.environment(port).items() if key not in left_out}
    env["DISPLAY"] = SOURCE[name]
    begin = time.monotonic()
    simulator = harness.Program([clone / "scripts/simulate", "-g", "0"], env)
    with simulator:
        built = clone / "target/release/ambf_simulator"
        harness.wait_for(lambda: built.exists() or not simulator.running(), "it is built", 3600)
        seconds = time.monotonic() - begin
        begin = time.monotonic()
        harness.wait_for(lambda: "/ambf/env/arm7/flange/State" in harness.published(port), "states", 60)
        first = time.monotonic() - begin
        crates = simulator.log().count("Compiling ")
        os.kill(simulator.process.pid, 2)
    size = megabytes(clone / "target")
    return f"{crates} crates | {size:.0f} (folder `target`) | – | {seconds:.0f} | {first:.1f}"


def main():
    """Measures, and writes the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=pathlib.Path)
    parser.add_argument("--ways", nargs="+", choices=[*PIP, "apt", *SOURCE], default=[*PIP, "apt", *SOURCE])
    options = parser.parse_args()
    harness.set_up()
    table = HEAD
    try:
        for way in options.ways:
            with tempfile.TemporaryDirectory(prefix="ambf-installs-") as made:
                folder = pathlib.Path(made)
                row = apt() if way == "apt" else pip(way, folder) if way in PIP else source(way, folder)
            print(f"{way}: {row}", flush=True)
            table += f"| {way} | {row} |\n"
    finally:
        harness.tear_down()
    model = re.search(r"model name\s*: (.*)", pathlib.Path("/proc/cpuinfo").read_text())[1]
    table = f"Machine: {model}, {os.cpu_count()} cores; Python {sys.version.split()[0]}.\n\n{table}"
    if options.ways == [*PIP, "apt", *SOURCE]:
        before, rest = options.file.read_text().split(MARKS[0])
        options.file.write_text(before + MARKS[0] + table + MARKS[1] + rest.split(MARKS[1])[1])


if __name__ == "__main__":
    main()
