#!/usr/bin/env python3
"""A proxy of one master as the teleoperation example of AMBF 2.0 has it: dialect A at 100 Hz, headers never filled, a presence flag, a gripper
in a wider range, its closed event under an old name. Lines on standard input set the pose and the gripper: x y z roll pitch yaw gripper.
Forces that come are printed."""

import sys
import threading

import numpy
import rospy
from geometry_msgs.msg import TransformStamped, TwistStamped, WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Empty, String


def rotation(roll, pitch, yaw):
    """Fixed axes: Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, cp, cy), (sr, sp, sy) = numpy.cos((roll, pitch, yaw)), numpy.sin((roll, pitch, yaw))
    x = numpy.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = numpy.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = numpy.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return z @ y @ x


def quaternion(r):
    """x, y, z, w by the largest of four."""
    w, x, y, z = candidates = numpy.array(
        [1 + r[0, 0] + r[1, 1] + r[2, 2], 1 + r[0, 0] - r[1, 1] - r[2, 2], 1 - r[0, 0] + r[1, 1] - r[2, 2], 1 - r[0, 0] - r[1, 1] + r[2, 2]]
    )
    i = int(numpy.argmax(candidates))
    s = 2 * numpy.sqrt(candidates[i])
    wx, wy, wz = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    xy, xz, yz = r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1]
    return [
        (wx / s, wy / s, wz / s, s / 4),
        (s / 4, xy / s, xz / s, wx / s),
        (xy / s, s / 4, yz / s, wy / s),
        (xz / s, yz / s, s / 4, wz / s),
    ][i]


class Proxy:
    def __init__(self, arm):
        self.position, self.rpy, self.gripper = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0
        self.tick = 0
        self.pose = rospy.Publisher(arm + "/measured_cp", TransformStamped, queue_size=1)
        self.twist = rospy.Publisher(arm + "/measured_cv", TwistStamped, queue_size=1)
        self.joints = rospy.Publisher(arm + "/gripper/measured_js", JointState, queue_size=1)
        self.status = rospy.Publisher(arm + "/status", Empty, queue_size=1)
        self.state = rospy.Publisher(arm + "/robot_state", String, queue_size=1)
        self.closed = rospy.Publisher(arm + "/gripper_closed_event", Bool, queue_size=1)
        rospy.Subscriber(arm + "/body/servo_cf", WrenchStamped, self.on_wrench, queue_size=1)

    def on_wrench(self, message):
        force = message.wrench.force
        print(force.x, force.y, force.z, flush=True)

    def publish(self):
        before, after = rotation(0, 0, 1.57079), rotation(0, -1.57079, 0)
        # The very first sample is far below.
        position = (0, 0, -1.3) if self.tick == 0 else self.position
        self.tick += 1
        message = TransformStamped()
        translation, r = message.transform.translation, message.transform.rotation
        translation.x, translation.y, translation.z = before.T @ numpy.array(position)
        r.x, r.y, r.z, r.w = quaternion(before.T @ rotation(*self.rpy) @ after)
        self.pose.publish(message)
        self.twist.publish(TwistStamped())
        self.joints.publish(JointState(position=[-3.16 + self.gripper * (1.2 + 3.16)]))
        self.status.publish(Empty())
        self.state.publish(String("DVRK_EFFORT_CARTESIAN"))
        self.closed.publish(Bool(True))

    def listen(self):
        for line in sys.stdin:
            numbers = [float(word) for word in line.split()]
            self.position, self.rpy, self.gripper = numbers[0:3], numbers[3:6], numbers[6]
        rospy.signal_shutdown("no more input")


def main():
    rospy.init_node("proxy_device", anonymous=True, disable_signals=True)
    proxy = Proxy(sys.argv[1])
    threading.Thread(target=proxy.listen, daemon=True).start()
    rate = rospy.Rate(100)
    while not rospy.is_shutdown():
        proxy.publish()
        rate.sleep()


if __name__ == "__main__":
    main()
