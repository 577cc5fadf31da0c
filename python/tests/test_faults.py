"""What can go wrong between a client and the simulator: each has its error, in time."""

import os
import pathlib
import signal
import time

import harness
import rospy
import support
from ambf_client import Client, MasterNotFound, SimulationLost, SimulatorNotFound, SimulatorTimeout


class NoMaster(support.TimedTest):
    """Before there is a node in this process."""

    def test_nobody_answers(self):
        """An error that names the address, within the time-out."""
        port = harness.free_port()
        support.use_master(port)
        with self.within(5.0), self.assertRaisesRegex(MasterNotFound, str(port)):
            Client("tests").connect(timeout=0.5)

    def test_somebody_else_answers_late(self):
        """A server that takes connections but says nothing is no master."""
        import socket

        with socket.create_server(("localhost", 0)) as server:
            support.use_master(server.getsockname()[1])
            with self.within(10.0), self.assertRaises(MasterNotFound):
                Client("tests").connect(timeout=0.5)


class WithMaster(support.TimedTest):
    """The tests share a master; each has its own simulator."""

    @classmethod
    def setUpClass(cls):
        cls.master = harness.Master()
        support.use_master(cls.master.port)

    @classmethod
    def tearDownClass(cls):
        rospy.signal_shutdown("done")
        cls.master.stop()

    def test_a_no_simulator(self):
        """An error that says so, within the time-out."""
        with self.within(6.0), self.assertRaisesRegex(SimulatorNotFound, "no simulator has published a world"):
            Client("tests").connect(timeout=1.0)

    def start(self):
        """A simulator, and a client of it."""
        simulator = support.simulator(self.master.port, ["arm7"])
        self.addCleanup(simulator.stop)
        client = Client("tests")
        client.connect(timeout=30)
        self.addCleanup(client.clean_up)
        return simulator, client

    def test_b_a_simulator_that_is_killed(self):
        """Steps and waits end with an error; a new client says that there is only a registration."""
        simulator, client = self.start()
        world, body = client.get_world_handle(), client.get_obj_handle("arm7/flange")
        world.step(10, observe=[body], patience=60.0)
        simulator.kill()
        with self.within(5.0), self.assertRaises(SimulatorTimeout):
            world.step(10, observe=[body], patience=60.0)
        with self.within(5.0), self.assertRaises(SimulatorTimeout):
            body.wait_for_step(2**31, 0.5)
        with self.within(10.0), self.assertRaisesRegex(SimulatorNotFound, "is registered|no simulator"):
            Client("tests").connect(timeout=1.0)

    def test_c_a_simulator_that_hangs(self):
        """The time-out of a step ends it."""
        simulator, client = self.start()
        world = client.get_world_handle()
        world.step(1, patience=60.0)
        os.kill(simulator.process.pid, signal.SIGSTOP)
        try:
            status = pathlib.Path(f"/proc/{simulator.process.pid}/stat")
            harness.wait_for(lambda: status.read_text().rsplit(")", 1)[1].split()[0] == "T", "it is stopped")
            with self.within(5.0), self.assertRaises(SimulatorTimeout):
                world.step(1, patience=60.0, timeout=0.5)
        finally:
            os.kill(simulator.process.pid, signal.SIGCONT)
        world.step(1)

    def test_d_a_client_that_throttles_and_dies(self):
        """The simulator runs on by itself."""
        by_topics = """
import time
from ambf_client import Client
c = Client('stepper', anonymous=True); c.connect()
w = c.get_world_handle()
w.enable_throttling(True); w.set_num_step_skips(1)
while True:
    w.update()
    print('steps', flush=True)
    time.sleep(0.05)
"""
        by_steps = """
from ambf_client import Client
import time
c = Client('stepper', anonymous=True); c.connect()
while True:
    c.get_world_handle().step(1, patience=2.0)
    print('steps', flush=True)
    time.sleep(0.05)
"""
        _, client = self.start()
        world = client.get_world_handle()
        for name, text in (("topics", by_topics), ("steps", by_steps)):
            with self.subTest(name), support.script(self.master.port, text) as program:
                harness.wait_for(lambda program=program: program.log().count("steps") > 20, "it steps")

                def held():
                    before = world.get_sim_step()
                    time.sleep(0.5)
                    return world.get_sim_step() < before + 100

                harness.wait_for(held, "the client holds the physics")
                program.kill()
                world.wait_for_step(world.get_sim_step() + 1000, 30.0)

    def test_e_a_client_that_thinks_for_long(self):
        """While it does, within its patience, nothing moves; and within a step no command ends, however long that takes."""
        _, client = self.start()
        world, base = client.get_world_handle(), client.get_obj_handle("arm7/base")
        client._stop.set()  # nothing is published meanwhile
        base.set_joint_pos("shoulder", 0.6)
        at = world.step(200, [base], [base], patience=60.0).sim_step
        time.sleep(1.5)
        begin = time.monotonic()
        result = world.step(100_000, [base], [base], patience=60.0, timeout=60.0)
        self.assertEqual(result.sim_step, at + 100_000)
        self.assertGreater(time.monotonic() - begin, 0.6, "longer than the watchdog's time")
        # Without its command it would have returned to 0.3 rad.
        self.assertAlmostEqual(base.get_joint_pos("shoulder"), 0.58, delta=0.02)

    def test_f_a_state_that_is_lost(self):
        """The step says so, reading too; a step with a reset resumes."""
        _, client = self.start()
        world, hand = client.get_world_handle(), client.get_obj_handle("arm7/hand")
        world.step(1, patience=60.0)
        hand.wrench_command(1e300, 0, 0, 1e300, 0, 0)
        with self.assertRaisesRegex(SimulationLost, "^lost at step [0-9]+: .*reset resumes"):
            for _ in range(5):
                world.step(10, [hand], [hand], patience=60.0)
        self.assertRaises(SimulationLost, hand.get_pos)
        hand.wrench_command(0, 0, 0, 0, 0, 0)
        result = world.step(10, [hand], [hand], reset=True, patience=60.0)
        self.assertAlmostEqual(result.states[hand.get_name()].pose.position.z, -0.859, places=2)
        self.assertAlmostEqual(hand.get_pos().z, -0.859, places=2)
