"""What recording costs: recordings.py FOLDER [--quick]

Measures, with and without a recording by turns:
* the processor time of an iteration in the thread that makes it, in this process, and what the thread that writes takes beside it;
* periods of the loop of an input device, a Falcon in software, in the simulator as a program;
* the processor time of `rosbag record` of all topics of the same scene, beside that of the simulator that records itself;
and how long the files are. Writes FOLDER/recordings.md between its markers.
"""

import argparse
import os
import platform
import re
import shutil
import signal
import socket
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import ambf
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
RESOURCES = ROOT / "resources"
MARKS = ("<!-- measured: begin -->\n", "<!-- measured: end -->\n")
TICKS = os.sysconf("SC_CLK_TCK")
DEVICES = """input devices: [Right Hand]
Right Hand:
  hardware name: Falcon
  driver settings: {{transport: fake}}
  simulated multibody: {resources}/teleop/gripper.yaml
  root link: BODY palm
  workspace scaling: 5
  controller gain: {{linear: {{P: 200, I: 0, D: 25}}}}
  haptic gain: {{linear: 100, angular: 0}}
"""


class Scene:
    """A scene, and how clients move it: `command(simulation, i)` before step i."""

    def __init__(self, name, command, step=0.001, **options):
        self.name, self.command, self.step = name, command, step
        self.options = {"profile": "accurate", "step": step, **options}

    def run(self, steps, file):
        """Makes steps, recorded into `file` unless that is None.

        Processor time of an iteration in this thread and in all others, µs; MB a simulated minute.
        """
        with ambf.Simulation(**self.options) as simulation:
            if file is not None:
                simulation.record(file)
            own, whole = time.thread_time(), time.process_time()
            for i in range(steps):
                self.command(simulation, i)
                simulation.step()
            own, whole = time.thread_time() - own, time.process_time() - whole
            if file is not None:
                simulation.stop_recording()
        if file is None:
            return 1e6 * own / steps, 1e6 * (whole - own) / steps, 0.0
        # Without the descriptions of the scene, which are in each file once.
        with ambf.Simulation(**self.options) as simulation:
            simulation.record(file.with_suffix(".short.mcap"))
            simulation.step()
            simulation.stop_recording()
        megabytes = (
            (file.stat().st_size - file.with_suffix(".short.mcap").stat().st_size) / 1e6 / (steps * self.step / 60.0)
        )
        return 1e6 * own / steps, 1e6 * (whole - own) / steps, megabytes


def move_joints(simulation, i):
    """All joints, another command in each iteration."""
    body = simulation.body("arm7/base")
    body.joint_kinds = ambf.POSITION
    body.joint_commands = 0.3 * np.sin(0.002 * i)


def move_arms(simulation, i):
    """Two arms by their topics."""
    for name in ("PSM1", "PSM2"):
        way = 0.1 * np.sin(0.01 * i)
        simulation.arm(name).send("servo_jp", [way, 0.5 * way, 0.12, way, way, way])


def scenes():
    """What is measured."""
    launch, peg = RESOURCES / "launch.yaml", RESOURCES / "peg_transfer"
    return [
        Scene("an arm of 7 joints, commanded in each iteration", move_joints, launch_file=launch, indexes=[4]),
        Scene("200 boxes in contact, not commanded", lambda *_: None, launch_file=launch, indexes=[8]),
        Scene(
            "two dVRK arms of the peg transfer, by their topics",
            move_arms,
            launch_file=peg / "launch.yaml",
            indexes=[0, 1, 2, 4],
            crtk=[peg / "crtk_announced.yaml"],
        ),
    ]


def cost(folder, rounds, seconds):
    """Rows of the table of iterations."""
    rows = []
    for scene in scenes():
        steps = max(100, min(2000, round(seconds / (1e-6 * sum(scene.run(100, None)[:2]) / 1.0))))
        plain, recorded = [], []
        for turn in range(rounds):
            plain.append(scene.run(steps, None))
            recorded.append(scene.run(steps, folder / f"{len(rows)}-{turn}.mcap"))
        own = [statistics.median(times[0] for times in of) for of in (plain, recorded)]
        ratios = [with_it[0] / without[0] for without, with_it in zip(plain, recorded)]
        others = statistics.median(with_it[1] - without[1] for without, with_it in zip(plain, recorded))
        size = statistics.median(times[2] for times in recorded)
        rows.append(
            f"| {scene.name} | {own[0]:.1f} | {own[1]:.1f} | {statistics.median(ratios):.3f} ({min(ratios):.2f}–{max(ratios):.2f}) "
            f"| {others:.1f} | {size:.2f} |"
        )
    return rows


class Program:
    """`ambf_simulator` without windows."""

    def __init__(self, *words, **variables):
        program = os.environ["AMBF_SIMULATOR"]
        environment = {**os.environ, "AMBF_RESOURCES": str(RESOURCES), **variables}
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            [program, "-g", "0", *map(str, words)], stdout=pipe, stderr=subprocess.STDOUT, text=True, env=environment
        )
        self.pid = self._process.pid

    def end(self):
        """Ctrl+C; what it has said."""
        self._process.send_signal(signal.SIGINT)
        said, _ = self._process.communicate(timeout=60)
        if self._process.returncode != 0:
            raise RuntimeError(said)
        return said


def processor_time(pid):
    """Of a process, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def devices(folder, rounds, seconds):
    """Rows of the table of device loops: medians of rounds of p50 and p99, ms."""
    (folder / "devices.yaml").write_text(DEVICES.format(resources=RESOURCES))
    launch = folder / "launch.yaml"
    launch.write_text(
        f"world config: {RESOURCES}/world/world.yaml\ncolor config: {RESOURCES}/colors.yaml\n"
        f"input devices config: devices.yaml\nmultibody configs: [{RESOURCES}/models/arm7.yaml]\n"
    )
    found = {False: [], True: []}
    for turn in range(rounds):
        for is_recorded, of in found.items():
            more = ["--record", folder / f"device{turn}.mcap"] if is_recorded else []
            program = Program("--no_ros", "--launch_file", launch, "-l", "0", "-i", "0", "-e", "1", *more)
            time.sleep(seconds)
            said = program.end()
            rates = re.findall(r"Right Hand \[Falcon\]: .*periods p50 ([\d.]+), p99 ([\d.]+)", said)
            if not rates:
                raise RuntimeError(said)
            of.append(tuple(map(float, rates[-1])))
    names = {False: "without a recording", True: "recorded"}
    return [
        f"| {names[is_recorded]} | {statistics.median(p50 for p50, _ in of):.2f} | {statistics.median(p99 for _, p99 in of):.2f} |"
        for is_recorded, of in found.items()
    ]


def free_port():
    """One that nobody listens at."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def bags(folder, rounds, seconds):
    """Rows of the table beside rosbag: processor time a second, %, and MB a minute."""
    ways = {"nobody records": [], "`ambf_simulator --record`": [], "`rosbag record -a`": []}
    for turn in range(rounds):
        for way, of in ways.items():
            variables = {"ROS_MASTER_URI": f"http://127.0.0.1:{free_port()}", "ROS_IP": "127.0.0.1"}
            file = folder / f"beside{turn}{'.bag' if 'rosbag' in way else '.mcap'}"
            more = ["--record", file] if "ambf" in way else []
            program = Program("-l", "4,5,6", "--launch_file", RESOURCES / "launch.yaml", *more, **variables)
            time.sleep(2.0)
            recorder = None
            if "rosbag" in way:
                words = [shutil.which("rosbag"), "record", "--quiet", "-a", "-O", str(file)]
                environment = {**os.environ, **variables, "ROS_LOG_DIR": str(folder)}
                recorder = subprocess.Popen(
                    words, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
                )
                # It subscribes to one topic after the other.
                time.sleep(4.0)
            children = [program.pid, *([] if recorder is None else family(recorder.pid))]
            before = [processor_time(pid) for pid in children]
            time.sleep(seconds)
            used = [100.0 * (processor_time(pid) - was) / seconds for pid, was in zip(children, before)]
            lasted = seconds + (2.0 if recorder is None else 4.0)
            if recorder is not None:
                # The program itself, which then completes the file.
                os.kill(children[-1], signal.SIGINT)
                recorder.wait(60)
            program.end()
            size = file.stat().st_size / 1e6 / (lasted / 60.0) if file.exists() else 0.0
            of.append((used[0], sum(used[1:]), size))
    return [
        f"| {way} | " + " | ".join(f"{statistics.median(column):.1f}" for column in zip(*of)) + " |"
        for way, of in ways.items()
    ]


def family(pid):
    """A process and its children: rosbag is a script that starts a program."""
    listed = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [pid, *(other for child in listed for other in family(int(child)))]


def main():
    """Measures, and writes the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--quick", action="store_true", help="fewer and shorter rounds")
    chosen = parser.parse_args()
    rounds, seconds = (3, 4.0) if chosen.quick else (10, 10.0)
    load = " ".join(f"{number:.2f}" for number in os.getloadavg())
    build = Path(os.environ["AMBF_SIMULATOR"]).parent.name
    build = {"debug": "the build of the tests: optimised, with assertions"}.get(build, build)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        parts = [
            f"Machine: {platform.machine()}, {os.cpu_count()} cores, Linux {platform.release()}; load average before: {load}. "
            f"Simulator: {ambf.__version__}, {build}. Medians of {rounds} rounds; with and "
            "without by turns.",
            "### Iterations\n\nProcessor time of an iteration in the thread that makes it, µs, with what Python takes to command it; the "
            "ratio is the median of the rounds' (smallest to largest). *Beside*: what other threads take of the processor, above all the "
            "one that writes.",
            "| scene | without, µs | recorded, µs | ratio | beside, µs | MB a simulated minute |\n|---|--:|--:|--:|--:|--:|\n"
            + "\n".join(cost(folder, rounds, 1.0)),
            "### The loop of an input device\n\nPeriods of a Falcon's loop in `ambf_simulator`, ms.",
            "| | p50, ms | p99, ms |\n|---|--:|--:|\n" + "\n".join(devices(folder, rounds // 3 + 1, seconds)),
        ]
        if shutil.which("rosbag"):
            table = bags(folder, rounds // 3 + 1, seconds)
            parts += [
                "### Beside `rosbag record`\n\nAn arm, a gripper and a model of all joints in real time, with all their topics: processor "
                "time, % of a core; whole files.",
                "| | simulator, % | rosbag, % | MB a minute |\n|---|--:|--:|--:|\n" + "\n".join(table),
            ]
    file = chosen.folder / "recordings.md"
    text = file.read_text()
    before, rest = text.split(MARKS[0])
    file.write_text(before + MARKS[0] + "\n\n".join(parts) + "\n\n" + MARKS[1] + rest.split(MARKS[1])[1])
    print("\n\n".join(parts))


if __name__ == "__main__":
    main()
