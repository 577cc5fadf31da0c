"""Arms over ROS 2: rclpy, the simulator in a domain of its own. Nothing leaves this machine."""

import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import threading
import time
import types

import domains

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
if not os.environ.get("CRTK_ARM"):
    os.environ["ROS_DOMAIN_ID"] = str(domains.take())

import crtk_msgs.msg  # noqa: E402
import crtk_msgs.srv  # noqa: E402
import geometry_msgs.msg  # noqa: E402
import rclpy  # noqa: E402
import rosgraph_msgs.msg  # noqa: E402
import sensor_msgs.msg  # noqa: E402
import std_msgs.msg  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from waiting import PATIENCE_S, wait_for  # noqa: E402

REPOSITORY = pathlib.Path(__file__).resolve().parents[2]
STOP_S = 20.0

# Whether a new subscription gets what was latched before it was there: those of arms are volatile.
TAKES_LATCHED = False

# The service that makes steps.
STEP = "/ambf/env/World/Step"

_node = None
_thread = None
_end = threading.Event()


def messages():
    """All types by their names."""
    packages = (geometry_msgs.msg, rosgraph_msgs.msg, sensor_msgs.msg, crtk_msgs.msg, crtk_msgs.srv)
    types_of = {name: kind for package in packages for name, kind in vars(package).items() if isinstance(kind, type)}
    standard = {name: getattr(std_msgs.msg, name) for name in ("Bool", "Empty", "Float64", "Float64MultiArray", "String")}
    return types.SimpleNamespace(**types_of, **standard)


def simulator_path():
    """$AMBF_SIMULATOR, else the program that cargo has built."""
    target = REPOSITORY / os.environ.get("CARGO_TARGET_DIR", "target")
    return pathlib.Path(os.environ.get("AMBF_SIMULATOR") or target / "debug/ambf_simulator")


class BackEnd:
    """The simulator, unless another back end runs already."""

    def __init__(self, arguments, external=False):
        self._process = None
        if not external:
            self._start(arguments)

    def _start(self, arguments):
        # The wheels of rclpy start the interpreter again with paths that other programs must not get.
        kept = {name: value for name, value in os.environ.items() if name != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
        self._log = tempfile.TemporaryFile("w+", prefix="ambf-crtk-tests-")
        self._arguments = arguments
        command = [simulator_path(), "-g", "0", "--ros", "2", *arguments]
        self._process = subprocess.Popen(
            command, env=kept, cwd=REPOSITORY, stdin=subprocess.DEVNULL, stdout=self._log, stderr=self._log
        )

    def stop(self):
        """Ends the node, and what was started."""
        _end.set()
        if _thread is not None:
            _thread.join()
        rclpy.shutdown()
        if self._process is not None:
            self._end()

    def restart(self):
        """Another simulator in the same domain."""
        self._end()
        self._start(self._arguments)

    def _end(self):
        self._process.send_signal(signal.SIGINT)
        try:
            status = self._process.wait(STOP_S)
        finally:
            self._process.kill()
            self._log.seek(0)
            said = self._log.read()
            self._log.close()
            # Shown where a test fails.
            print(said, file=sys.stderr)
        assert status == 0 and "panicked" not in said, said


def connect(backend):
    """Makes this process a node, which a thread serves."""
    global _node, _thread
    del backend
    rclpy.init()
    _node = rclpy.create_node("conformance")
    executor = SingleThreadedExecutor()
    executor.add_node(_node)

    def spin():
        while not _end.is_set():
            executor.spin_once(timeout_sec=0.1)

    _thread = threading.Thread(target=spin, daemon=True)
    _thread.start()


def nanoseconds(stamp):
    """Of a header, as a number."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def now():
    """What stamps of a wall clock are compared with, s."""
    return time.time()


def _quality(depth, is_latched):
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE)


class Subscriber:
    """Calls `receive` with each message."""

    def __init__(self, topic, kind, receive, is_latched=False):
        self._topic = topic
        self._subscription = _node.create_subscription(kind, topic, receive, _quality(10 if is_latched else 1000, is_latched))

    def is_connected(self):
        """Whether somebody publishes."""
        return _node.count_publishers(self._topic) > 0


class Publisher:
    """Sends messages."""

    def __init__(self, topic, kind, is_latched=False):
        self._publisher = _node.create_publisher(kind, topic, _quality(10, is_latched))
        self.publish = self._publisher.publish

    def is_connected(self):
        """Whether somebody listens."""
        return self._publisher.get_subscription_count() > 0


def ask(service, kind, **fields):
    """The answer of a service to a request with these fields."""
    client = _node.create_client(kind, service)
    try:
        assert client.wait_for_service(PATIENCE_S), service
        answer = client.call_async(kind.Request(**fields))
        wait_for(answer.done, f"an answer of {service}")
        return answer.result()
    finally:
        _node.destroy_client(client)
