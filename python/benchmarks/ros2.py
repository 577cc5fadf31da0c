"""Whether ROS 2 stays as it is while clients come, hang and go: ros2.py FOLDER [--minutes M] [--quick]. `scripts/bench ros2` starts it.

A simulator has 200 floating bodies. One client of rclpy reads ten of them all the time, and another two at the faster rate, which a third
commands. Meanwhile others come: each reads twenty bodies for some seconds, then ends, is killed, or is stopped for fifteen seconds and
goes on. A line a minute says what the two clients got and what the system says about the simulator; the last ones say what is left when all
have gone. Writes what is between the markers of FOLDER/ros2.md; with --quick, which lasts a minute, it prints only.
"""

import argparse
import json
import os
import pathlib
import random
import select
import signal
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/ros2"))

from watched import Client, Watched, percentile  # noqa: E402

MARKS = ("<!-- measured: begin -->\n", "<!-- measured: end -->\n")
BODIES = 200
READ = range(10)
COMMANDED = range(100, 102)
SLOW_HZ, FAST_HZ = 50, 200
VISITORS = 3
PATIENCE_S = 60.0


def body(number):
    """Name of a body's topics."""
    return f"/ambf/env/Box{number}"


def write_model(file):
    """A model of boxes that float, each its own way."""
    boxes = {
        f"BODY Box{number}": {
            "name": f"Box{number}",
            "mass": 1.0,
            "inertia": {"ix": 0.1, "iy": 0.1, "iz": 0.1},
            "location": {"position": {"x": float(number % 20), "y": float(number // 20), "z": 50.0}},
            "gravity": {"x": 0.0, "y": 0.0, "z": 0.0},
            "collision shape": "Box",
            "collision geometry": {"x": 0.1, "y": 0.1, "z": 0.1},
        }
        for number in range(BODIES)
    }
    file.write_text(json.dumps({"namespace": "/ambf/env/", "bodies": list(boxes), **boxes}))


def read_states(numbers):
    """A client that reads bodies until its input ends, and at each line of it says what it got since the last one: count, ages in ms."""
    import rclpy
    from ambf_msgs.msg import RigidBodyState

    rclpy.init()
    node = rclpy.create_node(f"reader_{os.getpid()}")
    ages = []

    def received(state):
        stamp = state.header.stamp
        ages.append(1e3 * (time.time() - stamp.sec - 1e-9 * stamp.nanosec))

    for number in numbers:
        node.create_subscription(RigidBodyState, f"{body(number)}/State", received, 100)
    while True:
        rclpy.spin_once(node, timeout_sec=0.05)
        if select.select([sys.stdin], [], [], 0.0)[0]:
            if not sys.stdin.readline():
                break
            taken, ages[:] = list(ages), []
            said = [len(taken), percentile(taken, 0.5), percentile(taken, 0.99), max(taken, default=0)]
            print(json.dumps(said), flush=True)
    # The library's own end of the process takes seconds at times.
    os._exit(0)


def command(numbers):
    """A client that commands bodies until its input ends."""
    import rclpy
    from ambf_msgs.msg import RigidBodyCmd

    rclpy.init()
    node = rclpy.create_node("commander")
    publishers = [node.create_publisher(RigidBodyCmd, f"{body(number)}/Command", 1) for number in numbers]
    while not select.select([sys.stdin], [], [], 0.01)[0]:
        for publisher in publishers:
            publisher.publish(RigidBodyCmd())
    os._exit(0)


def start(domain, role, numbers):
    """This program as one of its clients."""
    # The wheels start the interpreter again with paths of their own, unless this is set.
    kept = {name: value for name, value in os.environ.items() if name != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    command = ["-W", "ignore", __file__, "--role", role, "--numbers", json.dumps(list(numbers)), "-"]
    return Client(command, dict(kept, ROS_DOMAIN_ID=str(domain)))


class Visitors:
    """Clients that come and go."""

    def __init__(self, domain, seed):
        self.domain = domain
        self.random = random.Random(seed)
        # Each with when something is to be done to it, and what.
        self.there = []
        self.counts = {"ended": 0, "killed": 0, "stopped": 0}

    def tend(self):
        """Does what is due, and replaces who has gone."""
        now = time.monotonic()
        for visitor in [visitor for visitor in self.there if visitor[1] <= now]:
            client, _, what = visitor
            self.there.remove(visitor)
            if what == "stopped":
                client.process.send_signal(signal.SIGSTOP)
                self.there.append((client, now + 15.0, "continued"))
                self.counts[what] += 1
            elif what == "continued":
                client.process.send_signal(signal.SIGCONT)
                self.there.append((client, now + 3.0, "ended"))
            elif what == "killed":
                client.kill()
                self.counts[what] += 1
            else:
                client.end(PATIENCE_S)
                self.counts[what] += 1
        while len(self.there) < VISITORS:
            client = start(self.domain, "read", self.random.sample(range(BODIES), 20))
            what = self.random.choice(["ended", "ended", "killed", "stopped"])
            self.there.append((client, now + self.random.uniform(6.0, 12.0), what))

    def leave(self):
        """All go."""
        for client, _, what in self.there:
            if what == "continued":
                client.process.send_signal(signal.SIGCONT)
            client.end(PATIENCE_S)
        self.there.clear()


HEAD = """| | slow: % of the states | age p50, ms | p99, ms | fast: % of the states | age p50, ms | p99, ms | ended, killed, stopped \
| processor, % | memory, MB | threads | files |
|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|
"""


def measure(simulator, domain, minutes, seconds):
    """The table, a line a minute."""
    watched = Watched(simulator.pid)
    slow, fast = start(domain, "read", READ), start(domain, "read", COMMANDED)
    commander = start(domain, "command", COMMANDED)
    visitors = Visitors(domain, 1)
    table = HEAD

    def say(row):
        nonlocal table
        table += row + "\n"
        print(row, flush=True)

    print(HEAD, end="")
    # All are there and the faster rate is reached.
    time.sleep(10.0)
    for client in (slow, fast):
        client.ask()
    say(f"| before the others come | | | | | | | | {watched.row()} |")
    for minute in range(minutes):
        begin = time.monotonic()
        while time.monotonic() < begin + seconds:
            visitors.tend()
            time.sleep(0.05)
        took = time.monotonic() - begin
        cells = ""
        for client, expected in ((slow, SLOW_HZ * len(READ)), (fast, FAST_HZ * len(COMMANDED))):
            count, half, most, _ = client.ask()
            cells += f" {100.0 * count / expected / took:.1f} | {half:.2f} | {most:.1f} |"
        counts = ", ".join(str(count) for count in visitors.counts.values())
        say(f"| minute {minute + 1} |{cells} {counts} | {watched.row()} |")
    visitors.leave()
    for client in (slow, fast, commander):
        client.end(PATIENCE_S)
    watched.processor()
    time.sleep(10.0)
    say(f"| 10 s after all have gone | | | | | | | | {watched.row()} |")
    if minutes > 1:
        time.sleep(50.0)
        say(f"| 60 s after all have gone | | | | | | | | {watched.row()} |")
    return table


def main():
    """Measures, or is one of the clients."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--minutes", type=int, default=10)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--role", choices=["read", "command"])
    parser.add_argument("--numbers", type=json.loads)
    options = parser.parse_args()
    if options.role:
        return {"read": read_states, "command": command}[options.role](options.numbers)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    domain = random.SystemRandom().randint(1, 100)
    program = os.environ["AMBF_SIMULATOR"]
    with tempfile.TemporaryDirectory(prefix="ambf-ros2-bench-") as folder:
        model = pathlib.Path(folder) / "boxes.yaml"
        write_model(model)
        rates = ["--override_min_comm_freq", str(SLOW_HZ), "--override_max_comm_freq", str(FAST_HZ)]
        files = ["-a", model, "--launch_file", ROOT / "resources/launch.yaml"]
        with (pathlib.Path(folder) / "log").open("w") as log:
            simulator = subprocess.Popen(
                [program, "-g", "0", "--ros", "2", *rates, *files],
                env=dict(os.environ, ROS_DOMAIN_ID=str(domain)),
                stdout=log,
                stderr=log,
            )
        try:
            table = measure(simulator, domain, 1 if options.quick else options.minutes, 30.0 if options.quick else 60.0)
        finally:
            simulator.send_signal(signal.SIGINT)
            try:
                status = simulator.wait(PATIENCE_S)
            finally:
                simulator.kill()
            said = (pathlib.Path(folder) / "log").read_text()
    renewed = said.count("was published anew")
    table += f"\nTimes a topic was published anew: {renewed}. Exit status: {status}.\n"
    print(table.splitlines()[-1])
    if "panicked" in said:
        print(said)
    if not options.quick:
        file = options.folder / "ros2.md"
        before, rest = file.read_text().split(MARKS[0])
        file.write_text(before + MARKS[0] + table + MARKS[1] + rest.split(MARKS[1])[1])
    return 0 if status == 0 and "panicked" not in said else 1


if __name__ == "__main__":
    sys.exit(main())
