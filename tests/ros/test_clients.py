"""Clients that misbehave don't disturb the others."""

import contextlib
import io
import os
import re
import signal
import struct

import genpy.dynamic
import harness
import node
import rospy
import tcpros
from ambf_msgs.msg import RigidBodyCmd, RigidBodyState
from scenes import WORLD
from std_msgs.msg import Empty

BODY = "/ambf/env/Base"
TOPIC = f"{BODY}/State"


class Bytes(RigidBodyCmd):
    """Claims to be a command and sends any bytes."""

    def __init__(self, data=b""):
        super().__init__()
        self._data = data

    def serialize(self, buff):
        """Writes the bytes as they are."""
        buff.write(self._data)


class Crowd(harness.RosTest):
    """One simulator that publishes fast, so that buffers fill soon."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        node.start(cls.port)
        arguments = ("--launch_file", harness.scene / "launch.yaml", "-l0", "--override_min_comm_freq", "1000")
        # As on a small computer.
        cls.simulator = harness.Simulator(cls.port, *arguments, address_space=8 << 30)
        cls.simulator.wait_for_topics(TOPIC, f"{WORLD}/State")

    @classmethod
    def tearDownClass(cls):
        rospy.signal_shutdown("done")
        cls.simulator.stop()
        super().tearDownClass()

    def tearDown(self):
        self.assertTrue(self.simulator.running())
        self.simulator.check_log()

    def test_a_client_that_never_reads(self):
        """When its buffers are full, the topic's other subscribers still get everything."""
        with node.Listener(TOPIC, RigidBodyState) as other:
            other.newest()
            hanging = tcpros.subscribe(tcpros.publisher_address(self.port, TOPIC), TOPIC, "hanging", buffer_bytes=2048)
            self.addCleanup(hanging.close)
            fill = []

            def full_or_closed():
                fill.append(tcpros.unsent_bytes(hanging))
                arrived = other.newest().header.seq
                other.until(lambda state: state.header.seq > arrived + 500, "the other subscriber goes on")
                now = tcpros.unsent_bytes(hanging)
                return now is None or (now > 0 and now == fill[-1])

            harness.wait_for(full_or_closed, "the hanging client's buffers are full", 240.0)
            # Long after the first write could not be done any more.
            arrived = other.newest().header.seq
            other.until(lambda state: state.header.seq > arrived + 5000, "the other subscriber goes on")
            harness.wait_for(lambda: other.rate() > 100.0, "more than 100 Hz")

    def test_a_stopped_program(self):
        """The same with a real client that is frozen, wakes up and goes on."""
        with node.Listener(TOPIC, RigidBodyState) as other, harness.Program(
            ["rostopic", "echo", "--noarr", f"{TOPIC}/header/seq"], harness.environment(self.port)
        ) as tool:
            harness.wait_for(tool.log, "rostopic prints")
            os.kill(tool.process.pid, signal.SIGSTOP)
            arrived = other.newest().header.seq
            other.until(lambda state: state.header.seq > arrived + 5000, "the other subscriber goes on")
            os.kill(tool.process.pid, signal.SIGCONT)
            self.assertTrue(tool.running())

    def test_messages_that_are_none(self):
        """Bytes that are too short, or announce more than follows, are no command and do no harm."""
        sound = io.BytesIO()
        RigidBodyCmd(joint_cmds=[0.0]).serialize(sound)
        sound = sound.getvalue()
        # Header, type, pose, wrench and twist come before the two arrays.
        arrays = 16 + 1 + 56 + 48 + 48
        huge = struct.pack("<I", 0xFFFFFFFF)
        broken = [b"", b"\0" * 10, sound[:-1], huge * 4, sound[:arrays] + huge + sound[arrays + 4 :]]
        broken += [sound[: arrays + 4] + huge + sound[arrays + 8 :], sound[:12] + huge + sound[16:], sound + b"more"]
        publisher = rospy.Publisher(f"{BODY}/Command", Bytes, queue_size=len(broken))
        self.addCleanup(publisher.unregister)
        harness.wait_for(publisher.get_num_connections, "the simulator listens")
        with node.Listener(TOPIC, RigidBodyState) as state:
            for data in broken:
                publisher.publish(Bytes(data))
                seen = state.newest().header.seq
                state.until(lambda state, seen=seen: state.header.seq > seen + 50, "states go on")
                self.assertTrue(self.simulator.running(), self.simulator.log())
            self.assertIn("are not a ambf_msgs/RigidBodyCmd", self.simulator.log())
            command = RigidBodyCmd(joint_cmds=[0.3], joint_cmds_types=[RigidBodyCmd.TYPE_POSITION])
            with node.Stream(f"{BODY}/Command", command):
                state.until(lambda state: abs(state.joint_positions[0] - 0.3) < 0.05, "the joint obeys")

    def test_wrong_types(self):
        """Clients with another message under the same name are not connected, and the simulator says so once it knows."""
        publisher = rospy.Publisher("/ambf/env/Link/Command", Empty, queue_size=1)
        self.addCleanup(publisher.unregister)
        subscriber = rospy.Subscriber(TOPIC, Empty, self.fail)
        self.addCleanup(subscriber.unregister)
        for reason in (f"{TOPIC}.*mismatched.*version of the message", "/ambf/env/Link/Command: .*refuses us.*types do not match"):
            harness.wait_for(lambda reason=reason: re.search(reason, self.simulator.log()), reason)
        self.assertEqual(publisher.get_num_connections(), 0)

    def test_definition_in_the_header(self):
        """Tools that record or decode without our package get the whole definition."""
        with contextlib.closing(tcpros.subscribe(tcpros.publisher_address(self.port, TOPIC), TOPIC, "reader")) as raw:
            kind, definition = raw.fields["type"], raw.fields["message_definition"]
            classes = genpy.dynamic.generate_dynamic(kind, definition)
            state = classes[kind]()
            state.deserialize(tcpros.read_block(raw))
            self.assertEqual((state.name.data, classes[kind]._md5sum), ("Base", RigidBodyState._md5sum))

    def test_five_hundred_come_and_go(self):
        """Each gets a state; afterwards nothing of them is left in the simulator."""
        files = f"/proc/{self.simulator.process.pid}/fd"
        before = len(os.listdir(files))
        with node.Listener(TOPIC, RigidBodyState) as other:
            other.newest()
            for batch in range(10):
                address = tcpros.publisher_address(self.port, TOPIC)
                clients = [tcpros.subscribe(address, TOPIC, f"crowd_{batch}_{i}") for i in range(50)]
                for client in clients:
                    self.assertGreater(len(tcpros.read_block(client)), 100)
                for client in clients:
                    client.close()
            other.next()
            harness.wait_for(lambda: len(os.listdir(files)) <= before + 20, "their sockets are closed")
