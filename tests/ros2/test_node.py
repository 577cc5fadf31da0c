"""The crate ros2-node beside rclpy: names, types, messages, services, parameters, and what happens when one of the two goes.

Run with the environment of scripts/ros2-venv: `. scripts/ros2-venv; $AMBF_ROS2_PYTHON -m unittest discover -s tests/ros2`."""

import collections
import contextlib
import math
import random
import signal
import socket
import struct
import subprocess
import sys
import time

from harness import PATIENCE_S, Ros2Test, environment
from ambf_msgs.msg import RigidBodyCmd, RigidBodyState
from ambf_msgs.srv import AddModel
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, GetParameterTypes, ListParameters, SetParameters
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image
from std_msgs.msg import String

# Deeper than any test is long: rclpy hands some hundred messages a second over where the machine is busy, and drops those beyond the depth.
MANY = QoSProfile(depth=100_000)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def command(number=0):
    """A command with something in each field."""
    message = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_VELOCITY, joint_cmds_types=[0, 1, 2])
    message.header.frame_id = f"number {number}"
    message.header.stamp.sec = 1_700_000_000
    message.pose.orientation.w = 0.25
    message.wrench.torque.z = -3.5
    message.twist.angular.x = math.inf
    message.joint_cmds = [0.5, -1.0]
    message.publish_joint_names = True
    return message


class Graph(Ros2Test):
    """What is there, as `ros2 topic` and `ros2 node` would show it."""

    def test_topics_nodes_and_types(self):
        peer = self.peer(100)
        client = self.client()
        start = time.monotonic()

        def complete():
            nodes = [name for name, _ in client.node.get_node_names_and_namespaces()]
            return sum(name.startswith("object_") for name in nodes) == 100

        client.wait_for(complete, "the nodes")

        def endpoints():
            of_node = client.node.get_publisher_names_and_types_by_node("object_99", "/")
            return of_node + client.node.get_subscriber_names_and_types_by_node("object_99", "/")

        wanted = [
            ("/object_99/State", ["ambf_msgs/msg/RigidBodyState"]),
            ("/object_99/Command", ["ambf_msgs/msg/RigidBodyCmd"]),
        ]
        client.wait_for(lambda: endpoints() == wanted, "the topics of a node")
        print(f"100 nodes complete after {time.monotonic() - start:.2f} s")
        topics = dict(client.node.get_topic_names_and_types())
        for number in range(100):
            self.assertEqual(topics[f"/object_{number}/State"], ["ambf_msgs/msg/RigidBodyState"])
            self.assertEqual(topics[f"/object_{number}/Command"], ["ambf_msgs/msg/RigidBodyCmd"])
        services = dict(client.node.get_service_names_and_types())
        self.assertEqual(services["/test/AddModel"], ["ambf_msgs/srv/AddModel"])
        # Two of RustDDS, one of the node; the others are the program's own.
        ours = [name for name in peer.threads() if not name.startswith("peer")]
        self.assertLessEqual(len(ours), 3, ours)

    def test_hashes_are_those_of_rosidl(self):
        client = self.client()
        client.node.create_publisher(RigidBodyState, "/own", 1)
        info = client.wait_for(lambda: client.node.get_publishers_info_by_topic("/own"), "the own publisher")
        self.assertEqual(str(info[0].topic_type_hash), self.peer().type_hash)

    def test_nothing_leaves_the_machine(self):
        try:
            tap = socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.ntohs(3))
        except PermissionError:
            self.skipTest("SKIPPED: packets of other interfaces can only be seen with the right to")
        self.addCleanup(tap.close)
        tap.setblocking(False)
        ports = range(7400 + 250 * self.domain, 7400 + 250 * (self.domain + 1))
        seen = collections.Counter()

        def look():
            """Takes what has come, before the packets of other programs fill the socket's memory."""
            with contextlib.suppress(BlockingIOError):
                while True:
                    packet, (interface, *_) = tap.recvfrom(100)
                    # IPv4 without options, UDP.
                    is_ours = len(packet) >= 32 and packet[0] == 0x45 and packet[9] == 17 and packet[28:32] == b"RTPS"
                    if is_ours and struct.unpack("!H", packet[22:24])[0] in ports:
                        seen["own" if interface == "lo" else "elsewhere"] += 1

        peer, client = self.peer(), self.client()
        messages = client.listen(RigidBodyState, "/test/State", MANY)
        client.wait_for(lambda: look() or len(messages) > 3000, "states")
        self.assertGreater(peer.counts()[0], 0)
        look()
        self.assertGreater(seen["own"], 0)
        self.assertEqual(seen["elsewhere"], 0)


class Messages(Ros2Test):
    """States, commands, images."""

    def test_states_at_1_khz_arrive_complete_and_in_order(self):
        peer, client = self.peer(), self.client()
        states = client.listen(RigidBodyState, "/test/State", MANY)
        client.wait_for(lambda: len(states) >= 3000, "states")
        steps = [state.sim_step for state in states]
        self.assertEqual(steps, list(range(steps[0], steps[0] + len(steps))))
        state = states[-1]
        self.assertEqual(state.identifier.data, "/ambf/env/BODY a")
        self.assertEqual(list(state.joint_names), ["joint one", "Größe"])
        self.assertEqual(state.p_inertia.z, 2.5)
        self.assertEqual(list(state.joint_efforts), [2.0, -1.25])
        sent, unsent, _, _ = peer.counts()
        self.assertEqual(unsent, 0)
        print(f"{len(states)} of {sent} states so far, none missing")

    def test_best_effort_subscriptions_get_states_and_those_that_ask_for_more_get_none(self):
        self.peer()
        client = self.client()
        best_effort = client.listen(
            RigidBodyState, "/test/State", QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
        )
        transient = client.listen(RigidBodyState, "/test/State", LATCHED)
        client.wait_for(lambda: len(best_effort) > 500, "states")
        self.assertEqual(transient, [])

    def test_commands_come_back_as_they_were(self):
        peer, client = self.peer(), self.client()
        echoes = client.listen(RigidBodyCmd, "/test/Echo", MANY)
        publisher = client.node.create_publisher(RigidBodyCmd, "/test/Command", MANY)
        client.wait_for(lambda: publisher.get_subscription_count() == 1, "the subscription")
        client.wait_for(lambda: client.node.count_publishers("/test/Echo") == 1, "the echo")
        sent = 0

        def answered():
            nonlocal sent
            sent += 1
            publisher.publish(command(-sent))
            return echoes

        client.wait_for(answered, "an echo")
        for number in range(500):
            publisher.publish(command(number))
            # A longer burst may be overwritten before it is read.
            if number % 20 == 19:
                last = command(number).header.frame_id
                client.wait_for(lambda last=last: echoes[-1].header.frame_id == last, "the last echo")
        numbers = [echo.header.frame_id for echo in echoes if "-" not in echo.header.frame_id]
        self.assertEqual(numbers, [f"number {number}" for number in range(500)])
        self.assertEqual(echoes[-1], command(499))
        self.assertEqual(peer.counts()[2:], [500 + sent, 0])

    def test_bytes_that_are_no_command_do_no_harm(self):
        peer, client = self.peer(), self.client()
        echoes = client.listen(RigidBodyCmd, "/test/Echo", MANY)
        publisher = client.node.create_publisher(RigidBodyCmd, "/test/Command", MANY)
        client.wait_for(lambda: publisher.get_subscription_count() == 1, "the subscription")
        generator = random.Random(1)

        def is_enough():
            # A burst may be overwritten before it is read: there are more until enough have come.
            for _ in range(20):
                publisher.publish(b"\x00\x01\x00\x00" + generator.randbytes(generator.randrange(400)))
            return peer.counts()[3] >= 200

        client.wait_for(is_enough, "bad commands")

        def answered():
            publisher.publish(command())
            return echoes and echoes[-1] == command()

        client.wait_for(answered, "an echo")

    def test_images_of_a_megabyte_arrive(self):
        self.peer()
        client = self.client()
        images = client.listen(Image, "/test/Image", 10)
        start = time.monotonic()
        # With a receive buffer of the usual size most of them are lost (ros2-node/README.md): one is enough.
        client.wait_for(lambda: images, "an image")
        print(f"an image of 1 MB after {time.monotonic() - start:.1f} s; sent are 10 a second")
        image = images[-1]
        self.assertEqual((image.height, image.width, image.encoding), (500, 2000, "mono8"))
        self.assertEqual(bytes(image.data), bytes((i // 7) % 256 for i in range(1_000_000)))


class Services(Ros2Test):
    """Services and parameters."""

    def test_a_service_answers(self):
        self.peer()
        client = self.client()
        for number in range(20):
            answer = client.call(AddModel, "/test/AddModel", AddModel.Request(file=f"{number}.yaml"))
            self.assertEqual((answer.success, answer.model, answer.message), (True, f"{number}.yaml", "ok"))

    def test_parameters_are_listed_read_and_set(self):
        self.peer()
        client = self.client()
        events = client.listen(ParameterEvent, "/parameter_events", 10)
        names = ["/test/cutoff_angle", "kind"]
        listed = client.call(ListParameters, "/test/list_parameters", ListParameters.Request())
        self.assertEqual(list(listed.result.names), names)
        request = GetParameters.Request(names=[*names, "unknown"])
        angle, kind, unknown = client.call(GetParameters, "/test/get_parameters", request).values
        self.assertEqual((angle.type, angle.double_value), (ParameterType.PARAMETER_DOUBLE, 0.5))
        self.assertEqual((kind.type, kind.string_value), (ParameterType.PARAMETER_STRING, "spot"))
        self.assertEqual(unknown.type, ParameterType.PARAMETER_NOT_SET)
        types = client.call(GetParameterTypes, "/test/get_parameter_types", GetParameterTypes.Request(names=names))
        self.assertEqual(list(types.types), [3, 4])
        described = client.call(
            DescribeParameters, "/test/describe_parameters", DescribeParameters.Request(names=names)
        )
        self.assertEqual(
            [(item.name, item.read_only) for item in described.descriptors], [(names[0], False), (names[1], True)]
        )

        def value(number):
            return ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=number)

        wanted = [(names[0], 1.25), (names[0], 7.0), (names[1], 1.0), ("unknown", 1.0)]
        parameters = [Parameter(name=name, value=value(number)) for name, number in wanted]
        results = client.call(
            SetParameters, "/test/set_parameters", SetParameters.Request(parameters=parameters)
        ).results
        self.assertEqual([result.successful for result in results], [True, False, False, False])
        self.assertTrue(all(result.reason for result in results[1:]))
        client.wait_for(lambda: [event for event in events if event.node == "/test"], "an event")
        self.assertEqual(events[-1].changed_parameters[0].value.double_value, 1.25)
        both = SetParametersAtomically.Request(parameters=[Parameter(name=names[0], value=value(0.75)), parameters[1]])
        answer = client.call(SetParametersAtomically, "/test/set_parameters_atomically", both)
        self.assertFalse(answer.result.successful)
        [angle] = client.call(GetParameters, "/test/get_parameters", GetParameters.Request(names=names[:1])).values
        self.assertEqual(angle.double_value, 1.25, "nothing has changed")


class Comings(Ros2Test):
    """One of the two comes late, ends, hangs or is killed."""

    def test_late_subscriptions_get_what_is_latched(self):
        self.peer()
        client = self.client()
        states = client.listen(RigidBodyState, "/test/State", MANY)
        client.wait_for(lambda: states, "a state")
        start = time.monotonic()
        latched = client.listen(String, "/test/Latched", LATCHED)
        client.wait_for(lambda: latched, "what is latched")
        print(f"latched message after {time.monotonic() - start:.3f} s")
        self.assertEqual(latched[0].data, "kept")

    def test_a_program_that_is_started_again_is_found_again(self):
        for end in ("end", "kill"):
            with self.subTest(end):
                first, client = self.peer(), self.client(f"client_{end}")
                states = client.listen(RigidBodyState, "/test/State", MANY)
                client.wait_for(lambda states=states: len(states) > 100, "states")
                getattr(first, end)()
                second = self.peer()
                start, before = time.monotonic(), len(states)
                client.wait_for(
                    lambda states=states, before=before: len(states) > before + 6000, "states of the second"
                )
                print(f"after {end}: {len(states) - before} states in {time.monotonic() - start:.1f} s")
                second.end()

    def test_nothing_is_sent_when_the_client_is_gone(self):
        peer, client = self.peer(), self.client()
        states = client.listen(RigidBodyState, "/test/State", MANY)
        client.wait_for(lambda: states, "states")
        self.client("another")
        subscriptions = list(client.node.subscriptions)
        for subscription in subscriptions:
            client.node.destroy_subscription(subscription)

        def stands():
            before = peer.counts()[0]
            time.sleep(0.1)
            return peer.counts()[0] == before

        client.wait_for(stands, "the end of sending")

    def test_a_client_that_hangs_does_not_starve_others(self):
        peer, client = self.peer(), self.client()
        code = "import rclpy, ambf_msgs.msg as m; rclpy.init(); n = rclpy.create_node('hung');"
        code += "n.create_subscription(m.RigidBodyState, '/test/State', lambda _: print(flush=True), 10); rclpy.spin(n)"
        hung = subprocess.Popen([sys.executable, "-c", code], env=environment(self.domain), stdout=subprocess.PIPE)
        self.addCleanup(hung.stdout.close)
        self.addCleanup(hung.wait)
        self.addCleanup(hung.kill)
        arrivals = []
        client.node.create_subscription(
            RigidBodyState, "/test/State", lambda _: arrivals.append(time.monotonic()), MANY
        )
        hung.stdout.readline()
        hung.send_signal(signal.SIGSTOP)
        # Longer than twice the window of 8192 messages at 1 kHz.
        client.wait_for(lambda: len(arrivals) > 20_000, "states", 3 * PATIENCE_S)
        longest = max(later - earlier for earlier, later in zip(arrivals, arrivals[1:]))
        _, unsent, _, _ = peer.counts()
        print(f"{len(arrivals)} states beside a client that hangs, {unsent} lost, longest pause {longest:.2f} s")
        self.assertLess(longest, 10.0, "others waited until the hung one was given up")
