"""The client against a simulator: scripts as they always were, and what is new."""

import math
import sys
import time

import harness
import rospy
import support
from ambf_client import (
    Actuator,
    Client,
    GhostObject,
    Light,
    ObjectNotFound,
    RigidBody,
    Sensor,
    SoftBody,
    StepRefused,
    Vehicle,
)
from ambf_env import AmbfEnv
from ambf_msgs.srv import AddModel

MODELS = ("arm7", "gripper", "free_bodies", "cloth", "ghost", "car")
# Commands that stop coming end after so long, s.
WATCHDOG_S = 0.5
MASTER = None
CLIENT = None


def setUpModule():
    """One simulator with a bit of everything, and one client, for all tests."""
    global MASTER, SIMULATOR, CLIENT  # pylint: disable=global-statement
    MASTER = harness.Master()
    support.use_master(MASTER.port)
    SIMULATOR = support.simulator(MASTER.port, MODELS)
    CLIENT = Client("tests")
    CLIENT.connect(timeout=30)


def tearDownModule():
    """The master ends last."""
    CLIENT.clean_up()
    rospy.signal_shutdown("done")
    SIMULATOR.stop()
    SIMULATOR.check_log()
    MASTER.stop()


class AsEver(support.TimedTest):
    """Programs as users write them."""

    def test_the_way_of_use_of_the_original(self):
        """It finds objects, sets pose, force and joint commands, reads back and cleans up."""
        path = harness.REPOSITORY / "python/tests/original_usage.py"
        with harness.Program([sys.executable, "-u", path], harness.environment(MASTER.port)) as program:
            self.assertEqual(program.status(), 0, program.log())
            self.assertIn("cleaned up", program.log())
        CLIENT.get_world_handle().reset()

    def test_a_script_without_sleeps(self):
        """Everything is there when `connect` and `get_obj_handle` return; the end of the block cleans up."""
        text = """
from ambf_client import Client
with Client('no_sleeps') as c:
    base = c.get_obj_handle('arm7/base')
    assert base.get_num_joints() == 7, base.get_num_joints()
    assert len(base.get_joint_names()) == 7 and len(base.get_children_names()) == 7
    assert c.get_obj_handle('Capsule').get_pose()[:3] != [0, 0, 0]
    assert c.get_world_handle().get_sim_time() > 0
    c.get_world_handle().reset()
assert c.get_obj_names() == []
"""
        with support.script(MASTER.port, text) as program:
            self.assertEqual(program.status(), 0, program.log())


class Objects(support.TimedTest):
    """Finding and driving objects."""

    def test_types(self):
        """Each has the class of its messages, ours among them."""
        expected = {
            "arm7/base": RigidBody,
            "gripper/proximity": Sensor,
            "gripper/holder": Actuator,
            "key_light": Light,
        }
        for name, kind in expected.items():
            self.assertIsInstance(CLIENT.get_obj_handle(name), kind)
        kinds = {type(handle) for handle in CLIENT._objects.values()}
        self.assertTrue({SoftBody, GhostObject, Vehicle} <= kinds, kinds)
        cloth = next(handle for handle in CLIENT._objects.values() if isinstance(handle, SoftBody))
        self.assertGreater(cloth.get_num_nodes(), 3)
        self.assertTrue(all(math.isfinite(x) for node in cloth.get_nodes() for x in node))

    def test_names(self):
        """Exact, part of a name, several, none; the world."""
        with support.quiet() as said:
            self.assertIsNone(CLIENT.get_obj_handle("arm7/"))
            self.assertIsNone(CLIENT.get_obj_handle("no such thing"))
        self.assertIn("several objects", said.getvalue())
        self.assertIs(CLIENT.get_obj_handle("/ambf/env/Sphere"), CLIENT.get_obj_handle("env/Sphere"))
        self.assertIs(CLIENT.get_obj_handle("World"), CLIENT.get_world_handle())
        self.assertFalse(CLIENT.get_world_handle().is_active())
        self.assertTrue(CLIENT.get_common_namespace().startswith("/ambf/env/"))
        self.assertIn("World", CLIENT.get_obj_names())
        self.assertEqual(len(CLIENT.get_obj_pose("Plane")), 6)

    def test_objects_that_come_later(self):
        """`wait_for_object` finds them; what never comes is an error in time."""
        with self.within(3.0), self.assertRaises(ObjectNotFound):
            CLIENT.wait_for_object("arm7_of_another", timeout=0.5)
        rospy.wait_for_service("/ambf/env/World/add_model", timeout=harness.PATIENCE_S)
        add = rospy.ServiceProxy("/ambf/env/World/add_model", AddModel)
        answer = add(str(support.RESOURCES / "models/pendulum.yaml"))
        self.assertTrue(answer.success, answer.message)
        before = set(CLIENT.get_obj_names())
        harness.wait_for(lambda: CLIENT._find() and set(CLIENT.get_obj_names()) - before, "handles of the new model")
        new = sorted(set(CLIENT.get_obj_names()) - before)[0]
        self.assertEqual(CLIENT.wait_for_object(new).get_name(), new)

    def test_a_grasp(self):
        """The actuator holds what the sensor sees, and lets go."""
        holder = CLIENT.get_obj_handle("gripper/holder")
        holder.actuate_from_sensor_data("SENSOR proximity")
        holder.wait_for_state(lambda state: state.actuated)
        holder.deactuate()
        holder.wait_for_state(lambda state: not state.actuated)

    def test_a_light_and_a_camera_move(self):
        """Their poses are set."""
        for name in ("key_light", "main_camera"):
            handle = CLIENT.get_obj_handle(name)
            handle.set_pos(0.5, 0.25, 2.0)
            handle.wait_for_state(lambda state: abs(state.pose.position.x - 0.5) < 1e-6)

    def test_two_clients_drive_one_body(self):
        """The body follows now one, now the other; neither is disturbed, and the second's end leaves the first in charge."""
        palm = CLIENT.get_obj_handle("gripper/palm")
        palm.set_pos(5, 0, -0.8)
        palm.wait_for_state(lambda state: abs(state.pose.position.z + 0.8) < 1e-6)
        text = """
from ambf_client import Client
c = Client('second'); c.connect()
palm = c.get_obj_handle('gripper/palm')
palm.set_pos(5, 0, -0.7)
palm.wait_for_state(lambda state: abs(state.pose.position.z + 0.7) < 1e-6)
palm.wait_for_state(lambda state: abs(state.pose.position.z + 0.8) < 1e-6)
print('both', flush=True)
"""
        with support.script(MASTER.port, text) as program:
            self.assertEqual(program.status(), 0, program.log())
        palm.wait_for_state(lambda state: abs(state.pose.position.z + 0.8) < 1e-6)
        time.sleep(0.2)
        self.assertAlmostEqual(palm.get_pos().z, -0.8)
        palm.set_pos(5, 0, -1.0)


class Watchdogs(support.TimedTest):
    """Clients that stop."""

    FORCE = """
import sys, time
from ambf_client import Client
c = Client('pusher', anonymous=True); c.connect()
box = c.get_obj_handle('/ambf/env/Cylinder')
print('pushes', flush=True)
while True:
    if sys.argv[1] == 'force':
        box.set_force(0, 0, 30)
    else:
        box.set_linear_vel(0, 0, 1.0)
    time.sleep(0.01)
"""

    def check_release(self, what, is_driven):
        """A driver that is killed is forgotten 0.5 s later; nobody else drives the body.

        Returns how long it takes until the body falls, s: at most that much of the clock, at least that much of simulated time."""
        ball = CLIENT._objects["/ambf/env/Cylinder"]
        CLIENT.get_world_handle().reset()
        ball.wait_for_state(lambda state: state.twist.linear.z < 0.0)
        with support.script(MASTER.port, self.FORCE, what) as program:
            driven = ball.wait_for_state(is_driven, 30.0).sim_time
            begin = time.monotonic()
            program.kill()
            killed = ball.wait_for_state(lambda state: state.sim_time > driven).sim_time
        # It falls: its speed grows downwards.
        fallen = ball.wait_for_state(lambda state: state.twist.linear.z < -0.2, 30.0).sim_time
        return time.monotonic() - begin, fallen - killed

    def test_a_force(self):
        """It ends, and the ball falls again. It was rising at 1 … 10 m/s when the force ended."""
        self.check_release("force", lambda state: state.twist.linear.z > 1.0)

    def test_a_velocity(self):
        """It was held exactly; then the ball falls after the watchdog's period, not before."""
        at_most, at_least = self.check_release("velocity", lambda state: abs(state.twist.linear.z - 1.0) < 0.05)
        # 0.12 s of free fall from 1 m/s upwards come on top.
        self.assertLess(at_least, 2.5)
        self.assertGreater(at_most, 0.3)


class Stepping(support.TimedTest):
    """The physics waits for the client."""

    def setUp(self):
        self.world = CLIENT.get_world_handle()
        self.body = CLIENT.get_obj_handle("gripper/palm")
        self.addCleanup(self.run_freely)

    def run_freely(self):
        """Ends throttling."""
        self.world.enable_throttling(False)
        self.world.update()
        step = self.world.get_sim_step()
        self.world.wait_for_step(step + 100, 30.0)

    def test_updates_make_exact_steps(self):
        """Each clock edge makes as many iterations as asked for, and no more."""
        self.world.enable_throttling(True)
        self.world.set_num_step_skips(3)
        # Where the machine is so busy that the watchdog strikes between two edges, physics runs freely: that run does not count.
        for _ in range(10):
            self.world.update()
            harness.wait_for(self.is_held, "the physics waits")
            step, pause, last = self.body.get_sim_step(), 0.0, time.monotonic()
            seen = []
            for count in range(1, 101):
                self.world.update()
                now = time.monotonic()
                pause, last = max(pause, now - last), now
                seen.append(self.body.wait_for_step(step + 3 * count, 30.0))
            time.sleep(0.1)
            pause = max(pause, time.monotonic() - last)
            if pause < WATCHDOG_S / 2:
                break
        self.assertEqual(seen, list(range(step + 3, step + 301, 3)))
        self.assertEqual(self.body.get_sim_step(), step + 300)

    def is_held(self):
        """Whether no step is made for a while; keeps throttling alive."""
        self.world.run_publisher()
        before = self.body.get_sim_step()
        time.sleep(0.1)
        return self.body.get_sim_step() == before

    def test_the_environment_of_the_original(self):
        """Its class and its results are as they were: four things, thirteen numbers."""
        env = AmbfEnv(base_name="Plane")
        self.addCleanup(env.ambf_client.clean_up)
        with self.assertRaises(ObjectNotFound):
            env.step([0.0] * 7)
        env.make("gripper/palm")
        self.assertEqual(env.reset().shape, (13,))
        state, reward, done, info = env.step([5.0, 0.0, -0.9, 0.0, 0.0, 0.0, 0.0])
        self.assertEqual((state.shape, done, info), ((13,), False, {}))
        self.assertGreaterEqual(state[12], 5.0)
        self.assertTrue(math.isfinite(reward))
        self.assertRaises(ValueError, env.step, [0.0] * 6)
        env.set_throttling_enable(False)
        env.world_handle.update()

    def test_steps_make_exact_steps(self):
        """States come with the answer; commands act at once."""
        at = self.world.step(0, patience=60.0).sim_step
        for steps in (1, 1, 10, 250, 2):
            result = self.world.step(steps, observe=[self.body], patience=60.0)
            at += steps
            self.assertEqual((result.sim_step, self.body.get_sim_step()), (at, at))
        self.body.set_pos(5, 0, -0.85)
        state = self.world.step(3, [self.body], [self.body], patience=60.0).states[self.body.get_name()]
        self.assertAlmostEqual(state.pose.position.z, -0.85)
        result = self.world.step(1, [self.body], [self.body], reset=True, patience=60.0)
        self.assertEqual(result.sim_step, at + 4)

    def test_a_step_that_is_refused_moves_nothing(self):
        """The reason is told."""
        at = self.world.step(0, patience=60.0).sim_step
        self.body._cmd.wrench.force.x = math.nan
        with self.assertRaisesRegex(StepRefused, "not finite"):
            self.world.step(10, [self.body], patience=60.0)
        self.body._cmd.wrench.force.x = 0.0
        with self.assertRaisesRegex(StepRefused, "patience"):
            self.world.step(10, patience=-1.0)
        self.assertEqual(self.world.step(1, patience=60.0).sim_step, at + 1)

    def test_patience_ends(self):
        """Without further steps the physics runs freely after that time."""
        begin = time.monotonic()
        at = self.world.step(1, patience=1.0).sim_step
        self.world.wait_for_step(at + 10, 30.0)
        self.assertGreater(time.monotonic() - begin, 1.0)
