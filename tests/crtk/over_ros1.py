"""Arms over ROS 1: rospy, a roscore, the simulator on it."""

import os
import subprocess
import sys
import time
import types
import urllib.parse

import geometry_msgs.msg
import harness
import node
import rosgraph_msgs.msg
import rospy
import sensor_msgs.msg
import std_msgs.msg
from waiting import PATIENCE_S

# Whether a new subscriber gets what was latched before it was there.
TAKES_LATCHED = True

# The service that makes steps.
STEP = "/ambf/env/World/step"


def messages():
    """All types by their names; the classes of crtk_msgs are generated."""
    source = harness.REPOSITORY / "resources/ros/crtk_msgs/msg"
    package = harness.python_messages / "crtk_msgs"
    if not package.exists():
        package.mkdir(parents=True)
        (package / "__init__.py").touch()
        services = sorted((source.parent / "srv").glob("*.srv"))
        include = ["-I", f"crtk_msgs:{source}"]
        for used in ("std_msgs", "geometry_msgs"):
            include += ["-I", f"{used}:/usr/share/{used}/msg"]
        messages_of = [source / "OperatingState.msg", source / "StringStamped.msg"]
        for kind, files in (("msg", messages_of), ("srv", services)):
            generator = ["/usr/bin/python3", f"/usr/lib/genpy/gen{kind}_py.py"]
            subprocess.run([*generator, "-p", "crtk_msgs", "-o", package / kind, *include, *files], check=True)
            subprocess.run([*generator, "--initpy", "-o", package / kind], check=True)
    if str(harness.python_messages) not in sys.path:
        sys.path.insert(0, str(harness.python_messages))
    import crtk_msgs.msg
    import crtk_msgs.srv

    packages = (geometry_msgs.msg, rosgraph_msgs.msg, sensor_msgs.msg, crtk_msgs.msg, crtk_msgs.srv)
    types_of = {name: kind for package in packages for name, kind in vars(package).items() if isinstance(kind, type)}
    standard = {name: getattr(std_msgs.msg, name) for name in ("Bool", "Empty", "Float64", "Float64MultiArray", "String")}
    return types.SimpleNamespace(**types_of, **standard)


class BackEnd:
    """A master, and a simulator on it; with `external` the master of ROS_MASTER_URI, on which another back end runs already."""

    def __init__(self, arguments, external=False):
        self.master = self.simulator = None
        if external:
            self.port = urllib.parse.urlparse(os.environ["ROS_MASTER_URI"]).port
        else:
            self.master = harness.Master()
            self.port = self.master.port
            os.chdir(harness.REPOSITORY)
            self.arguments = arguments
            self.simulator = harness.Simulator(self.port, *arguments)

    def restart(self):
        """Another simulator on the same master."""
        self.simulator.stop()
        self.simulator.check_log()
        self.simulator = harness.Simulator(self.port, *self.arguments)

    def stop(self):
        """Ends what was started."""
        if self.simulator:
            self.simulator.stop()
            self.simulator.check_log()
        if self.master:
            self.master.stop()


def connect(backend):
    """Makes this process a node; possible once."""
    node.start(backend.port)


def nanoseconds(stamp):
    """Of a header, as a number."""
    return stamp.to_nsec()


def now():
    """What stamps of a wall clock are compared with, s."""
    return time.time()


class Subscriber:
    """Calls `receive` with each message."""

    def __init__(self, topic, kind, receive, is_latched=False):
        del is_latched
        self._subscriber = rospy.Subscriber(topic, kind, receive, queue_size=1000, tcp_nodelay=True)

    def is_connected(self):
        """Whether somebody publishes."""
        return self._subscriber.get_num_connections() > 0


class Publisher:
    """Sends messages."""

    def __init__(self, topic, kind, is_latched=False):
        self._publisher = rospy.Publisher(topic, kind, queue_size=10, latch=is_latched)
        self.publish = self._publisher.publish

    def is_connected(self):
        """Whether somebody listens."""
        return self._publisher.get_num_connections() > 0


def ask(service, kind, **fields):
    """The answer of a service to a request with these fields."""
    rospy.wait_for_service(service, timeout=PATIENCE_S)
    return rospy.ServiceProxy(service, kind)(**fields)
