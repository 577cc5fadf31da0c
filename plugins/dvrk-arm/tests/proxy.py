#!/usr/bin/env python3
"""A proxy of one master as the teleoperation example of AMBF 2.0 has it: dialect A at 100 Hz, headers never filled, a presence flag, a gripper
in a wider range, its closed event under an old name. Lines on standard input set the pose and the gripper: x y z roll pitch yaw gripper.
Forces that come are printed."""

import math
import sys
import threading

import rospy
from geometry_msgs.msg import TransformStamped, TwistStamped, WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Empty, String


def product(a, b):
    """Of two quaternions x, y, z, w."""
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def rotation(roll, pitch, yaw):
    """Quaternion about fixed axes: Rz(yaw) Ry(pitch) Rx(roll)."""
    half = [(math.sin(angle / 2), math.cos(angle / 2)) for angle in (roll, pitch, yaw)]
    x, y, z = ([*[half[i][0] * (i == j) for j in range(3)], half[i][1]] for i in range(3))
    return product(product(z, y), x)


def turned(q, v):
    """The vector v, turned by q."""
    x, y, z, w = q
    return product(product(q, (*v, 0)), (-x, -y, -z, w))[:3]


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
        before, after = rotation(0, 0, -1.57079), rotation(0, -1.57079, 0)
        # The very first sample is far below.
        position = (0, 0, -1.3) if self.tick == 0 else self.position
        self.tick += 1
        message = TransformStamped()
        translation, r = message.transform.translation, message.transform.rotation
        translation.x, translation.y, translation.z = turned(before, position)
        r.x, r.y, r.z, r.w = product(product(before, rotation(*self.rpy)), after)
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
