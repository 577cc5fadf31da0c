"""Clients that misbehave don't disturb the others."""

import os
import signal

import harness
import node
import rospy
import tcpros
from ambf_msgs.msg import RigidBodyState
from scenes import WORLD

BODY = "/ambf/env/Base"
TOPIC = f"{BODY}/State"


class Crowd(harness.RosTest):
    """One simulator that publishes fast, so that buffers fill soon."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        node.start(cls.port)
        cls.simulator = harness.Simulator(
            cls.port, "--launch_file", harness.scene / "launch.yaml", "-l0", "--override_min_comm_freq", "1000"
        )
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
            self.assertGreater(other.rate(), 100.0)

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
