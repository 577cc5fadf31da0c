"""An instrument arm of the corpus behind the names of the collaborative robotics toolkit, as projects wrap the client for themselves.

The tool's tip is the origin of `toolyawlink`; pitch and yaw of the wrist meet there. Lengths in m, angles in rad."""

import math
import sys
import time

import numpy as np
from ambf_client.transformations import euler_from_matrix, euler_matrix, quaternion_matrix

JOINTS = [
    "baselink-yawlink",
    "yawlink-pitchlink",
    "pitchlink-maininsertionlink",
    "maininsertionlink-toolrolllink",
    "toolrolllink-toolpitchlink",
    "toolpitchlink-toolyawlink",
]
JAWS = ["toolyawlink-toolgripper1link", "toolyawlink-toolgripper2link"]
LOW = [-1.4, -0.9, 0.2, -2.8, -1.5, -1.5]
HIGH = [1.4, 0.9, 2.2, 2.8, 1.5, 1.5]
HOME = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]

PATIENCE_S = 60.0
"""A busy machine simulates slowly: waits end when their condition holds, and this bounds those of a run that fails."""


def expect(what, condition, again=lambda: None):
    """Waits until `condition` holds and does `again` meanwhile, at 120 Hz; ends the program with status 1 if it never does."""
    end = time.time() + PATIENCE_S
    while not condition() and time.time() < end:
        again()
        time.sleep(1.0 / 120.0)
    holds = condition()
    print(what, "ok" if holds else "FAILED", flush=True)
    if not holds:
        sys.exit(1)


def transform_of(pose):
    """The (4 x 4) matrix of a `geometry_msgs/Pose`."""
    matrix = quaternion_matrix([pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w])
    matrix[:3, 3] = [pose.position.x, pose.position.y, pose.position.z]
    return matrix


def inverse_kinematics(transform):
    """Joint positions at which the tip has this pose (4 x 4) in the frame of the base."""
    x, y, z = transform[:3, 3]
    depth = math.sqrt(x * x + y * y + z * z)
    yaw, pitch = math.atan2(-x, -z), math.asin(y / depth)
    shaft = euler_matrix(yaw, pitch, 0.0, "ryxz")
    roll, wrist_pitch, wrist_yaw = euler_from_matrix(shaft.T @ transform, "rzyx")
    return [yaw, pitch, depth, roll, wrist_pitch, wrist_yaw]


def forward_kinematics(joints):
    """Pose (4 x 4) of the tip in the frame of the base."""
    yaw, pitch, depth, roll, wrist_pitch, wrist_yaw = joints
    shaft = euler_matrix(yaw, pitch, 0.0, "ryxz")
    tip = shaft @ euler_matrix(roll, wrist_pitch, wrist_yaw, "rzyx")
    tip[:3, 3] = shaft[:3, :3] @ [0.0, 0.0, -depth]
    return tip


class InstrumentArm:
    """An arm by its name, `psm1` or `psm2`."""

    def __init__(self, client, name):
        self.base = client.get_obj_handle(f"{name}/baselink")
        self.actuator = client.get_obj_handle(f"{name}/Actuator0")
        self.ghosts = [client.get_obj_handle(f"{name}/{side}_finger_ghost") for side in ("left", "right")]
        self.set_points = {}
        time.sleep(0.2)
        self.base_transform = transform_of(self.base._state.pose)

    def measured_jp(self):
        """Positions of the six joints."""
        return [self.base.get_joint_pos(name) for name in JOINTS]

    def measured_cp(self):
        """Pose (4 x 4) of the tip in the world."""
        return self.base_transform @ forward_kinematics(self.measured_jp())

    def hold(self):
        """Sends all set points again: after a pause of this program that was longer than the watchdogs' time, the commands are gone and the
        arm sags."""
        for name, position in self.set_points.items():
            self.base.set_joint_pos(name, position)

    def servo_jp(self, positions):
        """Set points of the six joints."""
        self.set_points.update(zip(JOINTS, positions))
        self.hold()

    def servo_cp(self, transform):
        """Set point of the tip, a pose (4 x 4) in the world."""
        self.servo_jp(inverse_kinematics(np.linalg.inv(self.base_transform) @ transform))

    def set_jaw_angle(self, angle):
        """Opening of each of the two jaws."""
        self.set_points.update(dict.fromkeys(JAWS, angle))
        self.hold()

    def jaw_angles(self):
        """Openings of the two jaws."""
        return [self.base.get_joint_pos(name) for name in JAWS]

    def sensed(self):
        """Names of what the ghosts in the jaws sense."""
        return [name for ghost in self.ghosts for name in ghost.get_all_sensed_obj_names()]

    def move_cp(self, goal, step=0.005):
        """Goes to a pose (4 x 4) in the world on a straight line and waits for arrival; `step` m in each cycle, if the arm keeps up."""
        start, goal = self.measured_cp(), np.array(goal)
        count = max(int(np.linalg.norm(goal[:3, 3] - start[:3, 3]) / step), 1)
        for i in range(1, count + 1):
            goal_now = goal.copy()
            goal_now[:3, 3] += (start[:3, 3] - goal[:3, 3]) * (1.0 - i / count)
            self.servo_cp(goal_now)
            end = time.time() + PATIENCE_S
            time.sleep(1.0 / 120.0)
            while distance(self.measured_cp(), goal_now) > 0.04 and time.time() < end:
                self.hold()
                time.sleep(1.0 / 120.0)
        expect("  at " + str(np.round(goal[:3, 3], 3)), lambda: distance(self.measured_cp(), goal) < 0.005, self.hold)


def distance(one, other):
    """Between the origins of two (4 x 4) poses."""
    return float(np.linalg.norm(one[:3, 3] - other[:3, 3]))
