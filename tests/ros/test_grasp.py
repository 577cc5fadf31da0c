"""A rospy client sees, grasps, carries and drops things: the shipped gripper with its sensor and its actuator."""

import contextlib
import math
import time

import harness
import node
from ambf_msgs.msg import ActuatorCmd, ActuatorState, RigidBodyCmd, RigidBodyState, SensorCmd, SensorState
from poses import angle, distance, pose_of, relative
from scenes import NOWHERE, box, model
from simulated import MODELS, Ros, Simulated, written
from std_msgs.msg import String

GRIPPER = "/ambf/env/gripper"
PALM, BLOCK, EYE, HOLDER = (f"{GRIPPER}/{name}" for name in ("palm", "block", "proximity", "holder"))

# Where the controllers balance the springs: 1000 N/m · q = 200 N/m · (0.045 m − q), so 0.0075 m. The lips let go at 0.0167 m.
OPEN = 0.009

setUpModule, tearDownModule = Ros.start, Ros.stop


def hold(body="", **fields):
    """A command to hold the body of this name."""
    return ActuatorCmd(actuate=True, body_name=String(body), **fields)


def hold_seen(sensor="SENSOR proximity"):
    """A command to hold what a sensor sees."""
    return ActuatorCmd(actuate=True, use_sensor_data=True, sensor_identifier=String(sensor))


def palm_at(x, z):
    """Puts the palm there, with open fingers."""
    command = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_POSITION, joint_cmds=[0.0, 0.0])
    command.joint_cmds_types = [RigidBodyCmd.TYPE_POSITION] * 2
    command.pose.position.x, command.pose.position.z, command.pose.orientation.w = x, z, 1.0
    return command


class Gripper(Simulated):
    """The gripper after its fingers have closed on the block."""

    FILES = (MODELS / "gripper.yaml",)
    # Often enough that both bodies tell of the same steps.
    ARGUMENTS = ("--override_min_comm_freq", "1000", "--override_max_comm_freq", "1000")

    def setUp(self):
        super().setUp()
        self.palm, self.block = (self.listen(f"{name}/State", RigidBodyState) for name in (PALM, BLOCK))
        self.eye = self.listen(f"{EYE}/State", SensorState)
        self.holder = self.listen(f"{HOLDER}/State", ActuatorState)
        self.both = node.Together((f"{PALM}/State", RigidBodyState), (f"{BLOCK}/State", RigidBodyState))
        self.addCleanup(self.both.close)
        self.palm.until(
            # From 0.02 m, where they start, to 0.025 m, where they pinch the block.
            lambda state: len(state.joint_positions) == 2 and min(state.joint_positions) > 0.0245,
            "the fingers close",
        )
        self.block.until(lambda state: state.sim_time > 1.0 and speed(state) < 0.01, "the block lies still")

    def offset(self):
        """Pose of the block in the palm's frame."""
        palm, block = self.both.next()[-1]
        return relative(pose_of(palm.pose), pose_of(block.pose))

    @contextlib.contextmanager
    def carried(self, x, z):
        """Moves the palm from (0, 0, -1) there, and checks that the block follows rigidly."""
        with node.Stream(f"{PALM}/Command", palm_at(0.0, -1.0)) as stream:
            self.palm.until(lambda state: max(state.joint_positions) < OPEN, "the fingers open")
            self.pass_time(0.3)
            held = self.offset()
            steps = math.ceil(math.hypot(x, z + 1.0) / 0.0002)
            for i in range(1, steps + 1):
                goal = (x * i / steps, -1.0 + (z + 1.0) * i / steps)
                stream.command = palm_at(*goal)
                time.sleep(0.01 if i % 4 == 0 else 0.0)
                if i % 25 == 0:
                    # The palm has no inertia: on a busy machine it leaps, and what it holds comes after.
                    now = self.offset()
                    self.assertLess(distance(now[0], held[0]), 0.01)
                    self.assertLess(angle(now[1], held[1]), 0.1)
                if i == steps or i % (steps // 4) == 0:
                    self.palm.until(lambda state, goal=goal: abs(state.pose.position.z - goal[1]) < 1e-6, "it is there")
                    self.pass_time(0.1)
                    now = self.offset()
                    self.assertLess(distance(now[0], held[0]), 1e-3, goal)
                    self.assertLess(angle(now[1], held[1]), 0.01, goal)
            self.assertAlmostEqual(self.block.next().pose.position.x, x, delta=0.01)
            yield

    def assert_falls(self):
        """The block ends on the floor, 1.5 m below the origin."""
        self.block.until(lambda state: state.pose.position.z < -1.45 and speed(state) < 0.01, "the block falls down")


def speed(state):
    """Of a body, m/s."""
    return math.hypot(state.twist.linear.x, state.twist.linear.y, state.twist.linear.z)


class PickAndCarry(Gripper):
    """The block is lifted by the actuator alone: the fingers are open meanwhile."""

    def pick_and_carry(self, command):
        """Holds, carries, lets go."""
        with node.Stream(f"{HOLDER}/Command", command) as holding:
            self.holder.until(lambda state: state.actuated, "the actuator holds")
            with self.carried(0.1, -0.9):
                self.assertTrue(self.holder.next().actuated)
                self.assertEqual(self.eye.next().sensed_objects, [String("block")])
                holding.command = ActuatorCmd()
                self.holder.until(lambda state: not state.actuated, "the actuator lets go")
                self.assert_falls()

    def test_what_the_sensor_sees(self):
        """A client names the sensor, not the body."""
        state = self.eye.until(lambda state: state.triggered == [True], "the sensor sees")
        self.assertEqual((state.type.data, state.count, state.parent_name.data), ("PROXIMITY", 1, "BODY palm"))
        self.assertEqual((state.sensed_objects, len(state.range)), ([String("block")], 1))
        self.assertAlmostEqual(state.range[0], 0.12, places=6)
        # The ray starts 0.021 m below the middle of the palm; the block is 0.04 m high.
        gap = -self.offset()[0][2] - 0.021 - 0.02
        self.assertAlmostEqual(state.measurement[0], 1.0 - gap / 0.12, delta=0.02)
        self.pick_and_carry(hold_seen(state.identifier.data))

    def test_a_body_by_its_name(self):
        """The same without a sensor."""
        self.pick_and_carry(hold("BODY block"))

    def test_a_body_at_an_offset(self):
        """The actuator, 0.02 m below the palm, is 0.06 m above the middle of the block."""
        command = hold("BODY block", use_offset=True)
        command.body_offset.position.z, command.body_offset.orientation.w = 0.06, 1.0
        with node.Stream(f"{HOLDER}/Command", command):
            self.holder.until(lambda state: state.actuated, "the actuator holds")
            with self.carried(-0.05, -0.95):
                position, orientation = self.offset()
                self.assertLess(distance(position, [0.0, 0.0, -0.08]), 1e-3)
                self.assertLess(angle(orientation, [0.0, 0.0, 0.0, 1.0]), 0.01)

    def test_an_offset_may_be_left_out(self):
        """The quaternion of an untouched message is zero: no rotation."""
        with node.Stream(f"{HOLDER}/Command", hold("BODY block", use_offset=True)):
            self.holder.until(lambda state: state.actuated, "the actuator holds")
            for listener in (self.block, self.palm):
                self.assertTrue(math.isfinite(listener.next().pose.position.z))


class Watchdog(Gripper):
    """A client that dies lets go."""

    def test_a_client_that_stops(self):
        """0.5 s after its last command."""
        # The fingers open when the block is held, not before.
        palm = node.Stream(f"{PALM}/Command", palm_at(0.0, -1.0))
        with node.Stream(f"{HOLDER}/Command", hold_seen()):
            self.holder.until(lambda state: state.actuated, "the actuator holds")
            self.enterContext(palm)
            self.palm.until(lambda state: max(state.joint_positions) < OPEN, "the fingers open")
            # Longer than the watchdog's patience: a living client is let alone.
            self.pass_time(1.0)
            self.assertTrue(self.holder.next().actuated)
            last = time.monotonic()
        self.holder.until(lambda state: not state.actuated, "the watchdog lets go")
        self.assertGreater(time.monotonic() - last, 0.4)
        self.assert_falls()

    def test_one_command(self):
        """It holds for as long as the watchdog waits, and a new one holds again."""
        stream = node.Stream(f"{HOLDER}/Command", hold("BODY block"))
        for _ in range(2):
            stream.once()
            self.holder.until(lambda state: state.actuated, "the actuator holds")
            self.holder.until(lambda state: not state.actuated, "the watchdog lets go")


class Sensors(Gripper):
    """Sensors go on through resets, and many work side by side."""

    FILES = (MODELS / "gripper.yaml", MODELS / "touch.yaml")

    def test_resets(self):
        """What is seen afterwards is where it was in the beginning."""
        begin = self.eye.until(lambda state: state.triggered == [True], "the sensor sees").measurement[0]
        for what in ("Reset", "Reset/Bodies"):
            with self.subTest(what):
                with node.Stream(f"{PALM}/Command", palm_at(0.0, -1.0)):
                    self.eye.until(lambda state: state.triggered == [False], "the block is gone")
                self.pass_time(1.0)
                self.reset(what)
                state = self.eye.until(lambda state: state.triggered == [True], "the block is back")
                self.assertEqual(state.sensed_objects, [String("block")])
                self.eye.until(lambda state: abs(state.measurement[0] - begin) < 0.05, "it is where it was")

    def test_a_grasp_and_a_reset(self):
        """What is held when everything returns to its start is held there."""
        with node.Stream(f"{HOLDER}/Command", hold_seen()):
            self.holder.until(lambda state: state.actuated, "the actuator holds")
            self.reset()
            self.pass_time(0.5)
            self.assertTrue(self.holder.next().actuated)
            self.assertLess(distance(self.offset()[0], [0.0, 0.0, -0.09]), 0.01)

    def test_a_second_sensor_is_there(self):
        """Each has its own topic and its own kind."""
        pad = self.listen("/ambf/env/touch/pad/State", SensorState)
        self.assertEqual((pad.newest().type.data, self.eye.newest().type.data), ("RESISTANCE", "PROXIMITY"))
        pad.until(lambda state: state.sensed_objects == [String("plate")] * 4, "the pad feels its plate")
        self.eye.until(lambda state: state.sensed_objects == [String("block")], "the sensor sees its block")

    def test_a_command_raises_the_rate(self):
        """It has no other effect."""
        with node.Stream(f"{EYE}/Command", SensorCmd(actuate=[False])):
            harness.wait_for(lambda: self.eye.rate() > 300, "more messages while commanded")
            self.assertEqual(self.eye.next().triggered, [True])


class TwoHands(Simulated):
    """Two hands with an eye and a grip each, and a box below each."""

    def setUp(self):
        nowhere = {"offset": NOWHERE, "direction": {"x": 0.0, "y": 0.0, "z": -1.0}}
        bodies, sensors, actuators = {}, {}, {}
        for name, x in (("Left", -1.0), ("Right", 1.0)):
            bodies[f"BODY {name}"] = box(name, 0.0, x=x)
            bodies[f"BODY {name} box"] = box(f"{name} box", 1.0, x=x, z=-0.3)
            eye = {"name": f"{name} eye", "type": "Proximity", "parent": f"BODY {name}", "range": 0.5, "array": [nowhere]}
            # Below the hand: a ray that starts inside would see the hand.
            sensors[f"SENSOR {name} eye"] = {**eye, "location": {"position": {"x": 0.0, "y": 0.0, "z": -0.11}}}
            actuators[f"ACTUATOR {name} grip"] = {"name": f"{name} grip", "type": "Constraint", "parent": f"BODY {name}"}
        # The boxes do not fall: they have no weight.
        bodies = {key: {**body, "gravity": NOWHERE} for key, body in bodies.items()}
        scene = {**model(bodies), "sensors": list(sensors), "actuators": list(actuators), **sensors, **actuators}
        self.FILES = (written("two_hands.yaml", scene),)
        super().setUp()

    def test_each_sees_and_holds_its_own(self):
        """A name that both have is no name."""
        boxes = {}
        for name in ("Left", "Right"):
            eye = self.listen(f"/ambf/env/{name}eye/State", SensorState)
            state = eye.until(lambda state: state.triggered == [True], "the sensor sees")
            self.assertEqual(state.sensed_objects, [String(f"{name}box")])
            self.assertAlmostEqual(state.measurement[0], 1.0 - 0.09 / 0.5, delta=0.01)
            boxes[name] = self.listen(f"/ambf/env/{name}box/State", RigidBodyState)
        grips = {name: self.listen(f"/ambf/env/{name}grip/State", ActuatorState) for name in boxes}
        with node.Stream("/ambf/env/Rightgrip/Command", hold_seen("Right eye")) as right:
            grips["Right"].until(lambda state: state.actuated, "the right hand holds")
            self.assertFalse(grips["Left"].next().actuated)
            push = RigidBodyCmd()
            push.wrench.force.y = 0.5
            with node.Stream("/ambf/env/Rightbox/Command", push), node.Stream("/ambf/env/Leftbox/Command", push):
                boxes["Left"].until(lambda state: state.pose.position.y > 0.3, "what is free moves")
                self.assertLess(abs(boxes["Right"].next().pose.position.y), 1e-3)
            # From another hand's box to a name of two.
            right.command = ActuatorCmd()
            grips["Right"].until(lambda state: not state.actuated, "it lets go")
            right.command = hold_seen("eye")
            self.wait_for_log("sensor `eye` is part of several")
            self.assertFalse(grips["Right"].next().actuated)


class BadCommands(Gripper):
    """What can't be held is named, once, and nothing else suffers."""

    def assert_named_once(self, command, text):
        """One line while the stream lasts, however often it is repeated."""

        def named_once():
            # The watchdog clears the command before.
            self.pass_time(1.0)
            before = self.count_in_log(text)
            with node.Stream(f"{HOLDER}/Command", command):
                harness.wait_for(lambda: self.count_in_log(text) > before, f"the log says {text!r}")
                self.pass_time(1.0)
                self.assertFalse(self.holder.next().actuated)
            self.assertEqual(self.count_in_log(text), before + 1, self.simulator.log())

        self.simulator.while_commanded("holder", named_once)
        with node.Stream(f"{HOLDER}/Command", hold("BODY block")):
            self.holder.until(lambda state: state.actuated, "a good command holds")
        self.holder.until(lambda state: not state.actuated, "the watchdog lets go")

    def test_names_of_nobody(self):
        """A body and a sensor that are not there, and a name that several have."""
        self.assert_named_once(hold("BODY nobody"), "body `BODY nobody` is not found")
        self.assert_named_once(hold_seen("SENSOR nobody"), "sensor `SENSOR nobody` is not found")
        self.assert_named_once(hold("finger"), "body `finger` is part of several")

    def test_the_parent_itself(self):
        """Nothing can be held by itself."""
        with node.Stream(f"{HOLDER}/Command", hold("BODY palm")):
            self.pass_time(0.3)
            self.assertFalse(self.holder.next().actuated)

    def test_numbers_that_are_none(self):
        """NaN in the offset: the command is refused as a whole."""
        command = hold("BODY block", use_offset=True)
        command.body_offset.position.x = math.nan
        with node.Stream(f"{HOLDER}/Command", command):
            self.wait_for_log("holder")
            self.pass_time(0.3)
            self.assertFalse(self.holder.next().actuated)
            self.assertTrue(math.isfinite(self.block.next().pose.position.x))

    def test_long_names(self):
        """A text of a megabyte is no name."""
        with node.Stream(f"{HOLDER}/Command", hold("x" * 1_000_000)):
            self.wait_for_log("body_name has 1000000 bytes")
            self.assertFalse(self.holder.next().actuated)
