"""Models come and go while the simulation runs: services, topics, parameters, and what others notice of it."""

import math
import threading

import harness
import node
import rospy
from ambf_msgs.msg import ActuatorCmd, ActuatorState, CameraState, RigidBodyCmd, RigidBodyState, WorldCmd
from ambf_msgs.srv import AddModel, ListModels, RemoveModel
from scenes import NOWHERE, box, model
from simulated import MODELS, WORLD, Ros, Simulated, written
from std_msgs.msg import String

setUpModule, tearDownModule = Ros.start, Ros.stop


def weightless(name, **where):
    """A body that nothing pulls at."""
    return {**box(name, 1.0, **where), "gravity": NOWHERE}


class Changing(Simulated):
    """A simulator with one body that flies freely, and clients of its services."""

    def setUp(self):
        self.FILES = (written("flyer.yaml", model({"BODY Flyer": weightless("Flyer", z=5.0)})), *self.more_files())
        super().setUp()
        self.add_model = self.service("add_model", AddModel)
        self.remove_model = self.service("remove_model", RemoveModel)
        self.list_models = self.service("list_models", ListModels)
        self.flyer = self.listen("/ambf/env/Flyer/State", RigidBodyState)

    def more_files(self):
        """Further models to begin with."""
        return ()

    def added(self, path):
        """Adds a model without a problem; its name."""
        answer = self.add_model(str(path))
        self.assertEqual((answer.success, answer.message), (True, ""), answer)
        return answer.model

    def removed(self, name):
        """Removes a model."""
        answer = self.remove_model(name)
        self.assertTrue(answer.success, answer)

    def names(self):
        """Of the models there are."""
        return self.list_models().models

    def wait_for_end_of(self, *topics):
        """Waits until the master knows none of `topics`."""
        harness.wait_for(lambda: not set(topics) & harness.published(Ros.master.port), f"{topics} are gone")

    def fly(self):
        """Sets the body in motion along x: 0.5 m/s, and nothing to stop it."""
        command = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_VELOCITY)
        command.twist.linear.x = 0.5
        with node.Stream("/ambf/env/Flyer/Command", command):
            self.flyer.until(lambda state: abs(state.twist.linear.x - 0.5) < 1e-6, "it flies")
        # Until the watchdog has cleared the command it would steer.
        self.pass_time(1.0)


class Services(Changing):
    """Adding, listing and removing."""

    def test_a_model_comes_works_and_goes(self):
        """Its topics appear, its states come, its commands work; then all is as before."""
        before = (self.names(), harness.published(Ros.master.port))
        name = self.added(MODELS / "pendulum.yaml")
        self.assertEqual(self.names(), [*before[0], name])
        self.assertEqual(self.list_models().files[-1], str(MODELS / "pendulum.yaml"))
        new = harness.wait_for(lambda: harness.published(Ros.master.port) - before[1], "topics appear")
        bodies = [topic for topic in new if topic.endswith("/State")]
        self.assertTrue(bodies)
        for topic in bodies:
            with node.Listener(topic, RigidBodyState) as listener:
                listener.until(lambda state: state.sim_step > 0, "states come")
        self.removed(name)
        self.assertEqual(self.names(), before[0])
        harness.wait_for(lambda: harness.published(Ros.master.port) == before[1], "its topics are gone")

    def test_commands_to_what_was_added(self):
        """A joint of the new model obeys, also when the same name comes for the second time."""
        for _ in range(2):
            name = self.added(harness.scene / "pendulum.yaml")
            with node.Listener("/ambf/env/Base/State", RigidBodyState) as base:
                base.until(lambda state: state.joint_names == ["Base-Link"], "the joint is named")
                command = RigidBodyCmd(joint_cmds=[0.5], joint_cmds_types=[RigidBodyCmd.TYPE_POSITION])
                with node.Stream("/ambf/env/Base/Command", command):
                    base.until(lambda state: abs(state.joint_positions[0] - 0.5) < 0.1, "the joint obeys")
            self.removed(name)
            self.wait_for_end_of("/ambf/env/Base/State", "/ambf/env/Link/State")

    def test_the_same_file_twice(self):
        """The second set of names ends in 1, and goes without the first."""
        other = written("other.yaml", model({"BODY Other": weightless("Other", x=3.0)}))
        first = self.added(other)
        with node.Listener("/ambf/env/Other/State", RigidBodyState) as listener:
            self.assertEqual(listener.newest().identifier.data, "/ambf/env/BODY Other")
            # What is in the same place would push the first away.
            push = RigidBodyCmd()
            push.wrench.force.z = 5.0
            with node.Stream("/ambf/env/Other/Command", push):
                listener.until(lambda state: state.pose.position.z > 1.0, "the first is out of the way")
        second = self.added(other)
        self.assertNotEqual(first, second)
        self.simulator.wait_for_topics("/ambf/env/Other1/State")
        with node.Listener("/ambf/env/Other1/State", RigidBodyState) as listener:
            state = listener.newest()
            self.assertEqual((state.identifier.data, state.name.data), ("/ambf/env/BODY Other1", "Other1"))
            self.assertAlmostEqual(state.pose.position.z, 0.0, places=4)
        self.removed(second)
        self.wait_for_end_of("/ambf/env/Other1/State")
        with node.Listener("/ambf/env/Other/State", RigidBodyState) as listener:
            self.assertGreater(listener.newest().pose.position.z, 1.0)
        self.removed(first)
        self.wait_for_end_of("/ambf/env/Other/State")

    def test_others_are_not_disturbed(self):
        """A body that flies freely keeps its velocity and its course while models come and go."""
        self.fly()
        first = self.flyer.next()
        for file in ("gripper.yaml", "car.yaml", "hanging_arm.urdf", "headlamp.yaml") * 2:
            answer = self.add_model(str(MODELS / file))
            self.assertTrue(answer.success, answer)
            self.removed(answer.model)
        last = self.flyer.next()
        self.assertLess(abs(last.twist.linear.x - first.twist.linear.x), 1e-6)
        way = last.pose.position.x - first.pose.position.x
        # Simulated time has single precision on the wire.
        self.assertAlmostEqual(way, 0.5 * (last.sim_time - first.sim_time), delta=0.002)
        self.assertLess(math.hypot(last.pose.position.y, last.pose.position.z - 5.0), 1e-6)
        self.assertEqual(self.names(), ["/ambf/env/ground.yaml", "/ambf/env/flyer.yaml"])

    def test_a_urdf_model(self):
        """A robot description of ROS: its links are bodies, its joints obey."""
        answer = self.add_model(str(MODELS / "hanging_arm.urdf"))
        self.assertTrue(answer.success, answer)
        topics = set()

        def root():
            topics.update(t for t in harness.published(Ros.master.port) if t.endswith("/State") and "arm" in t)
            for topic in topics:
                with node.Listener(topic, RigidBodyState) as listener:
                    if len(listener.newest().joint_names) == 7:
                        return topic
            return None

        base = harness.wait_for(root, "a body with seven joints")
        with node.Listener(base, RigidBodyState) as listener:
            command = RigidBodyCmd(joint_cmds=[0.3], joint_cmds_types=[RigidBodyCmd.TYPE_POSITION])
            with node.Stream(base.replace("/State", "/Command"), command):
                listener.until(lambda state: abs(state.joint_positions[0] - 0.3) < 0.1, "the first joint obeys")
        self.removed(answer.model)
        self.wait_for_end_of(*topics)

    def test_parameters_come_and_go(self):
        """Those of a camera go with its model."""
        name = self.added(MODELS / "headlamp.yaml")
        parameter = "/ambf/env/headlamp/eye/near_plane"
        harness.wait_for(lambda: rospy.get_param(parameter, None) == 0.05, "the parameter is there")
        with node.Listener("/ambf/env/headlamp/eye/State", CameraState) as eye:
            self.assertEqual(eye.newest().parent_name.data, "BODY head")
        self.removed(name)
        harness.wait_for(lambda: rospy.get_param(parameter, None) is None, "the parameter is gone")

    def test_many_clients(self):
        """Requests of many clients at once are all done, one after another."""
        files = [written(f"many{i}.yaml", model({f"BODY M{i}": weightless(f"M{i}", x=20.0 + i)})) for i in range(8)]
        failed = []

        def work(path):
            for _ in range(5):
                add = self.service("add_model", AddModel)
                remove = self.service("remove_model", RemoveModel)
                answer = add(str(path))
                if not (answer.success and remove(answer.model).success):
                    failed.append((path, answer))

        threads = [threading.Thread(target=work, args=(path,)) for path in files]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(harness.PATIENCE_S)
        self.assertEqual(failed, [])
        self.assertFalse(any(thread.is_alive() for thread in threads))
        self.assertEqual(len(self.names()), 2)


class Refused(Changing):
    """What can't be added or removed is answered with the reason, and nothing else happens."""

    def test_files_of_no_use(self):
        """Missing, broken, a folder, no text, and none at all."""
        self.fly()
        before = (self.names(), harness.published(Ros.master.port))
        garbage = harness.folder / "garbage.yaml"
        garbage.write_bytes(bytes(range(256)) * 40)
        cases = (
            (harness.folder / "none.yaml", "none.yaml"),
            (harness.scene / "broken.yaml", "broken.yaml"),
            (harness.folder, str(harness.folder)),
            (garbage, "garbage.yaml"),
            ("", ""),
            ("x" * 5000, ""),
        )
        for path, text in cases:
            with self.subTest(str(path)[:40]):
                answer = self.add_model(str(path))
                self.assertFalse(answer.success, answer)
                self.assertTrue(answer.message and text in answer.message, answer)
        self.assertEqual((self.names(), harness.published(Ros.master.port)), before)
        self.assertAlmostEqual(self.flyer.next().twist.linear.x, 0.5, places=6)

    def test_a_file_with_mistakes(self):
        """What is sound in it comes, and the answer names the rest with file and line."""
        bodies = {"BODY Sound": weightless("Sound", x=9.0), "BODY Heavy": {**box("Heavy", 1.0), "mass": -1.0}}
        answer = self.add_model(str(written("half.yaml", model(bodies))))
        self.assertTrue(answer.success, answer)
        self.assertRegex(answer.message, r"half\.yaml:\d+")
        self.assertIn("BODY Heavy", answer.message)
        self.simulator.wait_for_topics("/ambf/env/Sound/State")
        self.assertNotIn("/ambf/env/Heavy/State", harness.published(Ros.master.port))

    def test_a_soft_body_comes_too_late(self):
        """The world of a scene that began without one can't hold it: its ball comes, and the answer says what doesn't."""
        answer = self.add_model(str(MODELS / "cloth.yaml"))
        self.assertTrue(answer.success, answer)
        self.assertIn("soft bodies can be added only to a scene that began with one", answer.message)
        self.simulator.wait_for_topics("/ambf/env/cloth/ball/State")
        self.removed(answer.model)

    def test_names_of_no_model(self):
        """Nobody's, several models', and that of the world's ground."""
        for i in range(2):
            self.added(written(f"pair{i}.yaml", model({f"BODY P{i}": weightless(f"P{i}", x=30.0 + i)})))
        before = self.names()
        cases = (("nobody.yaml", "not found"), ("pair", "part of several"), ("ground", "environment"), ("", ""))
        for name, text in cases:
            with self.subTest(name):
                answer = self.remove_model(name)
                self.assertFalse(answer.success, answer)
                self.assertIn(text, answer.message)
        self.assertEqual(self.names(), before)
        self.removed("pair1")


class Standstill(Changing):
    """Models come and go while the physics waits."""

    def test_while_a_client_throttles(self):
        """They are there at once; a step is still a step."""
        names = iter("ABCDE")
        step = self.simulator.while_commanded("World", lambda: self.come_and_go_between_steps(f"Late{next(names)}"))
        self.flyer.until(lambda state: state.sim_step > step + 50, "without commands the physics runs freely")

    def come_and_go_between_steps(self, body):
        """Adds a body while the physics waits, and removes it five steps later; the step."""
        command = WorldCmd(enable_step_throttling=True, n_skip_steps=5)
        with node.Stream(f"{WORLD}/Command", command):
            harness.wait_for(lambda: len({self.flyer.next().sim_step for _ in range(10)}) == 1, "the physics waits")
            before = self.flyer.next().sim_step
            name = self.added(written(f"{body}.yaml", model({f"BODY {body}": weightless(body, x=4.0)})))
            with node.Listener(f"/ambf/env/{body}/State", RigidBodyState) as late:
                self.assertAlmostEqual(late.newest().pose.position.x, 4.0, places=6)
                # A model is published at once, with the step that waits to be published.
                self.assertLessEqual(late.next().sim_step, before + 1)
                self.assertIn(name, self.names())
                self.assertFalse(self.remove_model("nobody.yaml").success)
                self.assertLessEqual(late.next().sim_step, before + 1)
                command.step_clock = True
                late.until(lambda state: state.sim_step == before + 5, "five steps")
            self.removed(name)
            self.wait_for_end_of(f"/ambf/env/{body}/State")
            self.assertLessEqual(self.flyer.next().sim_step, before + 6)
        return before

    def test_while_the_simulation_is_paused(self):
        """After a state that was lost: a reset brings everything back, the new model too."""
        command = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_VELOCITY)
        command.twist.linear.x = command.twist.angular.y = 1e308
        with node.Stream("/ambf/env/Flyer/Command", command):
            self.wait_for_log("the simulation is paused")
        name = self.added(written("late.yaml", model({"BODY Late": box("Late", 1.0, x=4.0, z=2.0)})))
        with node.Listener("/ambf/env/Late/State", RigidBodyState) as late:
            self.assertAlmostEqual(late.newest().pose.position.z, 2.0, places=3)

            def runs():
                # Until the watchdog has cleared the command, a reset only loses the state again.
                self.reset()
                return late.next().twist.linear.z < -0.05

            harness.wait_for(runs, "it falls after a reset")
        self.assertTrue(math.isfinite(self.flyer.next().pose.position.x))
        self.removed(name)


class Held(Changing):
    """An actuator and what it holds, each in a model of its own."""

    def more_files(self):
        grip = {"name": "grip", "type": "Constraint", "parent": "BODY Hand"}
        hand = model({"BODY Hand": box("Hand", 0.0, x=10.0)})
        return (written("hand.yaml", {**hand, "actuators": ["ACTUATOR grip"], "ACTUATOR grip": grip}),)

    def test_what_is_held_is_removed(self):
        """The actuator lets go, says once that it can't find the body, and holds the next of that name."""
        load = written("load.yaml", model({"BODY Load": box("Load", 1.0, x=10.0, z=-0.3)}))
        grip = self.listen("/ambf/env/grip/State", ActuatorState)
        name = self.added(load)
        command = ActuatorCmd(actuate=True, body_name=String("BODY Load"))
        with node.Stream("/ambf/env/grip/Command", command) as stream:
            grip.until(lambda state: state.actuated, "it holds")
            self.removed(name)
            grip.until(lambda state: not state.actuated, "it holds nothing")
            self.wait_for_log("body `BODY Load` is not found")
            self.pass_time(0.5)
            self.assertEqual(self.count_in_log("body `BODY Load` is not found"), 1)
            self.added(load)
            grip.until(lambda state: state.actuated, "it holds again")
            with node.Listener("/ambf/env/Load/State", RigidBodyState) as held:
                height = held.newest().pose.position.z
                self.pass_time(0.5)
                self.assertAlmostEqual(held.next().pose.position.z, height, delta=0.005)
                stream.command = ActuatorCmd()
                held.until(lambda state: state.pose.position.z < height - 0.5, "it falls")

    def test_what_holds_is_removed(self):
        """Then the body falls, and the topics of the actuator go."""
        grip = self.listen("/ambf/env/grip/State", ActuatorState)
        # It is there first: what falls meanwhile could lie on the ground.
        with node.Stream("/ambf/env/grip/Command", ActuatorCmd(actuate=True, body_name=String("BODY Load"))):
            self.added(written("load.yaml", model({"BODY Load": box("Load", 1.0, x=10.0, z=-0.3)})))
            load = self.listen("/ambf/env/Load/State", RigidBodyState)
            grip.until(lambda state: state.actuated, "it holds")
            height = load.next().pose.position.z
            self.pass_time(0.3)
            self.assertAlmostEqual(load.next().pose.position.z, height, delta=0.005)
            self.removed("hand.yaml")
            load.until(lambda state: state.pose.position.z < height - 0.5, "it falls")
        self.wait_for_end_of("/ambf/env/grip/State", "/ambf/env/Hand/State")
