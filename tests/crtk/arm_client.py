"""A client of one arm with the calls of crtk_python_client, and its rules: an operating state counts if its stamp is newer, a move has
ended when the arm was busy after the command and is not any more."""

import collections
import threading
import time

from middleware import Publisher, Subscriber, messages, nanoseconds
from waiting import PATIENCE_S, wait_for


class Arm:
    """An arm by its name space, such as /PSM1."""

    def __init__(self, space, jaw=True, robot=False):
        kinds = messages()
        joints, pose, twist = kinds.JointState, kinds.PoseStamped, kinds.TwistStamped
        self.space = space
        self.newest = {}
        self.arrivals = collections.defaultdict(lambda: collections.deque(maxlen=20000))
        self.states = []
        self.warnings = []
        self._changed = threading.Condition()
        self._subscribers = {}
        self._publishers = {}
        self.outputs = {
            "measured_js": joints,
            "setpoint_js": joints,
            "measured_cp": pose,
            "setpoint_cp": pose,
            "measured_cv": twist,
        }
        inputs = {"servo_jp": joints, "servo_cp": pose, "move_jp": joints, "move_cp": pose, "state_command": kinds.StringStamped}
        if jaw:
            self.outputs.update({"jaw/measured_js": joints, "jaw/setpoint_js": joints})
            self.outputs.update({"local/measured_cp": pose, "local/setpoint_cp": pose})
            inputs.update({"jaw/servo_jp": joints, "jaw/move_jp": joints})
        if robot:
            inputs.update({"servo_jv": joints, "servo_cv": twist, "servo_jr": joints, "move_jr": joints, "servo_jf": joints})
            inputs.update({"hold": kinds.Empty, "free": kinds.Empty})
            inputs["body/servo_cf"] = kinds.WrenchStamped
            inputs["jaw/servo_jf"] = joints
            self.outputs["body/jacobian"] = kinds.Float64MultiArray
        for name, kind in self.outputs.items():
            self._subscribe(name, kind, self._receive(name))
        self._subscribe("operating_state", kinds.OperatingState, self._receive_state, is_latched=True)
        self._subscribe("warning", kinds.StringStamped, self.warnings.append)
        if jaw:
            self._subscribe("tool_type", kinds.String, self._receive("tool_type"), is_latched=True)
        for name, kind in inputs.items():
            publisher = Publisher(f"{space}/{name}", kind, is_latched=name == "state_command")
            self._publishers[name] = (publisher, kind)

    def _subscribe(self, name, kind, receive, is_latched=False):
        self._subscribers[name] = Subscriber(f"{self.space}/{name}", kind, receive, is_latched)

    def _receive(self, name):
        def receive(message):
            with self._changed:
                self.newest[name] = message
                self.arrivals[name].append((time.monotonic(), getattr(message, "header", None)))
                self._changed.notify_all()

        return receive

    def _receive_state(self, state):
        with self._changed:
            if not self.states or nanoseconds(state.header.stamp) > nanoseconds(self.states[-1].header.stamp):
                self.states.append(state)
                self._changed.notify_all()

    def wait(self, condition, what, seconds=PATIENCE_S):
        """Waits for a condition on what has come."""
        with self._changed:
            if not self._changed.wait_for(condition, seconds):
                raise AssertionError(f"{self.space}: not within {seconds:.0f} s: {what}")

    def check_connections(self):
        """Every topic has somebody on the other side."""

        sent = [(name, publisher) for name, (publisher, _) in self._publishers.items()]
        unconnected = sent + list(self._subscribers.items())

        def all_connected():
            unconnected[:] = [(name, topic) for name, topic in unconnected if not topic.is_connected()]
            return not unconnected

        wait_for(all_connected, lambda: f"connections of {self.space} for {[name for name, _ in unconnected]}")
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
        """Waits for messages that come from now on, none of them from before the newest operating state: topics have queues of their
        own, so that a busy client may get a set point long after a state that was published later."""
        start = len(self.arrivals[name])
        wanted = min(start + count, self.arrivals[name].maxlen)

        def have_come():
            header = getattr(self.newest[name], "header", None)
            stamp = nanoseconds(header.stamp) if header else 0
            return len(self.arrivals[name]) >= wanted and (stamp == 0 or stamp >= nanoseconds(self.states[-1].header.stamp))

        self.wait(have_come, f"{count} messages of {name}")
