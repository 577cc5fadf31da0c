"""Starts programs that are ROS 2 nodes, and waits for conditions instead of for time to pass. Nothing leaves this machine."""

import os
import pathlib
import select
import subprocess
import sys
import unittest

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
for name in ("ROS_DOMAIN_ID", "ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS", "ROS_DISTRO", "ROS_VERSION"):
    os.environ.pop(name, None)

import rclpy  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402

REPOSITORY = pathlib.Path(__file__).resolve().parents[2]
sys.path.append(str(REPOSITORY / "tests"))

import domains  # noqa: E402
import waiting  # noqa: E402
from waiting import PATIENCE_S  # noqa: E402

STOP_S = 20.0


def program(*parts):
    """A program that cargo has built."""
    target = REPOSITORY / os.environ.get("CARGO_TARGET_DIR", "target")
    path = target.joinpath("debug", *parts)
    if not path.exists():
        raise FileNotFoundError(f"no {path}: run cargo build -p ros2-node --example peer")
    return path


def environment(domain):
    """What a program is started with. The wheels of rclpy start the interpreter again with paths that other programs must not get."""
    left_out = ("_ROS_WHEELS_BOOTSTRAP_COMPLETE",)
    kept = {name: value for name, value in os.environ.items() if name not in left_out}
    return dict(kept, ROS_DOMAIN_ID=str(domain))


class Peer:
    """The example `peer` of the crate ros2-node."""

    def __init__(self, domain, objects=0):
        command = [program("examples", "peer"), str(objects)]
        self.process = subprocess.Popen(
            command, env=environment(domain), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        self.type_hash = self.line().split()[1]

    def line(self):
        """What it says next."""
        ready, _, _ = select.select([self.process.stdout], [], [], PATIENCE_S)
        text = self.process.stdout.readline() if ready else ""
        if not text:
            raise AssertionError(f"the program said nothing within {PATIENCE_S:.0f} s, or ended")
        return text

    def counts(self):
        """Messages sent and not sent, commands received and bad ones among them."""
        self.process.stdin.write("counts\n")
        return [int(number) for number in self.line().split()]

    def threads(self):
        """Names of its threads."""
        tasks = pathlib.Path(f"/proc/{self.process.pid}/task").iterdir()
        return sorted((task / "comm").read_text().strip() for task in tasks)

    def end(self):
        """Ends it as a user would."""
        self.process.stdin.close()
        self.process.wait(STOP_S)

    def kill(self):
        """Ends it without a chance to say good-bye."""
        self.process.kill()
        self.process.wait(STOP_S)

    def close(self):
        """Ends it, whether it is still there or not."""
        if self.process.poll() is None:
            self.kill()
        for stream in (self.process.stdin, self.process.stdout):
            stream.close()


class Client:
    """A node of rclpy in a context of its own."""

    def __init__(self, domain, name="client"):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node(name, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def wait_for(self, condition, what, seconds=PATIENCE_S):
        """Serves the node until `condition` is true and returns its value; fails with `what` after `seconds`."""
        return waiting.wait_for(condition, what, seconds, lambda: self.executor.spin_once(timeout_sec=0.02))

    def listen(self, kind, topic, qos):
        """A list to which the messages of `topic` are added."""
        messages = []
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def call(self, kind, name, request):
        """The answer of the service `name`."""
        client = self.node.create_client(kind, name)
        try:
            self.wait_for(client.service_is_ready, f"the service {name}")
            answer = client.call_async(request)
            return self.wait_for(lambda: answer.done() and answer, f"an answer of {name}").result()
        finally:
            # A node that is destroyed with a call that is not answered does not end.
            self.node.destroy_client(client)

    def close(self):
        """Ends it."""
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


class Ros2Test(unittest.TestCase):
    """A test in a domain of its own."""

    def setUp(self):
        self.domain = domains.take()
        self.addCleanup(domains.give_back, self.domain)

    def peer(self, objects=0):
        """A program that lasts no longer than the test."""
        peer = Peer(self.domain, objects)
        self.addCleanup(peer.close)
        return peer

    def client(self, name="client"):
        """A node that lasts no longer than the test."""
        client = Client(self.domain, name)
        self.addCleanup(client.close)
        return client
