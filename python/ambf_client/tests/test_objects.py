"""Handles without a simulator: what setters make of commands, what getters make of states."""

import contextlib
import importlib
import io
import math
import threading
import time
import types
import unittest

import versions
from ambf_client import (
    Actuator,
    BaseObject,
    Camera,
    Client,
    ContactSensor,
    GhostObject,
    Object,
    RigidBody,
    Sensor,
    SoftBody,
    Vehicle,
    WatchDog,
    World,
)
from ambf_client.base_object import quaternion
from ambf_client.errors import SimulationLost, SimulatorNotFound, StepRefused, UnsupportedCommand
from ambf_client.ros_abstraction_layer import ral
from ambf_client.rotations import QuaternionLike, quaternion_from_rpy, quaternion_from_zyx, rpy_from_quaternion
from ambf_msgs.msg import (
    ContactData,
    ContactEvent,
    ContactSensorState,
    GhostObjectState,
    RigidBodyCmd,
    RigidBodyState,
    SensorState,
    SoftBodyState,
    VehicleState,
    WorldState,
)
from geometry_msgs.msg import Pose, Quaternion
from std_msgs.msg import String

FORCE, POSITION, VELOCITY = RigidBodyCmd.TYPE_FORCE, RigidBodyCmd.TYPE_POSITION, RigidBodyCmd.TYPE_VELOCITY


setUpModule = versions.set_up


def body(joints=4):
    """A body with so many joints."""
    handle = RigidBody("/ambf/env/box")
    state = RigidBodyState()
    state.joint_names = [f"j{i}" for i in range(joints)]
    state.joint_positions = [0.1 * i for i in range(joints)]
    state.pose.position.x, state.pose.orientation.w = 3.0, 1.0
    handle.ros_cb(state)
    return handle


def quiet():
    """Catches what is said to the user."""
    return contextlib.redirect_stderr(io.StringIO())


class Rotations(unittest.TestCase):
    """Angles and quaternions."""

    def test_there_and_back(self):
        """Angles come back, in any octant."""
        for rpy in ((0.1, -0.2, 0.3), (-3.0, 1.5, 2.5), (1.0, -1.5, -3.1), (0.0, 0.0, 0.0)):
            found = rpy_from_quaternion(quaternion(quaternion_from_rpy(*rpy)))
            for expected, angle in zip(rpy, found):
                self.assertAlmostEqual(angle, expected, places=12)

    def test_at_the_poles(self):
        """At a pitch of 90° the rotation, not the angles, comes back."""
        for rpy in ((0.4, math.pi / 2, 0.1), (0.4, -math.pi / 2, 0.1)):
            q = quaternion_from_rpy(*rpy)
            again = quaternion_from_rpy(*rpy_from_quaternion(quaternion(q)))
            self.assertAlmostEqual(abs(sum(a * b for a, b in zip(q, again))), 1.0, places=7)

    def test_order(self):
        """x then y then z about fixed axes; the other function z then y then x."""
        half = math.sqrt(0.5)
        for found, expected in zip(quaternion_from_rpy(math.pi / 2, 0, math.pi / 2), (0.5, 0.5, 0.5, 0.5)):
            self.assertAlmostEqual(found, expected)
        for found, expected in zip(quaternion_from_zyx(math.pi / 2, 0, 0), (0, 0, half, half)):
            self.assertAlmostEqual(found, expected)

    def test_no_rotation_at_all(self):
        """The zero quaternion of an empty state is no error."""
        empty: QuaternionLike = Quaternion()
        self.assertEqual(rpy_from_quaternion(empty), (0.0, 0.0, 0.0))


class Bodies(unittest.TestCase):
    """Commands of rigid bodies."""

    def test_joint_commands_only_grow(self):
        """A lower joint leaves the commands of higher ones alone; joints in between are free."""
        handle = body()
        handle.set_joint_pos(2, 0.5)
        self.assertEqual(list(handle._cmd.joint_cmds), [0.0, 0.0, 0.5])
        self.assertEqual(list(handle._cmd.joint_cmds_types), [FORCE, FORCE, POSITION])
        handle.set_joint_vel("j0", 0.25)
        self.assertEqual(list(handle._cmd.joint_cmds), [0.25, 0.0, 0.5])
        self.assertEqual(list(handle._cmd.joint_cmds_types), [VELOCITY, FORCE, POSITION])
        self.assertTrue(handle.resize_joint_cmd_array(1))
        self.assertEqual(len(handle._cmd.joint_cmds), 3)
        with quiet():
            self.assertFalse(handle.resize_joint_cmd_array(5))

    def test_joints_that_are_not_there(self):
        """None or nothing, and a line that says so."""
        handle = body()
        with quiet() as said:
            handle.set_joint_pos("elbow", 1.0)
            handle.set_joint_pos(4, 1.0)
            handle.set_joint_pos(-1, 1.0)
            self.assertIsNone(handle.get_joint_pos("elbow"))
            self.assertIsNone(handle.get_joint_idx_from_name("elbow"))
            self.assertIsNone(handle.get_joint_name_from_idx(9))
            self.assertIsNone(handle.get_joint_vel(0), "the state has no velocities")
        self.assertEqual(list(handle._cmd.joint_cmds), [])
        self.assertIn("elbow", said.getvalue())
        self.assertEqual((handle.get_joint_name_from_idx(1), handle.get_joint_idx_from_name("j1")), ("j1", 1))
        self.assertAlmostEqual(handle.get_joint_pos("j3"), 0.3)

    def test_several_joints(self):
        """Values are addressed by joint if they reach that far, else they are pairs."""
        handle = body()
        handle.set_multiple_joint_pos([0.0, 0.1, 0.2, 0.3], [1, 3])
        self.assertEqual([round(v, 3) for v in handle._cmd.joint_cmds], [0.0, 0.1, 0.0, 0.3])
        handle = body()
        handle.set_multiple_joint_effort([7.0, 8.0], [1, 3])
        self.assertEqual(list(handle._cmd.joint_cmds), [0.0, 7.0, 0.0, 8.0])
        with quiet():
            handle.set_multiple_joint_vel([1.0], [2, 3])
            handle.set_multiple_joint_vel([1.0, 2.0], [2, 4])
            handle.set_multiple_joint_vel([], [])
        self.assertEqual(list(handle._cmd.joint_cmds_types), [FORCE] * 4)

    def test_the_last_cartesian_setter_wins(self):
        """And each keeps the other half."""
        handle = body()
        handle.set_force(1, 2, 3)
        handle.set_torque(4, 5, 6)
        self.assertEqual(
            (handle._cmd.cartesian_cmd_type, handle.get_force_command().y, handle.get_torque_command().z), (FORCE, 2, 6)
        )
        handle.set_linear_vel(1, 0, 0)
        handle.set_angular_vel(0, 0, 2)
        self.assertEqual(handle._cmd.cartesian_cmd_type, VELOCITY)
        self.assertEqual((handle.get_linear_velocity_command().x, handle.get_angular_velocity_command().z), (1, 2))
        handle.velocity_command(1, 2, 3, 4, 5, 6)
        self.assertEqual((handle._cmd.twist.linear.z, handle._cmd.twist.angular.x), (3, 4))
        self.assertEqual(handle.get_pos_command().x, 3.0, "the state's, while no pose is commanded")
        handle.set_rpy(0, 0, math.pi / 2)
        self.assertEqual((handle._cmd.cartesian_cmd_type, handle._cmd.pose.position.x), (POSITION, 3.0))
        handle.set_pos(0, 0, 1)
        self.assertAlmostEqual(handle._cmd.pose.orientation.z, math.sqrt(0.5))

    def test_the_two_pose_commands(self):
        """The old one turns the other way round; joints after it have no effect."""
        old, new = body(), body()
        old.pose_command(1, 2, 3, 0.1, 0.2, 0.3, 9.0)
        new.set_pose_rpy(1, 2, 3, 0.1, 0.2, 0.3)
        self.assertAlmostEqual(new._cmd.pose.orientation.x, quaternion_from_rpy(0.1, 0.2, 0.3)[0])
        self.assertAlmostEqual(old._cmd.pose.orientation.x, quaternion_from_zyx(0.1, 0.2, 0.3)[0])
        self.assertEqual((old._cmd.pose.position.z, list(old._cmd.joint_cmds)), (3.0, []))

    def test_numbers_that_are_none(self):
        """They are refused before they reach the command."""
        handle = body()
        nan_pose = Pose()
        nan_pose.position.x = math.nan
        for attempt in (
            lambda: handle.set_force(math.nan, 0, 0),
            lambda: handle.set_joint_pos(0, math.inf),
            lambda: handle.set_pos(0, -math.inf, 0),
            lambda: handle.set_rot([0, 0, math.nan, 1]),
            lambda: handle.set_rot([0, 0, 1]),
            lambda: handle.set_pose(nan_pose),
            lambda: handle.set_rpy(math.nan, 0, 0),
        ):
            self.assertRaises(ValueError, attempt)
        self.assertEqual((handle._cmd.wrench.force.x, list(handle._cmd.joint_cmds)), (0.0, []))

    def test_the_watchdog_takes_the_wrench_only(self):
        """0.1 s after the last setter; pose, twist and joints stay."""
        handle = body()
        handle.set_twist(handle._cmd.twist)
        handle.set_joint_effort(0, 5.0)
        handle.set_force(1, 2, 3)
        handle.run_publisher()
        self.assertEqual(handle.get_force_command().x, 1)
        handle._watch_dog_deadline -= 1.0
        self.assertTrue(handle.is_wd_expired())
        handle.run_publisher()
        self.assertEqual((handle.get_force_command().x, list(handle._cmd.joint_cmds)), (0.0, [5.0]))
        self.assertTrue(handle.is_wd_expired(), "until the next setter")
        handle.set_force(1, 0, 0)
        self.assertFalse(handle.is_wd_expired())

    def test_states_that_come_late(self):
        """Those before the last step are not taken; those of a simulator that was started again are."""
        handle = body()
        state = RigidBodyState(sim_step=9000)
        handle.take_step(state)
        self.assertEqual(handle.get_joint_names(), ["j0", "j1", "j2", "j3"], "steps bring no names")
        handle.ros_cb(RigidBodyState(sim_step=8999))
        self.assertEqual(handle.get_sim_step(), 9000)
        handle.ros_cb(RigidBodyState(sim_step=1))
        self.assertEqual(handle.get_sim_step(), 1)


class Others(unittest.TestCase):
    """The other types of objects."""

    def test_types(self):
        """Scripts look at them."""
        expected = {
            Actuator: ("ACTUATOR", "KINEMATIC"),
            Camera: ("CAMERA", "KINEMATIC"),
            ContactSensor: ("CONTACT_SENSOR", "KINEMATIC"),
            GhostObject: ("GHOST", "KINEMATIC"),
            Object: ("DEFAULT_OBJECT", "DYNAMIC"),
            RigidBody: ("RIGID_BODY", "DYNAMIC"),
            Sensor: ("SENSOR", "KINEMATIC"),
            SoftBody: ("SOFT_BODY", "DYNAMIC"),
            Vehicle: ("VEHICLE", "DYNAMIC"),
        }
        for kind, names in expected.items():
            handle = kind("/ambf/env/a")
            self.assertIsInstance(handle, BaseObject)
            self.assertEqual((handle.object_type, handle.body_type), names)
            self.assertEqual((handle.get_name(), handle.is_active()), ("/ambf/env/a", False))

    def test_poses_that_can_not_be_commanded(self):
        """A typed error, which is an AttributeError as it always was."""
        for kind in (Actuator, ContactSensor, GhostObject, Sensor, Vehicle, SoftBody):
            handle = kind("/ambf/env/a")
            for attempt in (
                lambda handle=handle: handle.set_pose(Pose()),
                lambda handle=handle: handle.set_pos(1, 2, 3),
                lambda handle=handle: handle.set_rpy(1, 2, 3),
                lambda handle=handle: handle.set_rot([0, 0, 0, 1]),
            ):
                with self.subTest(kind.__name__):
                    self.assertRaises(UnsupportedCommand, attempt)
        self.assertTrue(issubclass(UnsupportedCommand, AttributeError))
        camera = Camera("/ambf/env/cam")
        camera.set_pos(1, 2, 3)
        self.assertTrue(camera._cmd.enable_position_controller)

    def test_sensor(self):
        """Rays by index; None where there is none."""
        sensor = Sensor("/ambf/env/eye")
        seen = [String(data="box"), String(data="")]
        sensor.ros_cb(
            SensorState(count=2, triggered=[True, False], range=[0.5], measurement=[0.25, 0.0], sensed_objects=seen)
        )
        self.assertEqual((sensor.get_count(), sensor.is_triggered(0), sensor.is_triggered(2)), (2, True, None))
        self.assertEqual(
            (sensor.get_range(0), sensor.get_range(1), sensor.get_all_measurements()), (0.5, None, [0.25, 0.0])
        )
        self.assertEqual(
            (sensor.get_sensed_object(0), sensor.get_sensed_object(1), sensor.get_sensed_object(-1)), ("box", "", None)
        )
        self.assertIsInstance(sensor.get_pose(), Pose)

    def test_ghost(self):
        """What is inside by index; None where there is nothing."""
        ghost = GhostObject("/ambf/env/ghost")
        self.assertEqual((ghost.get_num_sensed_obj(), ghost.get_all_sensed_obj_names()), (0, []))
        names = ["/ambf/env/BODY Needle", "/ambf/env/BODY Thread"]
        state = GhostObjectState(sensed_objects=[String(data=name) for name in names])
        state.pose.position.z = 0.5
        ghost.ros_cb(state)
        self.assertEqual((ghost.get_num_sensed_obj(), ghost.get_all_sensed_obj_names()), (2, names))
        self.assertEqual([ghost.get_sensed_obj_name(i) for i in (-1, 0, 1, 2)], [None, *names, None])
        self.assertEqual((ghost.get_bodies_inside(), ghost.get_pose()[2]), (names, 0.5))

    def test_contact_sensor(self):
        """Events by index as messages; None where there is none."""
        sensor = ContactSensor("/ambf/env/tip")
        self.assertEqual((sensor.get_num_contact_events(), sensor.get_contact_event(0)), (0, None))
        data = ContactData()
        data.distance.data, data.contact_normal.x = -0.002, 1.0
        plane = ContactEvent(object_name=String(data="/ambf/env/BODY Plane"), contact_data=[data])
        sensor.ros_cb(ContactSensorState(contact_events=[plane, ContactEvent(object_name=String(data="other"))]))
        self.assertEqual(sensor.get_num_contact_events(), 2)
        event = sensor.get_contact_event(0)
        self.assertEqual(-event.contact_data[0].distance.data, 0.002)
        self.assertEqual(event.contact_data[0].contact_normal.x, 1.0)
        names = ["/ambf/env/BODY Plane", "other"]
        self.assertEqual([sensor.get_contact_object_name(i) for i in (-1, 0, 1, 2)], [None, *names, None])
        self.assertEqual((sensor.get_all_contact_object_names(), sensor.get_contact_event(2)), (names, None))
        self.assertEqual(sensor.get_all_contact_events()[1].contact_data, [])

    def test_actuator(self):
        """A body, a body at an offset, what a sensor sees, nothing."""
        actuator = Actuator("/ambf/env/hand")
        offset = Pose()
        offset.position.z = 0.5
        actuator.actuate("box", offset)
        self.assertEqual(
            (actuator._cmd.actuate, actuator._cmd.use_offset, actuator._cmd.body_offset.position.z), (True, True, 0.5)
        )
        actuator.actuate_from_sensor_data("eye")
        self.assertEqual((actuator._cmd.use_sensor_data, actuator._cmd.sensor_identifier.data), (True, "eye"))
        actuator.deactuate()
        self.assertEqual(
            (actuator._cmd.actuate, actuator._cmd.use_sensor_data, actuator._cmd.sensor_identifier.data),
            (False, False, ""),
        )

    def test_vehicle(self):
        """Wheels one by one and together; those that don't exist change nothing."""
        car = Vehicle("/ambf/env/car")
        car.ros_cb(VehicleState(wheel_count=4))
        with quiet() as said:
            car.set_vehicle_power(5.0)
            self.assertFalse(car.set_powered_wheel_indices([2, 4]))
            car.set_wheel_power(7, 1.0)
        self.assertIn("set_powered_wheel_indices", said.getvalue())
        self.assertEqual(list(car._cmd.wheel_power), [])
        self.assertTrue(car.set_powered_wheel_indices([2, 3]))
        self.assertTrue(car.set_steered_wheel_indices([0, 1]))
        car.set_vehicle_power(5.0)
        car.set_vehicle_steering_ackerman(0.25)
        car.set_wheel_brake(0, 1.0)
        self.assertEqual(list(car._cmd.wheel_power), [0.0, 0.0, 5.0, 5.0])
        self.assertEqual(list(car._cmd.wheel_steering), [0.25, 0.25, 0.0, 0.0])
        self.assertEqual(list(car._cmd.wheel_brake), [1.0, 0.0, 0.0, 0.0])
        car.initialize_wheel_cmds()
        self.assertEqual(list(car._cmd.wheel_power), [0.0] * 4)

    def test_soft_body(self):
        """Nodes in threes; the force is that of a watch dog."""
        cloth = SoftBody("/ambf/env/cloth")
        cloth.ros_cb(SoftBodyState(userdata=[1, 2, 3, 4, 5, 6]))
        self.assertEqual((cloth.get_num_nodes(), cloth.get_nodes()), (2, [(1, 2, 3), (4, 5, 6)]))
        cloth.set_force(0, 0, 2)
        self.assertEqual(cloth._cmd.wrench.force.z, 2)
        cloth._clear_command()
        self.assertEqual(cloth._cmd.wrench.force.z, 0)

    def test_world(self):
        """Clock edges alternate; skips have bounds; a watch dog ends throttling of an active world."""
        world = World("World", "/ambf/env/World")
        world.enable_throttling(True)
        world.set_num_step_skips(100)
        edges = []
        for _ in range(3):
            world.update()
            edges.append(world._cmd.step_clock)
        self.assertEqual(edges, [True, False, True])
        for wrong in (0, 101, -1):
            self.assertRaises(ValueError, world.set_num_step_skips, wrong)
        world._watch_dog_deadline -= 3.0
        with contextlib.redirect_stdout(io.StringIO()):
            world.run_publisher()
        self.assertFalse(world._cmd.enable_step_throttling)
        self.assertRaises(UnsupportedCommand, world.step, 1, [Camera("/ambf/env/cam")])
        self.assertRaises(SimulatorNotFound, world.step, 1)


class Names(unittest.TestCase):
    """Look-up by parts of names."""

    def client(self, **kinds):
        """A client that has found objects of these names and kinds, and finds no more."""
        client = Client()
        client._find = lambda: False
        client._objects = {f"/ambf/env/{name}": kind(f"/ambf/env/{name}") for name, kind in kinds.items()}
        return client

    def test_ghosts_do_not_hide_bodies(self):
        """Client 2.0 did not know them: its scripts mean the body."""
        client = self.client(Entry1=RigidBody, ghostEntry1=GhostObject, Entry1cloth=SoftBody, Entry1tip=ContactSensor)
        self.assertEqual(client.get_obj_handle("Entry1").get_name(), "/ambf/env/Entry1")
        self.assertTrue(client.get_obj_handle("Entry1").get_publish_joint_names_flag())
        self.assertIsInstance(client.get_obj_handle("ghostEntry1"), GhostObject)
        self.assertIsInstance(client.get_obj_handle("/ambf/env/Entry1tip"), ContactSensor)

    def test_several_are_none(self):
        """Several that 2.0 knew, or several that it did not know; the candidates are named."""
        client = self.client(Entry1=RigidBody, Entry12=Sensor, ghostEntry=GhostObject, ghostExit=GhostObject)
        for part in ("Entry1", "ghost", "E", "nothing"):
            exact = f"/ambf/env/{part}" in client._objects
            with self.subTest(part), quiet() as said:
                self.assertIsNone(client.get_obj_handle(part), exact)
            self.assertEqual("/ambf/env/ghostEntry" in said.getvalue(), part in ("ghost", "E"))
        self.assertEqual(client.get_obj_handle("/ambf/env/Entry1").object_type, "RIGID_BODY")


class Lost(unittest.TestCase):
    """A simulator that has lost its state says so in the states of the world."""

    REASON = "lost at step 7: BODY hand is not finite; a reset resumes"

    def setUp(self):
        self.world, self.body = World("World", "/ambf/env/World"), body()
        self.body._health = self.world._health

    def hear(self, reason, step=7):
        """A state of the world comes."""
        state = WorldState(sim_step=step)
        state.header.frame_id = reason
        self.world.ros_cb(state)

    def test_everything_that_reads_raises(self):
        """Getters, states that scripts read, waits, clock edges; setters that need no state go on."""
        self.hear("")
        self.assertEqual(self.body.get_pos().x, 3.0)
        self.hear(self.REASON)
        for attempt in (
            self.body.get_pos,
            self.body.get_sim_step,
            self.body.get_joint_names,
            lambda: self.body.get_joint_pos(0),
            lambda: self.body._state,
            lambda: self.body.wait_for_step(0),
            lambda: self.body.wait_for_state(lambda state: True),
            lambda: self.world._state.sim_time,
            self.world.get_sim_time,
            lambda: self.world.wait_for_step(0),
            self.world.update,
        ):
            with self.assertRaisesRegex(SimulationLost, "^lost at step 7: BODY hand is not finite"):
                attempt()
        self.assertFalse(self.world._cmd.step_clock, "no edge was made")
        self.body.set_force(1, 2, 3)
        self.body.run_publisher()
        self.body.ros_cb(RigidBodyState(sim_step=8))
        self.body.close()
        self.world.close()
        self.hear("")
        self.assertEqual((self.body.get_sim_step(), self.world.get_sim_step()), (8, 7))
        self.world.update()

    def test_a_wait_ends(self):
        """As soon as the world says so, though no state of the object comes."""
        timer = threading.Timer(0.1, self.hear, [self.REASON])
        timer.start()
        begin = time.monotonic()
        with self.assertRaises(SimulationLost):
            self.body.wait_for_step(100, 30.0)
        self.assertLess(time.monotonic() - begin, 5.0)
        timer.join()

    def test_a_reset_waits_until_all_is_well(self):
        """So that what comes after it can read."""
        self.hear(self.REASON)
        self.world._reset_pub = types.SimpleNamespace(
            get_num_connections=lambda: 1, publish=lambda _: threading.Timer(0.1, self.hear, [""]).start()
        )
        self.world.reset()
        self.assertEqual(self.body.get_pos().x, 3.0)
        # Without a connection nothing happens.
        self.hear(self.REASON)
        self.world.reset_bodies()

    def test_steps(self):
        """A loss is no ordinary refusal; a step with a reset ends it, whatever is still on its way."""

        def answer(message="", step=0):
            arrays = dict.fromkeys(("bodies", "sensors", "actuators", "contact_sensors", "ghosts"), ())
            result = types.SimpleNamespace(success=not message, message=message, sim_step=step, sim_time=0.0, **arrays)
            return types.SimpleNamespace(call=lambda request, timeout: result, close=lambda: None)

        self.world._services["step"] = answer("too many steps")
        self.assertRaises(StepRefused, self.world.step, 1)
        self.world._services["step"] = answer(self.REASON)
        with self.assertRaisesRegex(SimulationLost, "^lost at step 7"):
            self.world.step(1)
        self.assertRaises(SimulationLost, self.body.get_pos)
        self.world._services["step"] = answer(step=10)
        threading.Timer(0.1, self.hear, ["", 10]).start()
        self.assertEqual(self.world.step(3, reset=True).sim_step, 10)
        self.assertEqual(self.body.get_pos().x, 3.0)
        self.world.step(3)
        self.hear(self.REASON, 7)
        self.assertEqual(self.body.get_pos().x, 3.0, "the report was older than the step")


class Modules(unittest.TestCase):
    """The names by which scripts import."""

    def test_of_client_2(self):
        """Top-level modules."""
        import ambf_comm
        import watch_dog
        from ambf_rigid_body import RigidBody as Same

        self.assertIs(Same, RigidBody)
        names = "Actuator AmbfEnv Camera Client Light Object RigidBody Sensor WatchDog World"
        for name in names.split():
            self.assertTrue(hasattr(ambf_comm, name), name)
        self.assertTrue(issubclass(RigidBody, watch_dog.WatchDog))

    def test_of_client_3(self):
        """The same in the package, and some more in both places: the same things."""
        names = {
            "ambf_actuator": "Actuator",
            "ambf_base_object": "BaseObject",
            "ambf_camera": "Camera",
            "ambf_client": "Client",
            "ambf_comm": "GhostObject",
            "ambf_contact_sensor": "ContactSensor",
            "ambf_env": "AmbfEnv",
            "ambf_ghost_object": "GhostObject",
            "ambf_light": "Light",
            "ambf_object": "Object",
            "ambf_rigid_body": "RigidBody",
            "ambf_sensor": "Sensor",
            "ambf_vehicle": "Vehicle",
            "ambf_world": "World",
            "ros_abstraction_layer": "ral",
            "tf_function": "quaternion_from_euler",
            "transformations": "euler_from_quaternion",
            "watch_dog": "WatchDog",
        }
        for module, name in names.items():
            inside, outside = importlib.import_module(f"ambf_client.{module}"), importlib.import_module(module)
            self.assertIs(getattr(inside, name), getattr(outside, name), module)
        from ambf_client import Client as Same
        from ambf_client.ambf_client import Client as Other
        from tf_function import transformations

        self.assertIs(Same, Other)
        self.assertTrue(hasattr(transformations, "quaternion_matrix"))

    def test_a_ral_may_come_first(self):
        """Client 3.0's classes take it before the name."""
        layer = ral("tests", node=object())
        for kind in (Actuator, Camera, ContactSensor, GhostObject, Object, RigidBody, Sensor, SoftBody, Vehicle, World):
            for made in (kind(layer, "/ambf/env/a"), kind(ral=layer, a_name="/ambf/env/a"), kind("/ambf/env/a")):
                self.assertEqual(made.get_name(), "/ambf/env/a")
        self.assertEqual(RigidBody(layer, "/ambf/env/a", 0.5)._watch_dog_time_out, 0.5)
        self.assertEqual(WatchDog(layer, 0.5)._watch_dog_time_out, 0.5)
        self.assertEqual(Client("tests", 5)._client_name, "tests")
