"""A rospy client sees and moves the rest: sensors that feel, a cloth, a ghost object, a camera and a light with a parent."""

import math

import harness
import node
import rospy
from ambf_msgs.msg import (
    CameraState,
    ContactSensorState,
    GhostObjectCmd,
    GhostObjectState,
    LightState,
    RigidBodyCmd,
    RigidBodyState,
    SensorState,
    SoftBodyCmd,
    SoftBodyState,
    WorldCmd,
)
from ambf_msgs.srv import RemoveModel
from poses import distance
from scenes import NOWHERE, box, model
from simulated import MODELS, WORLD, Ros, Simulated, written
from std_msgs.msg import String

G = 9.81
TOUCH, CLOTH, GHOST, HEADLAMP = (f"/ambf/env/{name}" for name in ("touch", "cloth", "ghost", "headlamp"))

# What the ghost object names it by.
BOX = f"{GHOST}/BODY falling box"

setUpModule, tearDownModule = Ros.start, Ros.stop


def push(z):
    """A command that pushes a body upwards, N."""
    command = RigidBodyCmd()
    command.wrench.force.z = z
    return command


class Touch(Simulated):
    """The shipped scene of sensors that feel."""

    FILES = (MODELS / "touch.yaml",)

    def setUp(self):
        super().setUp()
        self.pad = self.listen(f"{TOUCH}/pad/State", SensorState)
        self.scale = self.listen(f"{TOUCH}/scale/State", ContactSensorState)
        self.plate, self.box = (self.listen(f"{TOUCH}/{name}/State", RigidBodyState) for name in ("plate", "box"))

    def assert_pad_carries(self, force):
        """The four rays settle where stiffness · depth, 10 N · d each, carries so many N."""

        def settled(state):
            return abs(10.0 * sum(state.measurement) - force) < 0.03 * force

        first = self.pad.until(settled, f"the pad carries {force} N")
        # Not on the way through, but for good.
        for _ in range(20):
            state = self.pad.until(lambda state: state.sim_time > first.sim_time + 0.02, "time passes")
            if not settled(state):
                return self.assert_pad_carries(force)
            first = state
        self.assertEqual(first.sensed_objects, [String("plate")] * 4)
        # As deep as the rays say: they start at z = -0.979, are 0.1 m long, and the plate is 0.02 m thick.
        bottom = self.plate.next().pose.position.z - 0.01
        self.assertAlmostEqual(bottom, -0.979 + 0.1 * (1.0 - force / 40.0), delta=2e-3)
        return None

    def assert_box_lies_on_table(self):
        """One event with points under the box, on the table's upper side, and normals that point into the table."""
        state = self.scale.until(lambda state: state.contact_events, "the box has landed")
        self.pass_time(1.0)
        state = self.scale.next()
        self.assertEqual([event.object_name.data for event in state.contact_events], [f"{TOUCH}/BODY box"])
        points, box_at = state.contact_events[0].contact_data, self.box.next().pose.position
        self.assertIn(len(points), (3, 4))
        for data in points:
            self.assertLess(abs(data.distance.data), 2e-3)
            self.assertAlmostEqual(data.contact_normal.z, -1.0, places=6)
            self.assertAlmostEqual(data.contact_point.z, -0.98, delta=2e-3)
            # The box may have turned when it fell: its corners are at half a diagonal of its side.
            self.assertLess(math.hypot(data.contact_point.x - box_at.x, data.contact_point.y - box_at.y), 0.075)

    def test_a_resistance_sensor_pushes_back(self):
        """By the formula: what lies on it and what presses it."""
        state = self.pad.newest()
        self.assertEqual((state.type.data, state.count, state.parent_name.data), ("RESISTANCE", 4, "BODY base"))
        self.assertAlmostEqual(state.range[0], 0.1, places=6)
        self.assert_pad_carries(0.2 * G)
        with node.Stream(f"{TOUCH}/plate/Command", push(-5.0)):
            self.assert_pad_carries(0.2 * G + 5.0)
        self.assert_pad_carries(0.2 * G)

    def test_a_resistance_sensor_lets_go(self):
        """What is lifted off is not felt and not pushed any more: it falls freely from above."""
        self.assert_pad_carries(0.2 * G)
        # Hardly more than its weight: on a busy machine the push lasts longer, and must not throw it high.
        with node.Stream(f"{TOUCH}/plate/Command", push(2.1)):
            self.pad.until(lambda state: state.triggered == [False] * 4, "the plate is off")
            state = self.pad.next()
            self.assertEqual((state.measurement, state.sensed_objects), ((0.0,) * 4, [String("")] * 4))
        self.assert_pad_carries(0.2 * G)

    def test_a_contact_sensor_names_what_touches(self):
        """With the points of contact, as long as it touches."""
        state = self.scale.newest()
        self.assertEqual((state.type.data, state.parent_name.data, state.name.data), ("CONTACT", "BODY table", "scale"))
        self.assert_box_lies_on_table()
        with node.Stream(f"{TOUCH}/box/Command", push(6.0)):
            self.scale.until(lambda state: not state.contact_events, "the box is lifted")
        self.assert_box_lies_on_table()

    def test_resets(self):
        """Both feel the same again."""
        for what in ("Reset", "Reset/Bodies"):
            with self.subTest(what):
                self.assert_pad_carries(0.2 * G)
                self.reset(what)
                self.plate.until(lambda state: state.pose.position.z > -0.872, "the plate is back above its place")
                self.assert_box_lies_on_table()


class Cloth(Simulated):
    """The shipped scene of a cloth that hangs by two cords."""

    FILES = (MODELS / "cloth.yaml",)

    def setUp(self):
        super().setUp()
        self.cloth = self.listen(f"{CLOTH}/cloth/State", SoftBodyState)
        self.ball = self.listen(f"{CLOTH}/ball/State", RigidBodyState)
        self.cloth.newest()

    def speed_between(self, first, last):
        """Root mean square of the nodes' speeds between two states, m/s."""
        time_s = last.sim_time - first.sim_time
        squares = [math.dist(a, b) ** 2 for a, b in zip(nodes(first), nodes(last))]
        return math.sqrt(sum(squares) / len(squares)) / time_s

    def speed(self):
        """The same over the next 0.1 s."""
        first = self.cloth.next()
        return self.speed_between(
            first, self.cloth.until(lambda state: state.sim_time > first.sim_time + 0.1, "time passes")
        )

    def test_it_hangs_and_settles(self):
        """The cords' upper ends stay, the rest swings down below them and comes to rest; the ball has passed."""
        first = self.cloth.next()
        self.assertAlmostEqual(first.mass, 0.2, places=6)
        self.assertIn("node positions", first.userdata_description)
        self.assertEqual((len(first.userdata), first.name.data), (3 * 127, "cloth"))
        ends = [i for i, point in enumerate(nodes(first)) if abs(point[2] + 0.45) < 1e-4]
        self.assertEqual(len(ends), 2)
        fast = self.speed()
        harness.wait_for(lambda: self.speed() < 0.02, "the cloth settles")
        self.assertGreater(fast, 0.1)
        last = nodes(self.cloth.next())
        for i in ends:
            self.assertLess(distance(last[i], nodes(first)[i]), 1e-4)
            self.assertAlmostEqual(abs(last[i][0]), 0.3, places=4)
        # Nothing is above the ends; the middle of the cloth hangs below the cords, their length and half the cloth deep.
        self.assertLess(max(point[2] for point in last), -0.449)
        self.assertLess(self.cloth.next().pose.position.z, -0.8)
        low = min(point[2] for point in last)
        self.assertTrue(-1.45 < low < -1.0, low)
        self.ball.until(lambda state: state.pose.position.z < -1.4, "the ball ends on the floor")
        # It was held up: it would have fallen straight down.
        self.assertGreater(abs(self.ball.next().pose.position.y + 0.1), 0.02)

    def test_a_reset_while_a_client_waits(self):
        """The first shape is back exactly."""
        harness.wait_for(lambda: self.cloth.next().pose.position.z < -0.7, "the cloth swings down")
        with node.Stream(f"{WORLD}/Command", WorldCmd(enable_step_throttling=True, n_skip_steps=1)):

            def stopped():
                steps = {self.cloth.next().sim_step for _ in range(10)}
                return len(steps) == 1

            harness.wait_for(stopped, "the physics waits")
            self.reset()
            state = self.cloth.until(lambda state: abs(state.pose.position.z + 0.6) < 0.02, "the cloth is back")
            flat = [point for point in nodes(state) if abs(point[2] + 0.6) < 1e-5]
            self.assertEqual(len(flat), 121)
            self.assertAlmostEqual(min(point[0] for point in flat), -0.3, places=5)
            self.assertAlmostEqual(max(point[1] for point in flat), 0.3, places=5)
        self.cloth.until(lambda state: state.pose.position.z < -0.7, "it swings down again")

    def test_a_force(self):
        """It pulls at all nodes while commands come, and not for longer."""
        harness.wait_for(lambda: self.speed() < 0.05, "the cloth settles")
        rest = self.cloth.next().pose.position.x
        pull = SoftBodyCmd()
        pull.wrench.force.x = 1.0
        with node.Stream(f"{CLOTH}/cloth/Command", pull) as stream:
            self.cloth.until(lambda state: state.pose.position.x > rest + 0.05, "it is pulled aside")
            stream.command = SoftBodyCmd()
            stream.command.wrench.force.x = math.nan
            self.wait_for_log(f"{CLOTH}/cloth/Command")
            self.assertTrue(all(math.isfinite(number) for number in self.cloth.next().userdata))
        self.cloth.until(lambda state: state.pose.position.x < rest + 0.01, "it swings back")

    def test_what_has_no_effect_is_named(self):
        """A soft body follows no pose."""
        command = SoftBodyCmd(enable_position_controller=True)
        with node.Stream(f"{CLOTH}/cloth/Command", command):
            self.wait_for_log("enable_position_controller")
            self.pass_time(0.5)
        self.assertEqual(self.count_in_log("enable_position_controller"), 1)


def nodes(state):
    """Points of a soft body, m."""
    numbers = state.userdata
    return list(zip(numbers[0::3], numbers[1::3], numbers[2::3]))


class Ghost(Simulated):
    """The shipped zone, with a box of its own weight beside it."""

    def setUp(self):
        light = {**box("Light", 1.0, x=5.0, z=-0.6), "gravity": {"x": 0.0, "y": 0.0, "z": -3.0}}
        self.FILES = (MODELS / "ghost.yaml", written("light.yaml", model({"BODY Light": light})))
        super().setUp()
        self.zone = self.listen(f"{GHOST}/zone/State", GhostObjectState)
        self.box = self.listen(f"{GHOST}/fallingbox/State", RigidBodyState)
        self.light = self.listen("/ambf/env/Light/State", RigidBodyState)

    def move(self, x, z=-0.6):
        """A stream that holds the stand, and so the zone, there."""
        command = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_POSITION)
        command.pose.position.x, command.pose.position.z, command.pose.orientation.w = x, z, 1.0
        return node.Stream(f"{GHOST}/stand/Command", command)

    def test_what_falls_into_it_floats(self):
        """It stays where it is caught, and is named; what lies outside is not."""
        state = self.zone.until(lambda state: state.sensed_objects, "the zone catches something")
        self.assertEqual((sensed(state), state.name.data), ([BOX], "zone"))
        self.assertEqual((state.parent_name.data, state.identifier.data), ("BODY stand", f"{GHOST}/GHOST zone"))
        self.assertAlmostEqual(state.pose.position.z, -0.6, places=6)
        first = self.box.until(lambda state: abs(state.twist.linear.z) < 1e-6, "it has lost its speed")
        # Its lower side is in the zone, whose upper one is at -0.4.
        self.assertTrue(-0.5 < first.pose.position.z < -0.3, first.pose.position.z)
        self.pass_time(1.0)
        self.assertAlmostEqual(self.box.next().pose.position.z, first.pose.position.z, places=5)
        self.assertEqual(sensed(self.zone.next()), [BOX])

    def test_it_moves_and_what_it_leaves_falls(self):
        """With its own weight: that of the world, and one of its own."""
        self.zone.until(lambda state: sensed(state) == [BOX], "the zone catches the box")
        with self.move(5.0, z=-1.0):
            self.zone.until(lambda state: sensed(state) == ["/ambf/env/BODY Light"], "the zone is at the other box")
            self.assertAlmostEqual(self.zone.next().pose.position.x, 5.0, places=6)
            self.box.until(lambda state: state.pose.position.z < -1.3, "the first box falls to the other one")
            self.light.until(lambda state: abs(state.twist.linear.z) < 1e-6, "the other box floats")
        # The watchdog ends the command; the zone stays where it was put.
        self.pass_time(1.5)
        self.assertAlmostEqual(self.zone.next().pose.position.x, 5.0, places=6)
        with self.move(-5.0):
            first = self.light.until(lambda state: state.twist.linear.z < -0.05, "it falls")
            last = self.light.until(lambda state: state.twist.linear.z < -0.6, "it falls on")
            acceleration = (last.twist.linear.z - first.twist.linear.z) / (last.sim_time - first.sim_time)
            self.assertAlmostEqual(acceleration, -3.0, delta=0.1)
            self.assertEqual(self.zone.next().sensed_objects, [])

    def test_a_command_raises_the_rate_only(self):
        """Ghost objects take no commands; the topic is there because the original's clients publish on it."""
        self.zone.until(lambda state: state.sensed_objects, "the zone catches something")
        with node.Stream(f"{GHOST}/zone/Command", GhostObjectCmd()):
            harness.wait_for(lambda: self.zone.rate() > 100.0, "more than 100 Hz")
            self.assertEqual(self.zone.next().pose.position.x, 0.0)

    def test_out_of_reach_and_back(self):
        """What was in the zone falls when the zone is far away; a reset brings both back."""
        self.zone.until(lambda state: state.sensed_objects, "the zone catches something")
        with self.move(1e300):
            self.box.until(lambda state: state.pose.position.z < -1.3, "the box falls")
        self.assertEqual(self.zone.next().sensed_objects, [])
        # Until the watchdog has cleared it, the command would move the zone away again.
        self.pass_time(1.5)
        self.reset()
        self.zone.until(lambda state: state.pose.position.x == 0.0, "a reset brings it back")


class LookUp(Simulated):
    """A body, and a ghost object, a contact sensor and a soft body whose names hold that of the body."""

    def setUp(self):
        entry = {**box("Entry1", 0.0, x=5.0, z=0.5)}
        text = {
            "bodies": ["BODY Entry1"],
            "BODY Entry1": entry,
            "ghost objects": ["GHOST ghostEntry1"],
            "GHOST ghostEntry1": {
                "name": "ghostEntry1",
                "parent": "BODY Entry1",
                "collision shape": "Sphere",
                "collision geometry": {"radius": 0.1},
            },
            "sensors": ["SENSOR tipEntry1"],
            "SENSOR tipEntry1": {"name": "tipEntry1", "type": "Contact", "parent": "BODY Entry1"},
        }
        self.FILES = (written("entries.yaml", {"namespace": "/ambf/env/", "joints": [], **text}), MODELS / "cloth.yaml")
        super().setUp()

    def test_a_part_of_a_name_means_the_body(self):
        """As client 2.0 looks it up: among the topics of the types that it knows, by name, else by a part of one name only."""
        known = ("Actuator", "Camera", "Light", "Object", "RigidBody", "Sensor", "Vehicle")
        # All are registered, one after the other.
        last = ("/ambf/env/ghostEntry1/State", "/ambf/env/tipEntry1/State", "/ambf/env/Entry1/State")
        harness.wait_for(lambda: set(last) <= set(dict(rospy.get_published_topics())), "all topics")
        topics = dict(rospy.get_published_topics())
        names = [
            topic.replace("/State", "") for topic, kind in topics.items() if kind in [f"ambf_msgs/{k}State" for k in known]
        ]
        self.assertEqual([name for name in names if "Entry1" in name], ["/ambf/env/Entry1"])
        self.assertEqual([name for name in names if "cloth/cloth" in name], [])
        # Version 3.0 of the client finds the others by their own types.
        self.assertEqual(topics["/ambf/env/ghostEntry1/State"], "ambf_msgs/GhostObjectState")
        self.assertEqual(topics["/ambf/env/tipEntry1/State"], "ambf_msgs/ContactSensorState")
        self.assertNotIn("ambf_msgs/ObjectState", topics.values())


def sensed(state):
    """Identifiers of what is in a ghost object."""
    return [name.data for name in state.sensed_objects]


class Parents(Simulated):
    """A camera and a light hang on things, and can be hung elsewhere."""

    def setUp(self):
        post = {**box("Far", 0.0, x=7.0, z=2.0), "gravity": NOWHERE}
        self.FILES = (MODELS / "headlamp.yaml", written("far.yaml", model({"BODY Far": post})))
        super().setUp()
        self.eye = self.listen(f"{HEADLAMP}/eye/State", CameraState)
        self.lamp = self.listen(f"{HEADLAMP}/lamp/State", LightState)

    def test_states(self):
        """Poses are those in the parent's frame: they stay as the pendulum swings."""
        head = self.listen(f"{HEADLAMP}/head/State", RigidBodyState)
        head.until(lambda state: state.pose.position.z < -0.3, "the pendulum swings")
        for listener, z in ((self.eye, 0.0), (self.lamp, 0.05)):
            state = listener.next()
            self.assertEqual(state.parent_name.data, "BODY head")
            self.assertAlmostEqual(state.pose.position.x, 0.1, places=6)
            self.assertAlmostEqual(state.pose.position.z, z, places=6)
        self.assertEqual(rospy.get_param(f"{HEADLAMP}/eye/parent_name"), "BODY head")

    def hang(self, listener, name, parent):
        """Sets the parameter until the state says that it was read: at its start the simulator writes its own value over it."""

        def read():
            node.set_parameter(f"{HEADLAMP}/{name}/parent_name", parent)
            return listener.next().parent_name.data == parent

        harness.wait_for(read, f"{name} has read its parent {parent}")

    def test_another_parent(self):
        """When the new parent goes, the camera stays where it was with it: that shows where it hung."""
        self.hang(self.eye, "eye", "BODY Far")
        self.assertAlmostEqual(self.eye.next().pose.position.x, 0.1, places=6)
        self.pass_time(0.2)
        answer = self.service("remove_model", RemoveModel)("far")
        self.assertTrue(answer.success, answer)
        state = self.eye.until(lambda state: state.pose.position.x > 1.0, "the camera hangs in the world")
        self.assertAlmostEqual(state.pose.position.x, 7.1, places=5)
        self.assertAlmostEqual(state.pose.position.z, 2.0, places=5)

    def test_a_loop_is_refused(self):
        """With a message, and so is a name that nobody has; everything goes on."""
        self.hang(self.eye, "eye", "LIGHT lamp")
        for parent, text in (
            ("CAMERA eye", "itself or hangs on it"),
            ("LIGHT lamp", "itself or hangs on it"),
            ("BODY nobody", "not found"),
        ):
            self.hang(self.lamp, "lamp", parent)
            self.wait_for_log(f"parent `{parent}` is {text}")
        node.set_parameter(f"{HEADLAMP}/lamp/parent_name", 7)
        self.wait_for_log("parent_name: expected text")
        self.hang(self.lamp, "lamp", "BODY post")
        self.pass_time(0.2)
