"""What stepping and listening over ROS cost: ros_stepping.py FOLDER [--seconds S].

Measures, in simulators of its own:
* round trips a second of throttled stepping, by topics (clock edge, state) and by the service `World/step`, for a small scene;
* the age of received states and the time between their stamps under step throttling by topics (Figure 12 of the AMBF paper);
* the rates of several of 200 bodies whose states are published at 2 kHz (Figure 11).

Writes FOLDER/ros_stepping.json, and the figures ages.svg, stamps.svg and rates.svg where matplotlib is installed.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from pathlib import Path
from typing import Any

import numpy as np
import rospy
from ambf_client import Client
from ambf_gym import Scene
from ambf_gym.process import SimulatorProcess
from ambf_msgs.msg import RigidBodyState


def percentiles(values: Any) -> dict[str, float]:
    """Median, tails and mean."""
    names = ("p1", "p50", "p90", "p99", "max")
    found = dict(zip(names, np.percentile(values, (1, 50, 90, 99, 100)).tolist()))
    return {**found, "mean": float(np.mean(values)), "n": len(values)}


class Simulator:
    """A simulator and a client of it, for a `with` block."""

    def __init__(self, model: str, body: str, *options: str) -> None:
        self.process = SimulatorProcess(Scene((model,), options=options))
        self.client = Client("benchmark", namespace=self.process.namespace, only=(body,), anonymous=True)

    def __enter__(self) -> Client:
        self.client.connect(200, timeout=60)
        self.client.get_world_handle().step(0, patience=0.01)
        return self.client

    def __exit__(self, *_: object) -> None:
        self.client.clean_up()
        self.process.close()


def by_service(client: Client, body: str, seconds: float, steps: int) -> dict[str, float]:
    """Round trips a second with commands and states in one request."""
    world, handle = client.get_world_handle(), client.wait_for_object(body)
    handle.stop_listening()
    took = []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        begin = time.perf_counter()
        world.step(steps, [handle], [handle], patience=5.0)
        took.append(time.perf_counter() - begin)
    return {"round_trips_hz": len(took) / sum(took), "us": percentiles(np.multiply(took, 1e6))}


def by_topics(client: Client, body: str, seconds: float) -> tuple[dict[str, Any], Any, Any]:
    """Round trips a second with clock edges; ages of states at their arrival, and time between their stamps, ms."""
    world, handle = client.get_world_handle(), client.wait_for_object(body)
    seen: dict[int, tuple[float, float]] = {}

    def receive(state: Any) -> None:
        seen.setdefault(state.sim_step, (time.time(), state.header.stamp.to_sec()))

    listener = rospy.Subscriber(f"{handle.get_name()}/State", RigidBodyState, receive, queue_size=100, tcp_nodelay=True)
    world.enable_throttling(True)
    world.set_num_step_skips(1)
    # Active: the watchdog is fed by the client's thread, however busy the computer is.
    world.set_active()
    world.update()
    step = -1
    while step != handle.get_sim_step():
        step = handle.get_sim_step()
        time.sleep(0.5)
    # A throttled iteration is computed before its clock edge and published after it. The next one has waited since the last edge.
    seen.clear()
    first, took = step, []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        begin = time.perf_counter()
        world.update()
        step += 1
        reached = handle.wait_for_step(step)
        took.append(time.perf_counter() - begin)
        assert reached == step, f"step {reached} instead of {step}"
    listener.unregister()
    world.enable_throttling(False)
    world.update()
    arrivals = np.array([value for number, value in sorted(seen.items()) if number > first + 1])
    ages = 1e3 * (arrivals[:, 0] - arrivals[:, 1])
    stamps = 1e3 * np.diff(arrivals[:, 1])
    summary = {
        "round_trips_hz": len(took) / sum(took),
        "us": percentiles(np.multiply(took, 1e6)),
        "age_ms": percentiles(ages),
        "between_stamps_ms": percentiles(stamps),
    }
    return summary, ages, stamps


def rates(seconds: float, count: int) -> dict[str, Any]:
    """Arrivals a second of some of 200 bodies, of which each is published at 2 kHz."""
    options = ("-p", "2000", "--override_min_comm_freq", "2000", "--override_max_comm_freq", "2000")
    process = SimulatorProcess(Scene(("models/boxes200.yaml",), options=options))
    client = Client("benchmark", namespace=process.namespace, only=(), anonymous=True)
    try:
        client.connect(1000, timeout=60)
        world = client.get_world_handle()
        world.step(0, patience=0.01)
        topics: list[str] = []
        while len(topics) < 200:
            published = rospy.get_published_topics(process.namespace)
            topics = [name for name, kind in published if kind == "ambf_msgs/RigidBodyState"]
            time.sleep(0.1)
        chosen = sorted(topics)[:: max(len(topics) // count, 1)][:count]
        arrivals: dict[str, list[float]] = {topic: [] for topic in chosen}
        # Counting needs no fields: decoding five times 2 kHz is more than one interpreter does.
        listeners = [
            rospy.Subscriber(
                topic,
                rospy.AnyMsg,
                lambda _, topic=topic: arrivals[topic].append(time.perf_counter()),
                tcp_nodelay=True,
            )
            for topic in chosen
        ]
        time.sleep(2.0)
        for times in arrivals.values():
            times.clear()
        time.sleep(seconds)
        found = {topic: np.array(times) for topic, times in arrivals.items()}
        for listener in listeners:
            listener.unregister()
        physics = world.get_dynamic_loop_freq()
    finally:
        client.clean_up()
        process.close()
    return {
        "bodies": len(topics),
        "physics_hz": physics,
        "topics": {
            topic.rsplit("/", 2)[-2]: {
                "hz": (len(times) - 1) / (times[-1] - times[0]),
                "period_ms": percentiles(1e3 * np.diff(times)),
            }
            for topic, times in found.items()
        },
    }


def draw(folder: Path, ages: Any, stamps: Any, several: dict[str, Any]) -> None:
    """The figures."""
    try:
        import matplotlib
    except ImportError:
        print("matplotlib is not installed: no figures")
        return
    matplotlib.use("Agg")
    from matplotlib import pyplot

    for name, values, label in (
        ("ages", ages, "age of a state at its arrival, ms"),
        ("stamps", stamps, "time between stamps, ms"),
    ):
        _, axes = pyplot.subplots(figsize=(6.0, 3.0))
        top = float(np.percentile(values, 99.5))
        axes.hist(np.clip(values, None, top), bins=80, color="#33658a")
        axes.set_xlabel(label)
        axes.set_ylabel("states")
        pyplot.tight_layout()
        pyplot.savefig(folder / f"{name}.svg")
    _, axes = pyplot.subplots(figsize=(6.0, 3.0))
    topics = several["topics"]
    axes.bar(list(topics), [topic["hz"] for topic in topics.values()], color="#33658a")
    axes.axhline(2000, color="#666", linestyle="--")
    axes.set_ylabel("states a second")
    pyplot.tight_layout()
    pyplot.savefig(folder / "rates.svg")


def measure(folder: Path, seconds: float) -> dict[str, Any]:
    """Measures, records and draws."""
    folder.mkdir(parents=True, exist_ok=True)
    found: dict[str, Any] = {
        "python": platform.python_version(),
        "cores": os.cpu_count(),
        "load_before": os.getloadavg()[0],
    }
    with Simulator("models/pendulum.yaml", "Link", "-p", "4000") as client:
        for steps in (1, 10):
            found[f"service_{steps}"] = by_service(client, "Link", seconds, steps)
    with Simulator("models/pendulum.yaml", "Link", "-p", "4000") as client:
        found["topics_1"], ages, stamps = by_topics(client, "Link", seconds)
    several = found["rates"] = rates(seconds, 5)
    (folder / "ros_stepping.json").write_text(json.dumps(found, indent=1) + "\n")
    draw(folder, ages, stamps, several)
    for name in ("service_1", "service_10", "topics_1"):
        print(f"{name}: {found[name]['round_trips_hz']:.0f} round trips/s, p50 {found[name]['us']['p50']:.0f} µs")
    print("age of states: " + ", ".join(f"{k} {v:.3f}" for k, v in found["topics_1"]["age_ms"].items()) + " ms")
    for topic, value in several["topics"].items():
        print(f"{topic}: {value['hz']:.0f} Hz")
    return found


def main() -> None:
    """Measures and records."""
    parser = argparse.ArgumentParser(description="What stepping and listening over ROS cost.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seconds", type=float, default=5.0)
    chosen = parser.parse_args()
    measure(chosen.folder, chosen.seconds)


if __name__ == "__main__":
    main()
