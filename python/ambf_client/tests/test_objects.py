"""Handles without a simulator: what setters make of commands, what getters make of states."""

import contextlib
import io
import math
import unittest

import rospy
from ambf_client import Actuator, BaseObject, Camera, GhostObject, Object, RigidBody, Sensor, SoftBody, Vehicle, World
from ambf_client.errors import UnsupportedCommand
from ambf_client.rotations import QuaternionLike, quaternion_from_rpy, quaternion_from_zyx, rpy_from_quaternion
from ambf_msgs.msg import RigidBodyCmd, RigidBodyState, SensorState, SoftBodyState, VehicleState
from geometry_msgs.msg import Pose, Quaternion
from std_msgs.msg import String

FORCE, POSITION, VELOCITY = RigidBodyCmd.TYPE_FORCE, RigidBodyCmd.TYPE_POSITION, RigidBodyCmd.TYPE_VELOCITY


def setUpModule():
    """ROS time is the system's; no master is needed for that."""
    rospy.rostime.set_rostime_initialized(True)


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
            found = rpy_from_quaternion(Quaternion(*quaternion_from_rpy(*rpy)))
            for expected, angle in zip(rpy, found):
                self.assertAlmostEqual(angle, expected, places=12)

    def test_at_the_poles(self):
        """At a pitch of 90° the rotation, not the angles, comes back."""
        for rpy in ((0.4, math.pi / 2, 0.1), (0.4, -math.pi / 2, 0.1)):
            q = quaternion_from_rpy(*rpy)
            again = quaternion_from_rpy(*rpy_from_quaternion(Quaternion(*q)))
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
        handle._watch_dog_deadline = rospy.Time.now() - rospy.Duration(1)
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
            GhostObject: ("GHOST_OBJECT", "KINEMATIC"),
            Object: ("DEFAULT_OBJECT", "DYNAMIC"),
            RigidBody: ("RIGID_BODY", "DYNAMIC"),
            Sensor: ("SENSOR", "KINEMATIC"),
            SoftBody: ("SOFT_BODY", "DYNAMIC"),
            Vehicle: ("VEHICLE", "DYNAMIC"),
        }
        for kind, types in expected.items():
            handle = kind("/ambf/env/a")
            self.assertIsInstance(handle, BaseObject)
            self.assertEqual((handle.object_type, handle.body_type), types)
            self.assertEqual((handle.get_name(), handle.is_active()), ("/ambf/env/a", False))

    def test_poses_that_can_not_be_commanded(self):
        """A typed error, which is an AttributeError as it always was."""
        for kind in (Actuator, Sensor, Vehicle, SoftBody):
            with self.subTest(kind.__name__), self.assertRaises(UnsupportedCommand):
                kind("/ambf/env/a").set_pose(Pose())
        self.assertTrue(issubclass(UnsupportedCommand, AttributeError))
        camera = Camera("/ambf/env/cam")
        camera.set_pos(1, 2, 3)
        self.assertTrue(camera._cmd.enable_position_controller)

    def test_sensor(self):
        """Rays by index; None where there is none."""
        sensor = Sensor("/ambf/env/eye")
        seen = [String("box"), String("")]
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
        world._watch_dog_deadline = rospy.Time.now() - rospy.Duration(1)
        with contextlib.redirect_stdout(io.StringIO()):
            world.run_publisher()
        self.assertFalse(world._cmd.enable_step_throttling)
        self.assertRaises(UnsupportedCommand, world.step, 1, [Camera("/ambf/env/cam")])

    def test_modules_of_the_original(self):
        """The names by which scripts import."""
        import ambf_comm
        import watch_dog
        from ambf_rigid_body import RigidBody as Same

        self.assertIs(Same, RigidBody)
        names = "Actuator AmbfEnv Camera Client Light Object RigidBody Sensor WatchDog World"
        for name in names.split():
            self.assertTrue(hasattr(ambf_comm, name), name)
        self.assertTrue(issubclass(RigidBody, watch_dog.WatchDog))
