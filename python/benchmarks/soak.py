"""Whether a teleoperation stays as it is for hours: soak.py FOLDER [--minutes M] [--seed S] [--only EVENT]. `scripts/soak`
starts it.

Two arms of a da Vinci Research Kit (fakes, each a real ROS node's) move the grippers of the scene `teleop`; an instrument arm beside
them is driven over CRTK topics at 100 Hz. One client reads all the time and says how old states are. Meanwhile things happen, one each
few seconds, in an order that the seed gives: clients come and end, are killed, or are stopped for ten seconds; a model is added and
removed; the world is reset; the arms' node is killed and comes back; the ROS master is killed and comes back. A line a period says what
the client got and what the system says about the simulator. Ends with status 1 if the simulator ended or panicked, if a model or a reset
was not done, or if its own memory, threads or open files have grown in the second half by more than what is said below. Writes what is
between the markers of FOLDER/soak.md and a figure, if it lasted an hour or more. With --only, that event alone happens, ten times as
often, and nothing is written: this shows which of them leaves something behind.
"""

import argparse
import json
import math
import os
import pathlib
import random
import select
import signal
import statistics
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/ros"))

import harness  # noqa: E402
from watched import Client, Watched, percentile  # noqa: E402

MARKS = ("<!-- measured: begin -->\n", "<!-- measured: end -->\n")
SCENE = "/ambf/env/teleop"
READ = ("simulated_device/palm", "simulated_device/palm1", "rightring", "leftring")
SHORTEST_WRITTEN_MIN = 60
# The second half may hold so much more than the first, at the median: MB of its own, threads, open files.
GROWTH = {"memory": 1.0, "threads": 1, "files": 2}
# In a run of minutes memory is still being taken for the first time, and quiet moments are few.
SHORT_MIN = 10.0
SHORT_GROWTH = {"memory": 20.0, "threads": 4, "files": 30}
# Seconds from one event to the next.
BETWEEN_S = (3.0, 8.0)
BETWEEN_ONLY_S = (0.3, 0.8)
EVENTS = ("visitor", "visitor", "visitor", "killed visitor", "hung visitor", "model", "reset", "arms", "master")
# So long may a client take to end, s.
END_S = 10.0
# Ages above this are counted, ms.
LATE_MS = 20.0


def be_node(name):
    """Makes this process a node of the master that the environment names."""
    import rospy

    rospy.init_node(name, anonymous=True, disable_signals=True, log_level=rospy.FATAL)
    return rospy


def read():
    """The client that stays: it reads, and moves the instrument. To each line of its input it answers what it got since the last one."""
    rospy = be_node("reader")
    from ambf_msgs.msg import RigidBodyState, Timing
    from sensor_msgs.msg import JointState

    ages, joints, timing = [], [], []

    def age_of(message):
        return 1e3 * (time.time() - message.header.stamp.to_sec())

    def follow(topic, kind, receive):
        rospy.Subscriber(topic, kind, receive, queue_size=1000, tcp_nodelay=True)

    for name in READ:
        follow(f"{SCENE}/{name}/State", RigidBodyState, lambda state: ages.append(age_of(state)))
    follow("/PSM1/measured_js", JointState, lambda state: joints.append(age_of(state)))
    follow("/ambf/env/World/Timing", Timing, timing.append)
    servo = rospy.Publisher("/PSM1/servo_jp", JointState, queue_size=1)
    begin = time.monotonic()
    lost = 0.0
    while True:
        phase = time.monotonic() - begin
        servo.publish(JointState(position=[0.2 * math.sin(phase), 0.0, 0.12, 0.0, 0.0, 0.0]))
        if not select.select([sys.stdin], [], [], 0.01)[0]:
            continue
        if not sys.stdin.readline():
            os._exit(0)
        got, ages[:] = list(ages), []
        arm, joints[:] = list(joints), []
        told, timing[:] = list(timing), []
        before, lost = lost, told[-1].lost_time if told else lost
        said = {
            "states": len(got),
            "age": [percentile(got, 0.5), percentile(got, 0.99), max(got, default=float("nan"))],
            "late": sum(age > LATE_MS for age in got),
            "joints": len(arm),
            "joints age": [percentile(arm, 0.5), percentile(arm, 0.99), max(arm, default=float("nan"))],
            "physics": statistics.median(t.physics_frequency for t in told) if told else float("nan"),
            "cost": percentile([t.step_p99 for t in told], 0.5),
            "lost": lost - before,
        }
        print(json.dumps(said), flush=True)


def visit():
    """A client that reads what there is until it is ended."""
    rospy = be_node("visitor")
    from ambf_msgs.msg import RigidBodyState

    for name, kind in rospy.get_published_topics():
        if kind == "ambf_msgs/RigidBodyState":
            rospy.Subscriber(name, RigidBodyState, lambda state: None)
    sys.stdin.read()
    rospy.signal_shutdown("done")


def change_models():
    """Adds a model, and removes it."""
    rospy = be_node("modeller")
    from ambf_msgs.srv import AddModel, RemoveModel

    for service in ("add_model", "remove_model"):
        rospy.wait_for_service(f"/ambf/env/World/{service}", timeout=harness.PATIENCE_S)
    added = rospy.ServiceProxy("/ambf/env/World/add_model", AddModel)(str(ROOT / "resources/models/pendulum.yaml"))
    assert added.success, added.message
    time.sleep(2.0)
    removed = rospy.ServiceProxy("/ambf/env/World/remove_model", RemoveModel)(added.model)
    assert removed.success, removed.message


def reset():
    """Resets the world."""
    rospy = be_node("resetter")
    from std_msgs.msg import Empty

    publisher = rospy.Publisher("/ambf/env/World/Command/Reset", Empty, queue_size=1)
    harness.wait_for(publisher.get_num_connections, "the simulator listens to resets")
    publisher.publish(Empty())
    time.sleep(0.5)


ROLES = {"read": read, "visit": visit, "model": change_models, "reset": reset}


def start(port, role):
    """This program as one of its clients."""
    return Client([__file__, "--role", role, "-"], harness.environment(port))


class Stage:
    """Master, simulator, arms, and what happens to them."""

    def __init__(self, seed, only):
        self.random = random.Random(seed)
        self.events = (only,) if only else EVENTS
        self.between = BETWEEN_ONLY_S if only else BETWEEN_S
        self.master = harness.Master()
        self.port = self.master.port
        resources = ROOT / "resources"
        models = f"{resources}/models/teleop.yaml,{resources}/models/psm.yaml"
        self.simulator = harness.Simulator(
            self.port,
            *("--launch_file", resources / "launch.yaml", "-a", models, "-i", "0,1", "-e", "1"),
            *("--crtk", resources / "crtk/psm.yaml"),
        )
        self.simulator.wait_for_topics(f"{SCENE}/rightring/State", "/PSM1/measured_js")
        self.arms = self.start_arms()
        self.visitors = []
        self.counts = dict.fromkeys(EVENTS, 0)
        self.failed = dict.fromkeys(("model", "reset"), 0)

    def start_arms(self):
        """Two arms whose hands take the rings, carry them, and come back."""
        program = harness.simulator_path().parent / "fake_dvrk"
        script = ROOT / "resources/teleop/hands.txt"
        command = [program, "MTMR", "MTML", "--rate", "500", "--quiet", "--script", script]
        return harness.Program(command, harness.environment(self.port))

    def happen(self):
        """The next event."""
        what = self.random.choice(self.events)
        self.counts[what] += 1
        if what.endswith("visitor"):
            self.visitors.append((start(self.port, "visit"), what, time.monotonic() + self.random.uniform(3.0, 10.0)))
        elif what == "arms":
            self.arms.kill()
            self.arms = self.start_arms()
        elif what == "master":
            self.master.kill()
            self.master = harness.Master(self.port)
            # Nobody knows of the simulator before it is registered again.
            self.simulator.wait_for_topics(f"{SCENE}/rightring/State")
        elif not start(self.port, what).end(harness.PATIENCE_S):
            self.failed[what] += 1

    def tend(self):
        """Does what is due to visitors."""
        now = time.monotonic()
        for visitor in [visitor for visitor in self.visitors if visitor[2] <= now]:
            self.visitors.remove(visitor)
            client, what, _ = visitor
            if what == "hung visitor":
                client.process.send_signal(signal.SIGSTOP)
                self.visitors.append((client, "woken visitor", now + 10.0))
            else:
                if what == "woken visitor":
                    client.process.send_signal(signal.SIGCONT)
                if what == "killed visitor":
                    client.process.kill()
                client.end(END_S)

    def leave(self):
        """All visitors go."""
        for client, what, _ in self.visitors:
            if what == "woken visitor":
                client.process.send_signal(signal.SIGCONT)
            client.end(END_S)
        self.visitors.clear()

    def stop(self):
        """Everything ends; the simulator's exit status."""
        self.leave()
        self.arms.stop()
        status = self.simulator.interrupt() if self.simulator.running() else self.simulator.process.poll()
        self.master.stop()
        return status


HEAD = """| min | own memory, MB | all, MB | threads | files | processor, % | physics, Hz | step p99, ms | lost, ms \
| states/s | age p50, ms | p99, ms | most, ms | above 20 ms | CRTK/s | age p50, ms | p99, ms |
|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|
"""


def line(minute, watched, samples, got, seconds):
    """A row of the table."""
    own, threads, files, memory = (statistics.median(column) for column in zip(*samples))
    state, arm = got["age"], got["joints age"]
    return (
        f"| {minute:.0f} | {own:.2f} | {memory:.1f} | {threads:.0f} | {files:.0f} | {watched.processor():.0f} | {got['physics']:.0f} "
        f"| {1e3 * got['cost']:.2f} | {1e3 * got['lost']:.0f} | {got['states'] / seconds:.0f} | {state[0]:.2f} | {state[1]:.2f} "
        f"| {state[2]:.1f} | {got['late']} | {got['joints'] / seconds:.1f} | {arm[0]:.2f} | {arm[1]:.2f} |"
    )


def measure(stage, minutes):
    """(Table, samples of time in min, own memory, threads, files and all memory)."""
    reader = start(stage.port, "read")
    watched = Watched(stage.simulator.process.pid)
    table, series = HEAD, []
    print(HEAD, end="")
    time.sleep(10.0)
    reader.ask()
    begin = time.monotonic()
    period = min(max(60.0, 60.0 * minutes / 15.0), 30.0 * minutes)
    next_event = next_sample = begin
    last, samples = begin, []
    while stage.simulator.running():
        now = time.monotonic()
        stage.tend()
        if now >= next_event:
            stage.happen()
            next_event = time.monotonic() + stage.random.uniform(*stage.between)
        if now >= next_sample:
            samples.append((watched.own_memory(), watched.threads(), watched.files(), watched.memory()))
            series.append(((now - begin) / 60.0, *samples[-1]))
            next_sample = now + 2.0
        if now >= last + period:
            row = line((now - begin) / 60.0, watched, samples, reader.ask(), now - last)
            table += row + "\n"
            print(row, flush=True)
            last, samples = now, []
            if now >= begin + 60.0 * minutes:
                break
        time.sleep(0.05)
    stage.leave()
    reader.end(END_S)
    return table, series


def growth(series):
    """Of each figure: that of the second half less that of the first, without the first tenth."""
    warm = series[len(series) // 10 :]
    halves = warm[: len(warm) // 2], warm[len(warm) // 2 :]
    # Files: at quiet moments, since each visitor has some open.
    columns = ((1, statistics.median), (2, statistics.median), (3, min))
    figures = [[of(row[column] for row in half) for half in halves] for column, of in columns]
    return {name: after - before for name, (before, after) in zip(GROWTH, figures)}


def figure(series):
    """The description of the figure for scripts/plot."""
    step = max(len(series) // 400, 1)
    lines = [
        {"name": name, "points": [[row[0], row[column]] for row in series[::step]]}
        for column, name in enumerate(("own memory, MB", "threads", "open files"), 1)
    ]
    most = 1.1 * max(max(row[1:4]) for row in series)
    return {
        "kind": "linear lines",
        "title": "A teleoperation with clients, masters and models that come and go",
        "x": "time, min",
        "y": "of the simulator",
        "y max": most,
        "lines": lines,
    }


def main():
    """Measures, or is one of the clients."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--minutes", type=float, default=120.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=dict.fromkeys(EVENTS))
    parser.add_argument("--role", choices=ROLES)
    options = parser.parse_args()
    if options.role:
        return ROLES[options.role]()
    harness.set_up()
    try:
        stage = Stage(options.seed, options.only)
        try:
            table, series = measure(stage, options.minutes)
        finally:
            status = stage.stop()
            said = stage.simulator.log()
        grown = growth(series)
    finally:
        harness.tear_down()
    events = ", ".join(f"{count} × {what}" for what, count in stage.counts.items())
    table += (
        f"\nSeed {options.seed}. Events: {events}; not done: {sum(stage.failed.values())}. Exit status: {status}.\n"
    )
    table += "Second half less first: " + ", ".join(f"{name} {value:+.2f}" for name, value in grown.items()) + ".\n"
    print("\n".join(table.splitlines()[-2:]))
    allowed = GROWTH if options.minutes >= SHORT_MIN else SHORT_GROWTH
    stayed = all(grown[name] <= most for name, most in allowed.items())
    is_good = status == 0 and "panicked" not in said and not any(stage.failed.values()) and stayed
    if not is_good:
        print(said[-20000:])
    if options.minutes >= SHORTEST_WRITTEN_MIN and not options.only:
        table += "\n![own memory, threads, open files](soak.svg)\n"
        file = options.folder / "soak.md"
        before, rest = file.read_text().split(MARKS[0])
        file.write_text(before + MARKS[0] + table + MARKS[1] + rest.split(MARKS[1])[1])
        plot = json.dumps({"soak.svg": figure(series)})
        subprocess.run([ROOT / "scripts/plot", options.folder], input=plot, text=True, check=True)
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
