"""Scripts written for client 2.0 in scenes for 3.0, scripts for client 3.0, and the messages that 3.0 added."""

import sys
import threading
import time

import harness
import jaws
import rospy
import support
from ambf_client import Client, ContactSensor, GhostObject, SimulationLost
from ambf_msgs.msg import RigidBodyState
from ambf_msgs.srv import Step
from ros_abstraction_layer import ral

BODIES = "/ambf/env/BODY"


def setUpModule():
    """One simulator, and one client for the tests that need one."""
    global MASTER, SIMULATOR, CLIENT
    MASTER = harness.Master()
    support.use_master(MASTER.port)
    files = jaws.write(harness.folder)
    launch = ("--launch_file", support.RESOURCES / "launch.yaml", "-a", ",".join(map(str, files)))
    SIMULATOR = harness.Simulator(MASTER.port, "-t", "1", *launch).wait_for_topics("/ambf/env/World/State")
    CLIENT = Client("tests", 5)
    CLIENT.connect(timeout=30)


def tearDownModule():
    """The master ends last."""
    CLIENT.clean_up()
    rospy.signal_shutdown("done")
    SIMULATOR.stop()
    SIMULATOR.check_log()
    MASTER.stop()


class Scripts(support.TimedTest):
    """Programs as users write them."""

    def run_script(self, program):
        """It ends well; what it printed."""
        with program:
            self.assertEqual(program.status(), 0, program.log())
            return program.log()

    def test_names_in_a_script_for_2(self):
        """It knows no ghosts: a body is found by a part of its name that a ghost has too; two bodies are as ambiguous as ever."""
        text = """
import time
from ambf_client import Client
c = Client('usage_2_0')
c.connect()
time.sleep(0.3)
entry = c.get_obj_handle('Entry1')
assert entry is not None and entry.object_type == 'RIGID_BODY', entry
assert c.get_obj_handle('Exit1') is None
assert c.get_obj_handle('/ambf/env/Exit1').object_type == 'RIGID_BODY'
entry.set_pos(1, 0, -0.8)
end = time.time() + 30
while abs(entry.get_pos().z + 0.8) > 1e-4 and time.time() < end:
    time.sleep(0.01)
assert abs(entry.get_pose()[2] + 0.8) < 1e-4
c.get_world_handle().reset_bodies()
time.sleep(0.3)
c.clean_up()
print('cleaned up', flush=True)
"""
        self.assertIn("cleaned up", self.run_script(support.script(MASTER.port, text)))
        self.assertIsInstance(CLIENT.get_obj_handle("ghostEntry1"), GhostObject)

    def test_a_grasp_in_a_script_for_3(self):
        """The ghosts in the jaws say what lies between them, the actuator holds it by that name, and lets go."""
        path = harness.REPOSITORY / "python/tests/usage_3_0.py"
        log = self.run_script(harness.Program([sys.executable, "-u", path], harness.environment(MASTER.port)))
        self.assertIn("cleaned up", log)


class States(support.TimedTest):
    """Ghosts and contact sensors."""

    def test_contacts(self):
        """Who touches, and where if the sensor says so; over topics and in steps."""
        scale, feeler = CLIENT.get_obj_handle("scale"), CLIENT.get_obj_handle("feeler")
        self.assertIsInstance(scale, ContactSensor)
        # After a reset by another test the cup has to come to rest.
        scale.wait_for_step(scale.get_sim_step() + 1000, 30.0)
        state = scale.wait_for_state(lambda state: state.contact_events, 30.0)
        self.assertEqual((state.type.data, state.parent_name.data), ("CONTACT", "BODY table"))
        scale.wait_for_state(lambda state: len(state.contact_events) == 1 and state.contact_events[0].contact_data)
        feeler.wait_for_state(lambda state: len(state.contact_events) == 1)
        world = CLIENT.get_world_handle()
        zone = CLIENT.get_obj_handle("ghostEntry1")
        cup = CLIENT.get_obj_handle("cup")
        # In `legacy` a box at rest rises by 10 um once in some 40 steps, and for one of them it does not touch.
        for _ in range(10):
            result = world.step(5, observe=[zone, scale, cup, feeler], patience=60.0)
            if scale.get_num_contact_events():
                break
        self.assertEqual({handle.get_sim_step() for handle in (zone, scale, cup, feeler)}, {result.sim_step})
        self.assertEqual((scale.get_num_contact_events(), scale.get_contact_object_name(1)), (1, None))
        for sensor in (scale, feeler):
            self.assertEqual(sensor.get_contact_object_name(0), f"{BODIES} cup")
        self.assertEqual((zone.get_num_sensed_obj(), zone.get_pose()[0]), (0, 1.0))
        event = scale.get_contact_event(0)
        for data in event.contact_data:
            self.assertLess(abs(data.distance.data), 0.01)
            # From the cup down to the table.
            self.assertAlmostEqual(data.contact_normal.z, -1.0, places=3)
            self.assertAlmostEqual(data.contact_point.z, -0.95, delta=0.01)
        self.assertEqual(feeler.get_contact_event(0).contact_data, [])
        world.step(0, patience=0.01)

    def test_the_layer(self):
        """Topics, services and times, below a namespace."""
        layer = CLIENT.get_ral()
        self.assertIs(CLIENT.get_ral(), layer)
        self.assertEqual(ral.ros_version(), 1)
        child = ral("other").create_child("/ambf/env")
        self.assertIn(["/ambf/env/Needle/State", "ambf_msgs/RigidBodyState"], layer.get_published_topics())
        heard = threading.Event()
        stamps = []

        def hear(state):
            stamps.append(child.to_sec(state))
            heard.set()

        subscriber = child.subscriber("Needle/State", RigidBodyState, hear, latch=True)
        self.addCleanup(subscriber.unregister)
        child.spin()
        self.assertTrue(heard.wait(30.0))
        self.assertLess(abs(layer.to_sec(layer.now()) - stamps[-1]), 30.0)
        self.assertLess(abs(CLIENT.get_time() - stamps[-1]), 30.0)
        answer = child.service_client("World/step", Step)(steps=0, patience=0.01)
        self.assertTrue(answer.success, answer.message)
        publisher = child.publisher("Needle/Echo", RigidBodyState, latch=True)
        self.addCleanup(publisher.unregister)
        harness.wait_for(lambda: "/ambf/env/Needle/Echo" in harness.published(MASTER.port), "it is published")
        self.assertFalse(layer.is_shutdown() or CLIENT.is_shutdown())


class Lost(support.TimedTest):
    """A simulation whose state became non-finite."""

    def test_a_script_notices(self):
        """Its next look raises, and so do its waits; after a reset it goes on."""
        needle, world = CLIENT.get_obj_handle("Needle"), CLIENT.get_world_handle()
        with self.assertRaisesRegex(SimulationLost, "^lost at step [0-9]+: .*reset resumes"):
            end = time.monotonic() + 60.0
            while time.monotonic() < end:
                needle.wrench_command(1e300, 0, 0, 1e300, 0, 0)
                needle.get_pos()
                time.sleep(0.01)
        needle.set_force(0, 0, 0)
        needle.set_torque(0, 0, 0)
        self.assertRaises(SimulationLost, needle.wait_for_step, 2**31, 30.0)
        self.assertRaises(SimulationLost, world.update)
        with self.assertRaisesRegex(SimulationLost, "^lost at step"):
            world.step(1, patience=0.01)
        # The zero wrench has to be there before the physics goes on.
        time.sleep(0.2)
        world.reset()
        needle.wait_for_step(world.get_sim_step() + 100, 30.0)
        self.assertAlmostEqual(needle.get_pos().z, -1.48, delta=0.01)
        self.assertEqual(world._state.header.frame_id, "")
