"""A client of one arm with the calls of crtk_python_client, and its rules: an operating state counts if its stamp is newer, a move has
ended when the arm was busy after the command and is not any more."""

import collections
import threading
import time

import geometry_msgs.msg
import harness
import rospy
import sensor_msgs.msg
import std_msgs.msg

JOINTS, POSE, TWIST = sensor_msgs.msg.JointState, geometry_msgs.msg.PoseStamped, geometry_msgs.msg.TwistStamped


class Arm:
    """An arm by its name space, such as /PSM1."""

    def __init__(self, space, jaw=True, robot=False):
        from crtk_msgs.msg import OperatingState, StringStamped

        self.space = space
        self.newest = {}
        self.arrivals = collections.defaultdict(lambda: collections.deque(maxlen=20000))
        self.states = []
        self.warnings = []
        self._changed = threading.Condition()
        self._subscribers = []
        self._publishers = {}
        self.outputs = {
            "measured_js": JOINTS,
            "setpoint_js": JOINTS,
            "measured_cp": POSE,
            "setpoint_cp": POSE,
            "measured_cv": TWIST,
        }
        inputs = {"servo_jp": JOINTS, "servo_cp": POSE, "move_jp": JOINTS, "move_cp": POSE, "state_command": StringStamped}
        if jaw:
            self.outputs.update({"jaw/measured_js": JOINTS, "jaw/setpoint_js": JOINTS})
            self.outputs.update({"local/measured_cp": POSE, "local/setpoint_cp": POSE})
            inputs.update({"jaw/servo_jp": JOINTS, "jaw/move_jp": JOINTS})
        if robot:
            inputs.update({"servo_jv": JOINTS, "servo_cv": TWIST, "servo_jr": JOINTS, "move_jr": JOINTS, "servo_jf": JOINTS})
            inputs.update({"hold": std_msgs.msg.Empty, "free": std_msgs.msg.Empty})
            inputs["body/servo_cf"] = geometry_msgs.msg.WrenchStamped
            self.outputs["body/jacobian"] = std_msgs.msg.Float64MultiArray
        for name, kind in self.outputs.items():
            self._subscribe(name, kind, self._receive(name))
        self._subscribe("operating_state", OperatingState, self._receive_state)
        self._subscribe("warning", StringStamped, self.warnings.append)
        for name, kind in inputs.items():
            topic = f"{space}/{name}"
            self._publishers[name] = (rospy.Publisher(topic, kind, queue_size=10, latch=name == "state_command"), kind)

    def _subscribe(self, name, kind, receive):
        subscriber = rospy.Subscriber(f"{self.space}/{name}", kind, receive, queue_size=1000, tcp_nodelay=True)
        self._subscribers.append(subscriber)

    def _receive(self, name):
        def receive(message):
            with self._changed:
                self.newest[name] = message
                self.arrivals[name].append((time.monotonic(), getattr(message, "header", None)))
                self._changed.notify_all()

        return receive

    def _receive_state(self, state):
        with self._changed:
            if not self.states or state.header.stamp > self.states[-1].header.stamp:
                self.states.append(state)
                self._changed.notify_all()

    def wait(self, condition, what, seconds=harness.PATIENCE_S):
        """Waits for a condition on what has come."""
        with self._changed:
            if not self._changed.wait_for(condition, seconds):
                raise AssertionError(f"{self.space}: not within {seconds:.0f} s: {what}")

    def check_connections(self):
        """Every topic has somebody on the other side."""

        def all_connected():
            publishers = all(publisher.get_num_connections() for publisher, _ in self._publishers.values())
            return publishers and all(subscriber.get_num_connections() for subscriber in self._subscribers)

        harness.wait_for(all_connected, f"all topics of {self.space} are connected")
        self.wait(lambda: self.states and all(name in self.newest for name in self.outputs), "everything is published")

    def send(self, topic, **fields):
        """Publishes a message; `position`, `velocity`, `effort`, `name` of joints, or `pose`, `frame`."""
        publisher, kind = self._publishers[topic]
        message = kind()
        for field, value in fields.items():
            if field == "pose":
                message.pose = value
            elif field == "frame":
                message.header.frame_id = value
            else:
                setattr(message, field, value)
        publisher.publish(message)

    def command(self, text):
        """A state command; waits for the state that answers it."""
        count = len(self.states)
        self.send("state_command", string=text)
        self.wait(lambda: len(self.states) > count, f"an answer to {text}")
        return self.states[-1]

    def move(self, topic, **fields):
        """A move; waits until the arm was busy and is not any more, and for a publication after that. Returns how long it was busy, s."""
        count = len(self.states)
        begin = time.monotonic()
        self.send(topic, **fields)

        def done():
            busy = [state.is_busy for state in self.states[count:]]
            return True in busy and not busy[-1]

        self.wait(done, f"{topic} has ended")
        took = time.monotonic() - begin
        self.fresh("setpoint_js")
        return took

    def joints(self, name="measured_js"):
        """Positions of the newest message."""
        return list(self.newest[name].position)

    def pose(self, name="measured_cp"):
        """The newest pose."""
        return self.newest[name].pose

    def fresh(self, name="measured_js", count=3):
        """Waits for messages that come from now on."""
        start = len(self.arrivals[name])
        wanted = min(start + count, self.arrivals[name].maxlen)
        self.wait(lambda: len(self.arrivals[name]) >= wanted, f"{count} messages of {name}")
