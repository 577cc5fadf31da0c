"""A master moves a puppet through topics of ROS 1 alone, as the teleoperation component of a dVRK does:

    python3 tests/crtk/teleoperation.py /MTMR /PSM1 --scale 0.2 --clutch /footpedals/clutch

Displacements of the master since it was engaged are scaled and added to where the puppet was; the puppet turns as the master turns. While
the clutch is pressed the puppet holds, and the master moves freely. The gripper's angle opens the jaw."""

import argparse
import dataclasses
import math
import threading

import geometry_msgs.msg
import rospy
import sensor_msgs.msg
import std_msgs.msg


def product(a, b):
    """Of two quaternions (x, y, z, w): first b, then a."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def inverse(q):
    """Of a quaternion of length 1."""
    return (-q[0], -q[1], -q[2], q[3])


def frame_of(pose):
    """Position (m) and quaternion of a message."""
    p, q = pose.position, pose.orientation
    return (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)


@dataclasses.dataclass
class Settings:
    """How a master moves a puppet."""

    # Metres of the puppet for a metre of the master.
    scale: float = 0.2
    # Angles of gripper and jaw at both ends, rad.
    gripper: tuple = (0.0, math.radians(60.0))
    jaw: tuple = (-0.3, 1.2)
    # Largest speed of the jaw, rad/s: a gripper that is elsewhere at the start is met slowly.
    jaw_speed: float = 3.0
    rate: float = 100.0


class Coupling:
    """The arithmetic alone: no topics, no clock."""

    def __init__(self, settings):
        self.settings = settings
        self._start = None
        self._jaw = None

    def engage(self, master, puppet, jaw):
        """From here on `master` moves the puppet away from `puppet`, both frames; `jaw` is its present angle."""
        (m, m_rotation), (p, p_rotation) = master, puppet
        self._start = (m, p, product(inverse(m_rotation), p_rotation))
        self._jaw = jaw

    def release(self):
        """The puppet holds until it is engaged again."""
        self._start = None

    @property
    def is_engaged(self):
        """Whether the master moves the puppet."""
        return self._start is not None

    def goal(self, master):
        """Where the puppet is to be while the master is at `master`."""
        m0, p0, offset = self._start
        m, rotation = master
        position = tuple(p + self.settings.scale * (now - before) for p, now, before in zip(p0, m, m0))
        return position, product(rotation, offset)

    def jaw(self, gripper):
        """The jaw's angle for a gripper's angle, not faster than it may be."""
        (g0, g1), (j0, j1) = self.settings.gripper, self.settings.jaw
        share = min(max((gripper - g0) / (g1 - g0), 0.0), 1.0)
        wanted, most = j0 + share * (j1 - j0), self.settings.jaw_speed / self.settings.rate
        self._jaw += min(max(wanted - self._jaw, -most), most)
        return self._jaw


class Teleoperation:
    """Subscribes to a master and commands a puppet, until it is closed."""

    def __init__(self, master, puppet, settings=None, clutch=None):
        from crtk_msgs.msg import OperatingState

        self.settings = settings or Settings()
        self.coupling = Coupling(self.settings)
        self.newest = {}
        self._states = {}
        self._pressed = False
        self._lock = threading.Lock()
        self._end = threading.Event()
        joints, pose = sensor_msgs.msg.JointState, geometry_msgs.msg.PoseStamped
        heard = {
            "master": (f"{master}/measured_cp", pose),
            "gripper": (f"{master}/gripper/measured_js", joints),
            "puppet": (f"{puppet}/setpoint_cp", pose),
            "jaw": (f"{puppet}/jaw/setpoint_js", joints),
        }
        listen = rospy.Subscriber
        self._subscribers = [listen(topic, kind, self._keep, name) for name, (topic, kind) in heard.items()]
        for name, space in (("master", master), ("puppet", puppet)):
            self._subscribers.append(listen(f"{space}/operating_state", OperatingState, self._state, name))
        if clutch:
            self._subscribers.append(listen(clutch, sensor_msgs.msg.Joy, self._clutch))
        self._servo = rospy.Publisher(f"{puppet}/servo_cp", pose, queue_size=1, tcp_nodelay=True)
        self._servo_jaw = rospy.Publisher(f"{puppet}/jaw/servo_jp", joints, queue_size=1, tcp_nodelay=True)
        self._hold = rospy.Publisher(f"{puppet}/hold", std_msgs.msg.Empty, queue_size=1)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self):
        """Ends it; the puppet holds."""
        self._end.set()
        self._thread.join()
        for topic in (*self._subscribers, self._servo, self._servo_jaw, self._hold):
            topic.unregister()

    def _keep(self, message, name):
        with self._lock:
            self.newest[name] = message

    def _state(self, state, name):
        self._states[name] = state.state == "ENABLED" and state.is_homed

    def _clutch(self, joy):
        self._pressed = bool(joy.buttons and joy.buttons[0])

    def _is_ready(self):
        """Both arms may move, and everything is known and valid (a stamp of 0 says that it is not)."""
        known = all(name in self.newest for name in ("master", "gripper", "puppet", "jaw"))
        may = all(self._states.get(name) for name in ("master", "puppet"))
        return known and may and self.newest["master"].header.stamp and self.newest["puppet"].header.stamp

    def _run(self):
        while not self._end.wait(1.0 / self.settings.rate):
            with self._lock:
                self._step()

    def _step(self):
        if self._pressed or not self._is_ready():
            if self.coupling.is_engaged:
                self.coupling.release()
                self._hold.publish()
            return
        master = frame_of(self.newest["master"].pose)
        if not self.coupling.is_engaged:
            puppet, jaw = frame_of(self.newest["puppet"].pose), self.newest["jaw"].position[0]
            self.coupling.engage(master, puppet, jaw)
        goal = geometry_msgs.msg.PoseStamped()
        goal.header.frame_id = self.newest["puppet"].header.frame_id
        (p, q) = self.coupling.goal(master)
        goal.pose.position.x, goal.pose.position.y, goal.pose.position.z = p
        goal.pose.orientation.x, goal.pose.orientation.y, goal.pose.orientation.z, goal.pose.orientation.w = q
        self._servo.publish(goal)
        angle = self.coupling.jaw(self.newest["gripper"].position[0])
        self._servo_jaw.publish(sensor_msgs.msg.JointState(position=[angle]))


def main():
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("master", help="name space, such as /MTMR")
    parser.add_argument("puppet", help="name space, such as /PSM1")
    parser.add_argument("--scale", type=float, default=Settings.scale)
    parser.add_argument("--clutch", help="topic of a pedal, such as /footpedals/clutch")
    arguments = parser.parse_args()
    rospy.init_node("teleoperation", anonymous=True)
    teleoperation = Teleoperation(arguments.master, arguments.puppet, Settings(scale=arguments.scale), arguments.clutch)
    rospy.spin()
    teleoperation.close()


if __name__ == "__main__":
    main()
