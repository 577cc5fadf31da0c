"""In the style of client 3.0: the tip of an arm goes round a circle by inverse kinematics, and a frame without mass by pose commands."""

import math
import sys

import numpy as np
from ambf_client.ambf_client import Client
from geometry_msgs.msg import Pose
from instrument_arm import InstrumentArm, distance, expect
from ros_abstraction_layer import ral

RADIUS, CENTRE = 0.1, np.array([-0.5, 0.0, 0.6])

layer = ral("circle")
layer.spin()
client = Client("circle", 10)
client.connect()
arm = InstrumentArm(client, "psm1")
frame = client.get_obj_handle("CameraFrame")
tool = client.get_obj_handle("psm1/toolyawlink")
rate = client.create_rate(120)


def point(angle):
    """Pose (4 x 4) on the circle, with the tool upright."""
    pose = np.eye(4)
    pose[:3, 3] = CENTRE + RADIUS * np.array([math.cos(angle), math.sin(angle), 0.0])
    return pose


arm.move_cp(point(0.0))
angle, worst, worst_height = 0.0, 0.0, 0.0
begin = client.get_time()
while angle < 2.0 * math.pi and client.get_time() < begin + 120.0:
    arm.servo_cp(point(angle))
    rate.sleep()
    now = arm.measured_cp()
    # The tip may lag, as controllers do, but not lose the path: it is waited for.
    if distance(now, point(angle)) < 0.03:
        angle += 2.0 * math.pi / 180.0
    offset = now[:3, 3] - CENTRE
    worst = max(worst, abs(math.hypot(offset[0], offset[1]) - RADIUS))
    worst_height = max(worst_height, abs(offset[2]))
print(
    f"once round in {client.get_time() - begin:.1f} s, off the radius by {worst:.4f} m, off the plane by {worst_height:.4f} m"
)
if angle < 2.0 * math.pi or worst > 0.01 or worst_height > 0.01:
    sys.exit(1)

# What the kinematics say is where the body is.
expect("the arm rests", lambda: distance(arm.measured_cp(), point(angle)) < 0.004, arm.hold)
position = tool.get_pos()
off = np.linalg.norm(arm.measured_cp()[:3, 3] - [position.x, position.y, position.z])
print(f"the tool's body is {off:.4f} m from where the joints say")
if off > 0.01:
    sys.exit(1)

home = frame.get_pose()
for i in range(4):
    pose = Pose()
    pose.position.x, pose.position.y, pose.position.z = 0.2 * math.cos(1.5 * i), 0.2 * math.sin(1.5 * i) - 0.9, 1.6
    pose.orientation.w = 1.0
    frame.set_pose(pose)
    there = frame.get_pos_command()
    expect(
        f"frame at point {i}",
        lambda goal=there: math.dist((goal.x, goal.y, goal.z), frame.get_pose()[:3]) < 1e-4,
        lambda goal=pose: frame.set_pose(goal),
    )


def go_home():
    frame.set_pos(*home[:3])
    frame.set_rpy(*home[3:])


expect("frame is back", lambda: max(abs(a - b) for a, b in zip(home, frame.get_pose())) < 1e-3, go_home)
client.clean_up()
layer.shutdown()
print("done", flush=True)
