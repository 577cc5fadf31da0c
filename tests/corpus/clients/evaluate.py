"""In the style of a challenge's evaluator: records while the needle is driven past a pair of markers, then scores from the bag alone.

evaluate.py FOLDER"""

import math
import pathlib
import sys
import time

import numpy as np
import rosbag
from ambf_client import Client
from instrument_arm import expect, transform_of
from recorder import Recorder

TIP = np.array([-0.2, 0.0, 0.0, 1.0])  # in the needle's frame, m
PREFIX = "/ambf/env/phantom/"
bag_path = pathlib.Path(sys.argv[1]) / "evaluate.bag"

c = Client("evaluate")
c.connect()
time.sleep(0.3)
needle, entry, exit_ = (c.get_obj_handle(name) for name in ("Needle", "Entry1", "Exit1"))
c.get_world_handle().reset()
time.sleep(0.3)
topics = [
    "/ambf/env/Needle/State",
    *(f"{PREFIX}{name}/State" for name in ("Entry1", "Exit1", "ghostEntry1", "ghostExit1")),
]
recorder = Recorder(bag_path, 20_000, *topics)


def drive_tip_to(x, y, z):
    """Drives the needle, without turning it, until its tip is there: by pose commands whose goal moves on when the needle keeps up."""
    goal = np.array([x, y, z]) - TIP[:3]
    begin = needle.get_pos()
    start = np.array([begin.x, begin.y, begin.z])
    count = max(int(np.linalg.norm(goal - start) / 0.01), 1)

    def lag(target):
        now = needle.get_pos()
        return math.dist((now.x, now.y, now.z), target)

    needle.set_rpy(0, 0, 0)
    for i in range(1, count + 1):
        now = start + (goal - start) * i / count
        needle.set_pos(*now)
        time.sleep(0.01)
        end = time.time() + 60.0
        while lag(now) > 0.08 and time.time() < end:
            needle.set_pos(*now)
            time.sleep(0.01)
    expect(f"tip at {x:.2f} {y:.2f} {z:.2f}", lambda: lag(goal) < 0.02, lambda: needle.set_pos(*goal))


at_entry, at_exit = entry.get_pos(), exit_.get_pos()
drive_tip_to(at_entry.x, at_entry.y - 0.3, 0.4)
drive_tip_to(at_entry.x, at_entry.y, at_entry.z + 0.035)
drive_tip_to(at_exit.x, at_exit.y, at_exit.z + 0.035)
drive_tip_to(at_exit.x, at_exit.y, 0.5)
recorder.stop()
c.get_world_handle().reset()
c.clean_up()

# --- what an evaluator does with the bag
closest, sensed_at, places, count = {}, {}, {}, 0
with rosbag.Bag(str(bag_path)) as bag:
    for topic, message, _ in bag.read_messages():
        count += 1
        name = topic.split("/")[-2]
        if name in ("Entry1", "Exit1"):
            places[name] = transform_of(message.pose)
        elif name == "Needle":
            tip = transform_of(message.pose) @ TIP
            for marker, place in places.items():
                near = float(np.linalg.norm((np.linalg.inv(place) @ tip)[:3]))
                if near < closest.get(marker, (math.inf, 0))[0]:
                    closest[marker] = (near, message.sim_time)
        elif any("Needle" in sensed.data for sensed in message.sensed_objects):
            sensed_at.setdefault(name, message.sim_time)
print(count, "messages;", "closest", closest, "sensed", sensed_at)
if set(sensed_at) != {"ghostEntry1", "ghostExit1"} or set(closest) != {"Entry1", "Exit1"}:
    sys.exit(1)
in_order = closest["Entry1"][1] < closest["Exit1"][1]
score = sum(max(0.0, 1.0 - near / 0.1) for near, _ in closest.values()) / 2.0
print(f"score {score:.2f}, in order: {in_order}, time {closest['Exit1'][1] - closest['Entry1'][1]:.2f} s")
if not in_order or score < 0.4:
    sys.exit(1)
print("done", flush=True)
