"""This process as a ROS node: listeners that remember, and streams of commands."""

import collections
import os
import threading
import time

import harness
import rospy


def start(port):
    """Makes this process a node of the master at `port`; possible once a process."""
    for name, value in harness.environment(port).items():
        if name.startswith("ROS_"):
            os.environ[name] = value
    # Some tests provoke rospy's warnings.
    rospy.init_node("tests", anonymous=True, disable_signals=True, log_level=rospy.ERROR)


def set_parameter(name, value):
    """Sets a parameter of the simulator when it is there: what was set before the simulator writes it would be overwritten."""
    harness.wait_for(lambda: rospy.has_param(name), f"the parameter {name}")
    rospy.set_param(name, value)


def service(name, kind):
    """A service, once it is there: a node registers its services with the master after its topics."""
    rospy.wait_for_service(name, timeout=harness.PATIENCE_S)
    return rospy.ServiceProxy(name, kind)


class Listener:
    """The newest message of a topic and when the last ones arrived."""

    def __init__(self, topic, kind):
        self._topic = topic
        self._newest = None
        self._arrivals = collections.deque(maxlen=5000)
        self._subscriber = rospy.Subscriber(topic, kind, self._receive, queue_size=1000, tcp_nodelay=True)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        """Unsubscribes."""
        self._subscriber.unregister()

    def _receive(self, message):
        self._newest = message
        self._arrivals.append(time.monotonic())

    def count(self):
        """How many messages have arrived (the last 5000 at most)."""
        return len(self._arrivals)

    def newest(self):
        """The newest message, after waiting for the first."""
        return harness.wait_for(lambda: self._newest, f"a message of {self._topic}")

    def until(self, condition, what, seconds=harness.PATIENCE_S):
        """Waits for a message that arrives from now on and meets `condition`, and returns it."""
        old = self._newest

        def look():
            message = self._newest
            return message if message is not None and message is not old and condition(message) else None

        try:
            return harness.wait_for(look, what, seconds)
        except AssertionError as error:
            raise AssertionError(f"{error}; newest message of {self._topic}:\n{self._newest}") from None

    def next(self):
        """The next message."""
        return self.until(lambda _: True, f"another message of {self._topic}")

    def rate(self, seconds=1.0):
        """Messages a second over the next `seconds`."""
        start_s = time.monotonic()
        time.sleep(seconds)
        arrivals = [arrival for arrival in list(self._arrivals) if arrival > start_s]
        return len(arrivals) / (time.monotonic() - start_s)


class Together:
    """States of several topics, matched by step: a tuple for each step of which all topics told."""

    def __init__(self, *topics):
        """`topics`: pairs of name and message type."""
        self._lock = threading.Lock()
        self._seen = [{} for _ in topics]
        self._names = [name for name, _ in topics]
        self._subscribers = [
            rospy.Subscriber(name, kind, self._receive, seen, queue_size=1000, tcp_nodelay=True)
            for (name, kind), seen in zip(topics, self._seen)
        ]

    def close(self):
        """Unsubscribes."""
        for subscriber in self._subscribers:
            subscriber.unregister()

    def _receive(self, message, seen):
        with self._lock:
            seen[message.sim_step] = message

    def clear(self):
        """Forgets everything received so far."""
        with self._lock:
            for seen in self._seen:
                seen.clear()

    def all(self):
        """What was received of each step, in order."""
        with self._lock:
            steps = set.intersection(*(set(seen) for seen in self._seen))
            return [tuple(seen[step] for seen in self._seen) for step in sorted(steps)]

    def next(self, count=1):
        """Forgets what was received and waits for `count` steps."""
        self.clear()
        return harness.wait_for(
            lambda: found if len(found := self.all()) >= count else None, f"{count} steps of all of {self._names}"
        )


class Stream:
    """Sends a command again and again (100 Hz), as clients do, while the `with` block lasts."""

    def __init__(self, topic, command):
        self.command = command
        self._publisher = rospy.Publisher(topic, type(command), queue_size=1, tcp_nodelay=True)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._send, daemon=True)
        harness.wait_for(lambda: self._publisher.get_num_connections() > 0, f"the simulator listens to {topic}")

    def _send(self):
        while not self._end.wait(0.01):
            self._publisher.publish(self.command)

    def once(self):
        """Sends the command a single time."""
        self._publisher.publish(self.command)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()
        self._publisher.unregister()
