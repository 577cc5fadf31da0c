"""Pairs of pictures a second of the peg transfer's stereo camera, and how old they are: stereo.py [--seconds S] [--only WAY]…

Ways: `process`, pictures drawn beside a thread that steps the physics at 1 kHz in real time; `ros1` and `ros2`, `ambf_simulator` without
a window, its pictures at two subscribers that only read. Two pictures of 640 x 480, colour, shadow quality 5. A pair is what has one
stamp. Prints a table. It needs the package `ambf`, ROS 1's Python and, for `ros2`, rclpy: each way that lacks something says so.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any, Callable, Dict, List, Tuple

ROOT = Path(__file__).resolve().parents[2]
LAUNCH = ROOT / "resources/peg_transfer/launch.yaml"
MODELS = (0, 1, 2, 3, 4, 5)
SIDES = ("left", "right")

Row = Tuple[float, List[float], float]
"""Pairs a second, ages at arrival, s, and simulated seconds in one of the clock."""


def in_process(seconds: float) -> Row:
    """Steps and draws in turns, as a program does that waits for each pair; physics keeps up with the clock as far as it can."""
    import ambf

    sim = ambf.Simulation(launch_file=LAUNCH, indexes=MODELS, profile="accurate", step=0.001)
    for side in SIDES:
        sim.render(f"stereo/{side}", 640, 480)
    ages: List[float] = []
    begin, start = time.monotonic(), sim.sim_time
    while time.monotonic() - begin < seconds:
        # What the clock is ahead, 0.1 s at most.
        behind = (time.monotonic() - begin) - (sim.sim_time - start)
        sim.step(max(1, min(100, round(1e3 * behind))))
        stamp = time.monotonic()
        for side in SIDES:
            sim.render(f"stereo/{side}", 640, 480)
        ages.append(time.monotonic() - stamp)
    spent = time.monotonic() - begin
    return len(ages) / spent, ages, (sim.sim_time - start) / spent


class Pairs:
    """Counts pictures that have one stamp."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: Dict[float, str] = {}
        self.ages: List[float] = []
        self.times: List[float] = []

    def hear(self, side: str) -> Callable[[Any], None]:
        """What a subscriber of that side calls."""

        def take(message: Any) -> None:
            now = time.time()
            at = message.header.stamp
            stamp = at.sec + 1e-9 * at.nanosec if hasattr(at, "sec") else at.to_sec()
            with self._lock:
                if self._waiting.pop(stamp, side) != side:
                    self.ages.append(now - stamp)
                    self.times.append(now)
                else:
                    self._waiting[stamp] = side
                while len(self._waiting) > 16:
                    del self._waiting[min(self._waiting)]

        return take

    def row(self, real_time: float) -> Row:
        """What was heard."""
        if len(self.times) < 2:
            raise RuntimeError("no pairs arrived")
        return (len(self.times) - 1) / (self.times[-1] - self.times[0]), self.ages, real_time


def over_ros(version: int, seconds: float) -> Row:
    """`ambf_simulator`, and a client of that version of ROS in this process."""
    os.environ["ROS_VERSION"] = str(version)
    sys.path.insert(0, str(ROOT / "tests/ros"))
    import harness

    harness.set_up()
    master = harness.Master()
    words = ("--launch_file", LAUNCH, "-l", ",".join(map(str, MODELS)), "-p", "1000", "--profile", "accurate")
    try:
        more = ("--ros", "2") if version == 2 else ()
        with harness.Simulator(master.port, *words, *more) as simulator:
            from ambf_msgs.msg import WorldState
            from ros_abstraction_layer import ral
            from sensor_msgs.msg import Image

            os.environ["ROS_MASTER_URI"] = f"http://localhost:{master.port}"
            layer, pairs = ral("stereo_benchmark"), Pairs()
            clocks: List[Tuple[float, float]] = []
            layer.subscriber(
                "/ambf/env/World/State", WorldState, lambda state: clocks.append((time.monotonic(), state.sim_time))
            )
            kept = [layer.subscriber(f"/ambf/env/stereo/{side}/ImageData", Image, pairs.hear(side)) for side in SIDES]
            layer.spin()
            end = time.monotonic() + 30.0
            while len(pairs.times) < 5 and time.monotonic() < end and simulator.process.poll() is None:
                time.sleep(0.1)
            for kept_so_far in (pairs.ages, pairs.times, clocks):
                kept_so_far.clear()
            time.sleep(seconds)
            ratio = (clocks[-1][1] - clocks[0][1]) / (clocks[-1][0] - clocks[0][0]) if len(clocks) > 1 else float("nan")
            row = pairs.row(ratio)
            del kept
            layer.shutdown()
            return row
    finally:
        master.stop()
        harness.tear_down()


WAYS: Dict[str, Callable[[float], Row]] = {
    "process": in_process,
    "ros1": lambda seconds: over_ros(1, seconds),
    "ros2": lambda seconds: over_ros(2, seconds),
}


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--only", action="append", default=[], choices=list(WAYS))
    parser.add_argument("--child", choices=list(WAYS), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        rate, ages, real_time = WAYS[options.child](options.seconds)
        ages = sorted(1e3 * age for age in ages)
        cells = (f"{rate:.1f}", f"{statistics.median(ages):.1f}", f"{ages[int(0.95 * len(ages))]:.1f}")
        print("| " + " | ".join((options.child, *cells, f"{real_time:.2f}")) + " |", flush=True)
        return
    load = " ".join(f"{x:.2f}" for x in os.getloadavg())
    print(f"{os.cpu_count()} cores; load average before: {load}.\n")
    print("| way | pairs/s | age p50, ms | p95, ms | real time |\n|---|--:|--:|--:|--:|", flush=True)
    for way in options.only or WAYS:
        # Clients of both versions of ROS can't be in one process.
        done = subprocess.run(
            [sys.executable, __file__, "--child", way, "--seconds", str(options.seconds)],
            capture_output=True,
            text=True,
            check=False,
        )
        last = done.stderr.strip().splitlines()[-1:] or ["ended without a result"]
        print(done.stdout.strip() if done.returncode == 0 else f"| {way} | {last[0]} | | | |", flush=True)


if __name__ == "__main__":
    main()
