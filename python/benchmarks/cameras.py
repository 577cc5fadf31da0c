"""What windows and cameras cost a running simulation: cameras.py FOLDER [--quick]. `scripts/bench cameras` starts it with Debian's Python.

Starts roscore, the simulator and, for windows, an X server without a screen, with the helpers of the ROS tests. Frames of a window are
counted by the plugin `marker`, which writes their number at each key; the rest is what the simulator publishes and what the system says
about it. Writes what is between the markers of FOLDER/cameras.md; with --quick it measures a third as long and prints only.
"""

import argparse
import os
import pathlib
import re
import statistics
import struct
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/ros"))

import harness  # noqa: E402
import tcpros  # noqa: E402
from display import Display  # noqa: E402

MARKS = ("<!-- measured: begin -->\n", "<!-- measured: end -->\n")
CAMERAS = "/ambf/env/cameras"
TICKS_S = os.sysconf("SC_CLK_TCK")
# Windows are 0.8 times as wide and half as high.
SCREEN = (1600, 1440)


def vector(x, y, z):
    """As a file writes it."""
    return f"{{x: {x}, y: {y}, z: {z}}}"


def launch(name, lights, cameras):
    """A launch file with the shipped ground and models, `lights` {name: shadow quality} and `cameras` {name: further keys}."""
    text = (
        f"environment: {ROOT}/resources/world/ground.yaml\nnamespace: /ambf/env/\ngravity: {vector(0, 0, -9.81)}\nmax iterations: 50\n"
        f"lights: [{', '.join(lights)}]\ncameras: [{', '.join(cameras)}]\n"
    )
    for index, (light, quality) in enumerate(lights.items()):
        text += (
            f"{light}: {{namespace: lights/, name: {light}, location: {vector(2 - 4 * index, -1.5 + 4 * index, 4)}, "
            f"direction: {vector(-0.45 + 0.9 * index, 0.35 - 0.8 * index, -1)}, "
            f"spot exponent: 0.5, shadow quality: {quality}, cutoff angle: 1.1}}\n"
        )
    for camera, keys in cameras.items():
        text += (
            f"{camera}: {{namespace: cameras/, name: {camera}, location: {vector(3, -1.7, 0.6)}, look at: {vector(0, 0, -0.7)}, "
            f"up: {vector(0, 0, 1)}, clipping plane: {{near: 0.05, far: 50}}, field view angle: 0.8{keys}}}\n"
        )
    world = harness.folder / f"{name}_world.yaml"
    world.write_text(text)
    resources = ROOT / "resources"
    file = harness.folder / f"{name}_launch.yaml"
    file.write_text(
        f"world config: {world}\ninput devices config: {resources}/input_devices.yaml\ncolor config: {resources}/colors.yaml\n"
        "multibody configs: []\n"
    )
    return file


def model(name):
    """A shipped model."""
    return ROOT / f"resources/models/{name}.yaml"


def memory(simulator, field="VmRSS"):
    """MB."""
    status = pathlib.Path(f"/proc/{simulator.process.pid}/status").read_text()
    return int(re.search(rf"{field}:\s+(\d+)", status)[1]) / 1000


def cpu(simulator):
    """Seconds of all its threads so far."""
    fields = pathlib.Path(f"/proc/{simulator.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_S


class Timing:
    """What World/Timing says, collected second by second."""

    def __init__(self, port):
        import rospy
        from ambf_msgs.msg import Timing as TimingMessage

        self.all = []
        self.subscriber = rospy.Subscriber("/ambf/env/World/Timing", TimingMessage, self.all.append)

    def over(self, seconds):
        """Median frequency, Hz, and the largest p99 of an iteration, ms, of the next seconds."""
        harness.wait_for(lambda: self.all, "timing")
        begin = len(self.all)
        time.sleep(seconds)
        found = self.all[begin:]
        return (
            statistics.median(m.physics_frequency for m in found),
            1e3 * statistics.median(m.step_p99 for m in found),
        )

    def close(self):
        """No more."""
        self.subscriber.unregister()


def window(master, scene, shadow, seconds):
    """A row: frames and iterations a second, memory, time to the first frame."""
    file = launch("window", {"key": 4, "fill": 5} if shadow else {"key": 0, "fill": 0}, {"eye": ""})
    plugin = harness.simulator_path().parent / "libambf_marker.so"
    with Display(SCREEN) as display:
        begin = time.monotonic()
        arguments = ("--launch_file", file, "-a", model(scene), "--plugins", plugin)
        simulator = harness.Simulator(master.port, *arguments, gui=("-g", "1"), DISPLAY=display)
        with simulator:
            harness.wait_for(lambda: "the first frame was drawn" in simulator.log(), "the first frame")
            started = time.monotonic() - begin
            timing = Timing(master.port)
            time.sleep(2.0)

            def run(*words):
                done = subprocess.run(
                    ["xdotool", *words],
                    env={**os.environ, "DISPLAY": display},
                    capture_output=True,
                    text=True,
                    check=True,
                )
                return done.stdout.split()

            number = run("search", "--onlyvisible", "--name", "AMBF Simulator Window")[0]
            size = run("getwindowgeometry", number)[-1]
            run("windowfocus", "--sync", number)

            def frame():
                """The number of the frame in which a key arrives, and when."""
                before = simulator.log().count("key ")
                run("key", "y")
                harness.wait_for(lambda: simulator.log().count("key ") > before, "a key arrives")
                return int(re.findall(r"frame (\d+)", simulator.log())[-1]), time.monotonic()

            first, since = frame()
            used = cpu(simulator)
            physics, p99 = timing.over(seconds)
            last, until = frame()
            rate = (last - first) / (until - since)
            cores = (cpu(simulator) - used) / (until - since)
            row = [
                scene,
                size,
                "two maps" if shadow else "no",
                f"{rate:.1f}",
                f"{physics:.0f}",
                f"{p99:.2f}",
                f"{cores:.2f}",
            ]
            row += [f"{memory(simulator):.0f}", f"{started:.2f}"]
            timing.close()
        return row


class Subscriber:
    """Reads a topic as fast as it comes, and nothing else."""

    def __init__(self, port, topic):
        address = tcpros.publisher_address(port, topic)
        self.raw = tcpros.subscribe(address, topic, topic.rsplit("/", 1)[-1])

    def read(self, count):
        """Bytes, and age in ms at arrival after `header.stamp`, of each of the next messages."""
        found = []
        for _ in range(count):
            length = struct.unpack("<I", self.take(4))[0]
            body = self.take(length)
            _, seconds, nanoseconds = struct.unpack_from("<III", body)
            found.append((length, 1e3 * (time.time() - seconds - 1e-9 * nanoseconds), time.monotonic()))
        return found

    def take(self, count):
        """So many bytes."""
        buffer = memoryview(bytearray(count))
        at = 0
        while at < count:
            got = self.raw.recv_into(buffer[at:])
            assert got, "the simulator has closed the connection"
            at += got
        return buffer


def stream(master, words, keys, topics, seconds):
    """A row: what a camera with these keys publishes, how old it is, and what physics does beside it."""
    import threading

    keys = f", visible: false, publish image: true, publish depth: true, {keys}"
    file = launch("stream", {"key": 3, "fill": 0}, {"eye": keys})
    with harness.Simulator(master.port, "--launch_file", file, "-a", model("arm7")) as simulator:
        names = [f"{CAMERAS}/eye/{topic}" for topic in topics]
        simulator.wait_for_topics(*names)
        subscribers = [Subscriber(master.port, name) for name in names]
        found = {}

        def listen(name, subscriber):
            subscriber.read(30)
            end = time.monotonic() + seconds
            messages = []
            while time.monotonic() < end:
                messages += subscriber.read(1)
            found[name] = messages

        threads = [threading.Thread(target=listen, args=pair) for pair in zip(topics, subscribers)]
        timing = Timing(master.port)
        for thread in threads:
            thread.start()
        physics, p99 = timing.over(seconds)
        for thread in threads:
            thread.join()
        timing.close()
        rows = []
        for topic in topics:
            messages = found[topic]
            rate = (len(messages) - 1) / (messages[-1][2] - messages[0][2])
            ages = sorted(age for _, age, _ in messages)
            row = [words, topic, f"{messages[0][0] / 1e6:.2f}", f"{rate:.1f}", f"{ages[len(ages) // 2]:.1f}"]
            row += [f"{ages[int(0.99 * len(ages))]:.1f}", f"{physics:.0f}", f"{p99:.2f}", f"{memory(simulator):.0f}"]
            rows.append(row)
        for subscriber in subscribers:
            subscriber.raw.close()
    return rows


def unwatched(master, rounds, seconds):
    """Rows: CPU, memory and threads of a simulator whose cameras publish, or do not, while nobody subscribes; in turns."""
    kinds = {
        "no topics of pictures": ", visible: false",
        "image and depth, nobody subscribes": ", visible: false, publish image: true, publish depth: true",
    }
    found = {kind: [] for kind in kinds}
    for _ in range(rounds):
        for kind, keys in kinds.items():
            file = launch("unwatched", {"key": 4, "fill": 0}, {"eye": keys})
            with harness.Simulator(master.port, "--launch_file", file, "-a", model("arm7")) as simulator:
                simulator.wait_for_topics("/ambf/env/World/State")
                time.sleep(1.0)
                used, begin = cpu(simulator), time.monotonic()
                time.sleep(seconds)
                share = 100 * (cpu(simulator) - used) / (time.monotonic() - begin)
                threads = len(os.listdir(f"/proc/{simulator.process.pid}/task"))
                graphics = "libEGL" in pathlib.Path(f"/proc/{simulator.process.pid}/maps").read_text()
                found[kind].append((share, memory(simulator, "VmHWM"), threads, graphics))
    rows = []
    for kind, all_rounds in found.items():
        shares = sorted(share for share, *_ in all_rounds)
        _, peak, threads, graphics = all_rounds[-1]
        row = [
            kind,
            f"{statistics.median(shares):.1f}",
            f"{shares[0]:.1f} to {shares[-1]:.1f}",
            f"{peak:.1f}",
            str(threads),
        ]
        rows.append([*row, "yes" if graphics else "no"])
    return rows


def table(title, words, header, rows):
    """A section."""
    lines = [f"### {title}", "", words, "", f"| {' | '.join(header)} |", "|" + "---|" * len(header)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)]) + "\n"


def main():
    """Measures, prints and writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    seconds = 4.0 if arguments.quick else 12.0
    harness.set_up()
    load = " ".join(f"{x:.2f}" for x in os.getloadavg())
    text = (
        f"Machine: {os.cpu_count()} cores, {os.uname().sysname} {os.uname().release}; load average before: {load}.\n\n"
    )
    with harness.Master() as master:
        import node

        node.start(master.port)
        # Programs are read from the disk once before anything is measured.
        window(master, "pendulum", False, 1.0)
        rows = [window(master, scene, shadow, seconds) for scene in ("boxes200", "arm7") for shadow in (True, False)]
        text += table(
            "Windows",
            "An X server without a screen; the time to the first frame is from the start of the program.",
            [
                "scene",
                "window",
                "shadows",
                "frames/s",
                "physics, Hz",
                "p99 of an iteration, ms",
                "cores",
                "memory, MB",
                "first frame, s",
            ],
            rows,
        )
        size = (
            "publish image resolution: {width: 640, height: 480}, publish depth resolution: {width: 640, height: 480}"
        )
        eyes = size.replace("640", "1280") + ", stereo: {mode: passive, eye separation: 0.06, focal length: 3}"
        at_30 = ", publish image interval: 4, publish depth interval: 4"
        rows = stream(master, "640×480", size + at_30, ["ImageData"], seconds)
        rows += stream(master, "640×480", size + at_30, ["ImageData", "DepthImage"], seconds)
        rows += stream(master, "stereo 2 × 640×480", eyes + at_30, ["ImageData", "DepthImage"], seconds)
        rows += stream(master, "640×480", size + at_30, ["DepthData"], seconds)
        text += "\n" + table(
            "Streams",
            "Every fourth frame of 120 a second, to local subscribers that only read. Age: from `header.stamp`, the time of the physics "
            "step, to the last byte.",
            [
                "camera",
                "topic",
                "MB a message",
                "messages/s",
                "age p50, ms",
                "p99, ms",
                "physics, Hz",
                "p99 of an iteration, ms",
                "memory, MB",
            ],
            rows,
        )
        text += "\n" + table(
            "Cameras that nobody watches",
            "The arm, headless; programs take turns. CPU time in % of one core: median, and from the lowest to the highest run.",
            ["camera", "CPU, %", "CPU, range", "peak memory, MB", "threads", "OpenGL loaded"],
            unwatched(master, 3 if arguments.quick else 5, seconds),
        )
    harness.tear_down()
    print(text)
    if not arguments.quick:
        page = arguments.folder / "cameras.md"
        before, rest = page.read_text().split(MARKS[0])
        _, after = rest.split(MARKS[1])
        page.write_text(before + MARKS[0] + text + MARKS[1] + after)


if __name__ == "__main__":
    main()
