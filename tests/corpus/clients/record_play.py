"""Records the commands that drive an arm with `rosbag record`, returns everything to its start, plays them back, and compares the two runs.

    record_play.py FOLDER

Before each pose the program waits until the arm rests at the one before, so the recording has pauses, in which the arm rests at the same
places whatever the pace of the simulation is. In between, commands reach the simulator a few iterations earlier or later: paths are
compared, not times."""

import pathlib
import subprocess
import sys
import time

import numpy as np
import rosbag
from ambf_client import Client
from instrument_arm import HOME, JOINTS, expect
from recorder import Recorder

POSES = [[0.5, 0.3, 1.2, 0.8, 0.4, -0.3], [-0.4, -0.3, 0.8, -0.8, -0.5, 0.5], HOME]
TOPIC = "/ambf/env/psm1/baselink"
BEGUN = 8_000  # bytes in a bag by which its recording has begun
REST, PATH = 0.02, 0.1  # rad or m: of where the arm rests, and of the way there
folder = pathlib.Path(sys.argv[1])


def joints_of(path):
    """(steps x 6) positions of the joints in a bag."""
    with rosbag.Bag(str(path)) as bag:
        return np.array(
            [
                [dict(zip(m.joint_names, m.joint_positions))[joint] for joint in JOINTS]
                for _, m, _ in bag.read_messages([f"{TOPIC}/State"])
                if len(m.joint_names) >= len(JOINTS)
            ]
        )


def off_path(points, path):
    """How far, at most, one of the points (n x 6) is from the nearest of the path (m x 6)."""
    return max(float(np.linalg.norm(path - point, axis=1).min()) for point in points)


# --- record
c = Client("record_play")
c.connect()
base = c.get_obj_handle("psm1/baselink")
time.sleep(0.5)


def at(pose):
    return lambda: max(abs(base.get_joint_pos(j) - q) for j, q in zip(JOINTS, pose)) < REST / 2


def drive(pose):
    for joint, position in zip(JOINTS, pose):
        base.set_joint_pos(joint, position)


c.get_world_handle().reset()
expect("at the start", at(HOME), lambda: drive(HOME))
recorder = Recorder(folder / "recorded.bag", BEGUN, f"{TOPIC}/Command", f"{TOPIC}/State")
for i, pose in enumerate(POSES):
    begin = base.get_all_joint_pos()[:6]
    for k in range(1, 41):
        drive([a + (b - a) * k / 40 for a, b in zip(begin, pose)])
        time.sleep(0.01)
    expect(f"pose {i}", at(pose), lambda pose=pose: drive(pose))
    time.sleep(0.3)
recorder.stop()
world = c.get_world_handle()
world.reset()
time.sleep(0.2)
c.clean_up()
recorded = joints_of(recorder.path)

# --- play
names = ["Command"]
with rosbag.Bag(str(recorder.path)) as bag:
    info = bag.get_type_and_topic_info().topics
    print(
        {topic: (entry.msg_type, entry.message_count) for topic, entry in info.items()},
        f"{bag.get_end_time() - bag.get_start_time():.1f} s",
    )
for attempt in range(3):
    # A machine that is busier than before may simulate less in the same time: then again.
    again = Recorder(folder / f"played{attempt}.bag", BEGUN, f"{TOPIC}/State")
    subprocess.run(
        ["rosbag", "play", "--quiet", "--delay=1", recorder.path, "--topics", f"{TOPIC}/Command"],
        check=True,
        stdin=subprocess.DEVNULL,
    )
    again.stop()
    played = joints_of(again.path)
    there, back = off_path(played[::5], recorded), off_path(recorded[::5], played)
    rests = max(float(np.abs(played - pose).max(axis=1).min()) for pose in POSES)
    print(
        f"{len(recorded)} and {len(played)} states; paths apart by {there:.4f} and {back:.4f}; rests off by {rests:.4f}",
        flush=True,
    )
    if max(there, back) < PATH and rests < REST:
        break
else:
    print("the played run does not follow the recorded one")
    sys.exit(1)
print("done", flush=True)
