"""A rospy client drives the shipped car."""

import math
import time

import node
from ambf_msgs.msg import RigidBodyState, VehicleCmd, VehicleState
from poses import angle, compose, distance, pose_of, yaw
from simulated import MODELS, Ros, Simulated

CAR, CHASSIS = "/ambf/env/car/car", "/ambf/env/car/chassis"
WHEELS = [f"/ambf/env/car/wheel{name}" for name in ("frontleft", "frontright", "rearleft", "rearright")]

setUpModule, tearDownModule = Ros.start, Ros.stop


class Car(Simulated):
    """The car after it has come to rest on its springs."""

    FILES = (MODELS / "car.yaml",)
    ARGUMENTS = ("--override_min_comm_freq", "200", "--override_max_comm_freq", "400")

    def setUp(self):
        super().setUp()
        self.car, self.chassis = self.listen(f"{CAR}/State", VehicleState), self.listen(f"{CHASSIS}/State", RigidBodyState)
        # Bullet pushes the car up after each step: what it reports includes 1 ms of that, 0.01 m/s.
        self.rest = self.chassis.until(
            lambda state: state.sim_time > 1.5 and abs(state.twist.linear.z) < 0.02, "the car stands"
        ).pose

    def drive(self, **fields):
        """A stream of commands."""
        return node.Stream(f"{CAR}/Command", VehicleCmd(**fields))

    def until_fast(self, speed):
        """Waits until the car drives forward so fast, m/s; the state."""
        return self.chassis.until(lambda state: state.twist.linear.x > speed, f"{speed} m/s")

    def test_at_rest(self):
        """The state is complete: the wheels are where the springs let them be."""
        state = self.car.next()
        self.assertEqual((state.name.data, state.identifier.data), ("car", "/ambf/env/car/VEHICLE car"))
        self.assertEqual((state.mass, state.wheel_count, len(state.wheel_offsets)), (10.0, 4, 4))
        self.assertGreater(min(state.pInertia.x, state.pInertia.y, state.pInertia.z), 0.0)
        self.assertLess(distance(pose_of(state.pose)[0], pose_of(self.rest)[0]), 1e-3)
        self.assertLess(math.hypot(self.rest.position.x, self.rest.position.y), 1e-3)
        # Four springs of 60 1/s² carry g: 0.1 m less 0.041 m; then a radius of 0.1 m to the floor.
        spring = 0.1 - 9.81 / 4.0 / 60.0
        self.assertAlmostEqual(self.rest.position.z, -1.5 + 0.1 + spring, delta=2e-3)
        for wheel, (x, y) in zip(state.wheel_offsets, ((0.25, 0.2), (0.25, -0.2), (-0.25, 0.2), (-0.25, -0.2))):
            self.assertLess(distance(pose_of(wheel)[0], [x, y, -spring]), 3e-3)

    def test_it_drives(self):
        """Forward is +x: 2 · 5 N on 10 kg; the wheels turn as far as the car goes."""
        before = self.car.next()
        with self.drive(wheel_power=[5.0, 5.0]):
            first = self.until_fast(0.3)
            last = self.until_fast(1.0)
        time_s = last.sim_time - first.sim_time
        acceleration = (last.twist.linear.x - first.twist.linear.x) / time_s
        self.assertAlmostEqual(acceleration, 1.0, delta=0.15)
        self.assertLess(abs(last.pose.position.y - self.rest.position.y), 0.02)
        # A small way on, the wheels have turned by way / radius: below half a turn, so that the angle is unique.
        first = self.car.next()
        last = self.car.until(lambda state: state.pose.position.x > first.pose.position.x + 0.1, "a little further")
        way = last.pose.position.x - first.pose.position.x
        if way < 0.3:
            for a, b in zip(first.wheel_offsets, last.wheel_offsets):
                self.assertAlmostEqual(angle(pose_of(a)[1], pose_of(b)[1]), way / 0.1, delta=0.2)
        self.assertGreater(last.pose.position.x, before.pose.position.x + 0.3)

    def test_wheels_are_shown_by_bodies(self):
        """Each has a topic of its own and is where the vehicle says that the wheel is."""
        kinds = [(f"{CAR}/State", VehicleState)] + [(f"{wheel}/State", RigidBodyState) for wheel in WHEELS]
        together = node.Together(*kinds)
        self.addCleanup(together.close)
        with self.drive(wheel_power=[5.0, 5.0], wheel_steering=[0.2, 0.2]):
            self.until_fast(0.5)
            for car, *wheels in together.next(5):
                for offset, wheel in zip(car.wheel_offsets, wheels):
                    expected, seen = compose(pose_of(car.pose), pose_of(offset)), pose_of(wheel.pose)
                    # Poses of bodies are one sub-step old: 1 ms at 1 m/s and 10 rad/s.
                    self.assertLess(distance(seen[0], expected[0]), 0.01)
                    self.assertLess(angle(seen[1], expected[1]), 0.2)

    def test_it_steers(self):
        """Positive is to the left; a state shows the wheels turned."""
        for steering in (0.3, -0.3):
            with self.subTest(steering), self.drive(wheel_power=[5.0, 5.0], wheel_steering=[steering] * 2) as stream:
                before = yaw(pose_of(self.chassis.next().pose)[1])

                def turned(state, before=before, steering=steering):
                    difference = math.remainder(yaw(pose_of(state.pose)[1]) - before, math.tau)
                    return difference * math.copysign(1.0, steering) > 0.3

                self.chassis.until(turned, "it turns")
                front, rear = self.car.next().wheel_offsets[0], self.car.next().wheel_offsets[2]
                self.assertAlmostEqual(axle_yaw(front), steering, delta=0.05)
                self.assertAlmostEqual(axle_yaw(rear), 0.0, delta=0.05)
                stream.command = VehicleCmd(brake=True)
                self.chassis.until(lambda state: speed(state) < 0.01, "it stops")

    def test_it_brakes(self):
        """`brake` goes before power, and the car stays where it stops."""
        with self.drive(wheel_power=[5.0, 5.0]) as stream:
            self.until_fast(1.0)
            stream.command = VehicleCmd(brake=True, wheel_power=[5.0, 5.0])
            self.chassis.until(lambda state: speed(state) < 0.01, "it stops")
            # The chassis rocks on its suspension for a while: its speed is also small where it turns round.
            self.pass_time(1.0)
            stopped = self.chassis.next()
            self.pass_time(1.0)
            self.assertLess(distance(pose_of(self.chassis.next().pose)[0], pose_of(stopped.pose)[0]), 0.01)
            # Then with the brake of a single wheel.
            stream.command = VehicleCmd(wheel_power=[5.0, 5.0])
            self.until_fast(0.5)
            stream.command = VehicleCmd(wheel_brake=[0.0, 0.0, 0.5, 0.5])
            self.chassis.until(lambda state: speed(state) < 0.01, "the rear brakes stop it")

    def test_the_watchdog(self):
        """A client that dies leaves neither power nor a wrench behind."""
        with self.drive(wheel_power=[5.0, 5.0]):
            self.until_fast(0.5)
        self.pass_time(2.0)

        def rolls(first):
            last = self.chassis.until(lambda state: state.sim_time > first.sim_time + 0.5, "time passes")
            return abs(last.twist.linear.x - first.twist.linear.x) < 0.1

        self.assertTrue(rolls(self.chassis.next()), "it rolls, without power")
        lift = VehicleCmd()
        lift.chassis_wrench.force.z = 150.0
        last = time.monotonic()
        node.Stream(f"{CAR}/Command", lift).once()
        self.chassis.until(lambda state: state.pose.position.z > self.rest.position.z + 0.2, "it takes off")
        self.chassis.until(
            lambda state: state.twist.linear.z < 0.0 and state.pose.position.z < self.rest.position.z + 0.1, "it lands"
        )
        self.assertGreater(time.monotonic() - last, 0.4)

    def test_a_torque_turns_it(self):
        """`chassis_wrench` has both parts."""
        turn = VehicleCmd()
        turn.chassis_wrench.force.z, turn.chassis_wrench.torque.z = 100.0, 1.0
        with node.Stream(f"{CAR}/Command", turn):
            self.chassis.until(lambda state: state.twist.angular.z > 0.5, "it turns in the air")

    def test_arrays_of_any_length(self):
        """What is missing is zero, what is too much is ignored, what is too large is clamped."""
        with self.drive(wheel_power=[1e9], wheel_steering=[7.0] * 1000, wheel_brake=[0.0] * 9) as stream:
            self.chassis.until(lambda state: speed(state) > 0.5, "one wheel drives")
            offsets = self.car.next().wheel_offsets
            self.assertAlmostEqual(axle_yaw(offsets[1]), 0.5, delta=0.05)
            self.assertAlmostEqual(axle_yaw(offsets[3]), 0.0, delta=0.05)
            stream.command = VehicleCmd(wheel_brake=[1e30] * 4, wheel_power=[-1e30] * 4)
            self.chassis.until(lambda state: speed(state) < 0.1, "brakes hold against power")
            stream.command = VehicleCmd()
            self.pass_time(0.5)
        self.assertTrue(math.isfinite(self.chassis.next().pose.position.x))

    def test_numbers_that_are_none(self):
        """NaN is refused as a whole, and named; the next command works."""
        bad = [VehicleCmd(wheel_power=[math.nan, 5.0]), VehicleCmd(wheel_steering=[math.inf]), VehicleCmd()]
        bad[2].chassis_wrench.torque.y = math.nan
        for command in bad:
            with self.drive() as stream:
                stream.command = command
                self.pass_time(0.3)
                state = self.car.next()
                self.assertTrue(math.isfinite(state.pose.position.x) and math.isfinite(state.wheel_offsets[0].position.x))
        self.wait_for_log("/ambf/env/car/car/Command")
        with self.drive(wheel_power=[5.0, 5.0]):
            self.until_fast(0.5)

    def test_resets(self):
        """It stands where it began, with straight wheels, and does not move on."""
        with self.drive(wheel_power=[5.0, 5.0], wheel_steering=[0.3, 0.3]):
            self.until_fast(1.0)
        self.pass_time(1.0)
        self.reset()
        self.chassis.until(
            lambda state: distance(pose_of(state.pose)[0], pose_of(self.rest)[0]) < 0.02, "it is back where it was"
        )
        self.pass_time(1.0)
        self.assertLess(distance(pose_of(self.chassis.next().pose)[0], pose_of(self.rest)[0]), 0.02)
        self.assertAlmostEqual(axle_yaw(self.car.next().wheel_offsets[0]), 0.0, delta=0.01)


def axle_yaw(wheel):
    """Steering angle, rad, of a wheel's pose in the chassis' frame: how far its axle, y, is turned about z."""
    x, y, z, w = pose_of(wheel)[1]
    axle = (2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z))
    return math.atan2(-axle[0], axle[1])


def speed(state):
    """Of a body over the ground, m/s."""
    return math.hypot(state.twist.linear.x, state.twist.linear.y)
