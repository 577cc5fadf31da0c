"""The simulator beside rclpy: `ambf_simulator --ros 2`."""

import math
import os
import socket
import subprocess
import time
import xml.etree.ElementTree
import xmlrpc.client

from ambf_msgs.msg import RigidBodyCmd, RigidBodyState, WorldCmd, WorldState
from ambf_msgs.srv import AddModel, ListModels, RemoveModel, Step
from crtk_msgs.msg import OperatingState, StringStamped
from geometry_msgs.msg import PoseStamped
from harness import PATIENCE_S, REPOSITORY, program
from rcl_interfaces.msg import Log, Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from simulator import FREE, MANY, Simulated
from std_msgs.msg import Empty, String
from tf2_msgs.msg import TFMessage


class Served(Simulated):
    """The simulator's topics, services and parameters."""

    def test_topics_and_nodes_are_there(self):
        simulator, client, states = self.with_state()
        wanted = {
            f"{FREE}/State": "ambf_msgs/msg/RigidBodyState",
            f"{FREE}/Command": "ambf_msgs/msg/RigidBodyCmd",
            "/ambf/env/World/State": "ambf_msgs/msg/WorldState",
            "/ambf/env/World/Timing": "ambf_msgs/msg/Timing",
            "/ambf/env/World/Command": "ambf_msgs/msg/WorldCmd",
            "/ambf/env/World/Command/Reset": "std_msgs/msg/Empty",
            "/ambf/env/lights/lamp/State": "ambf_msgs/msg/LightState",
            "/ambf/env/cameras/eye/Command": "ambf_msgs/msg/CameraCmd",
            "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
        }
        client.wait_for(
            lambda: wanted.items() <= {(n, t[0]) for n, t in client.node.get_topic_names_and_types()}, "topics"
        )
        self.assertNotIn("/clock", dict(client.node.get_topic_names_and_types()))
        nodes = {"ambf_env_Free", "ambf_env_World", "ambf_env_lights_lamp"}
        client.wait_for(lambda: nodes <= set(client.node.get_node_names()), "the nodes")
        published = client.node.get_publisher_names_and_types_by_node("ambf_env_Free", "/")
        self.assertEqual(published, [(f"{FREE}/State", ["ambf_msgs/msg/RigidBodyState"])])
        ours = [name for name in simulator.threads() if name.startswith(("ros", "RustDDS"))]
        self.assertLessEqual(len(ours), 4, ours)
        self.assertEqual(states[0].name.data, "Free")
        self.assertAlmostEqual(states[0].header.stamp.sec, time.time(), delta=PATIENCE_S)
        worlds = client.listen(WorldState, "/ambf/env/World/State", MANY)
        client.wait_for(lambda: len(worlds) > 5, "states of the world")
        self.assertGreater(worlds[-1].sim_step, worlds[0].sim_step)

    def test_commands_move_a_body_and_a_reset_returns_it(self):
        _, client, states = self.with_state()
        publisher = client.node.create_publisher(RigidBodyCmd, f"{FREE}/Command", 1)
        client.wait_for(lambda: publisher.get_subscription_count() == 1, "the subscription")
        command = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_FORCE)
        command.wrench.force.x = 5.0

        def moved():
            publisher.publish(command)
            return states[-1].pose.position.x > 0.5

        client.wait_for(moved, "the body moves")
        command.wrench.force.x = math.nan
        publisher.publish(command)
        reset = client.node.create_publisher(Empty, "/ambf/env/World/Command/Reset", 1)
        client.wait_for(lambda: reset.get_subscription_count() == 1, "the subscription")

        def returned():
            reset.publish(Empty())
            return abs(states[-1].pose.position.x) < 0.1

        client.wait_for(returned, "the body is where it was")

    def test_states_come_at_the_higher_rate_while_commands_come(self):
        _, client, states = self.with_state()
        publisher = client.node.create_publisher(RigidBodyCmd, f"{FREE}/Command", 1)
        client.wait_for(lambda: publisher.get_subscription_count() == 1, "the subscription")

        def rate():
            publisher.publish(RigidBodyCmd())
            last = states[-200:]
            times = [state.header.stamp.sec + state.header.stamp.nanosec * 1e-9 for state in last]
            return len(last) == 200 and 199 / (times[-1] - times[0]) > 300.0

        client.wait_for(rate, "more than 300 states a second")

    def test_steps_are_made_one_by_one(self):
        _, client, _ = self.with_state()
        first = client.call(Step, "/ambf/env/World/Step", Step.Request(steps=1, patience=30.0))
        self.assertTrue(first.success, first.message)
        command = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_FORCE)
        command.wrench.force.x = 1.0
        for number in range(20):
            request = Step.Request(steps=5, patience=30.0, observe=[FREE], body_names=[FREE], body_commands=[command])
            answer = client.call(Step, "/ambf/env/World/Step", request)
            self.assertTrue(answer.success, answer.message)
            self.assertEqual(answer.sim_step, first.sim_step + 5 * (number + 1))
            self.assertEqual(answer.bodies[0].sim_step, answer.sim_step)
        self.assertGreater(answer.bodies[0].twist.linear.x, 0.0)
        wrong = client.call(Step, "/ambf/env/World/Step", Step.Request(observe=["/nobody"]))
        self.assertIn("/nobody", wrong.message)

    def test_models_come_and_go(self):
        _, client, _ = self.with_state()

        def topics():
            return {name for name, _ in client.node.get_topic_names_and_types()}

        file = str(self.folder / "pendulum.yaml")
        added = client.call(AddModel, "/ambf/env/World/AddModel", AddModel.Request(file=file))
        self.assertTrue(added.success, added.message)
        client.wait_for(lambda: "/ambf/env/Link/State" in topics(), "topics of the model")
        client.wait_for(lambda: "ambf_env_Link" in client.node.get_node_names(), "nodes of the model")
        listed = client.call(ListModels, "/ambf/env/World/ListModels", ListModels.Request())
        self.assertIn(added.model, listed.models)
        removed = client.call(RemoveModel, "/ambf/env/World/RemoveModel", RemoveModel.Request(model=added.model))
        self.assertTrue(removed.success, removed.message)
        client.wait_for(lambda: "ambf_env_Link" not in client.node.get_node_names(), "the end of the model's nodes")

    def test_parameters_of_a_light_are_read_and_set(self):
        _, client, _ = self.with_state()
        node, name = "/ambf_env_lights_lamp", "/ambf/env/lights/lamp/cutoff_angle"
        listed = client.call(ListParameters, f"{node}/list_parameters", ListParameters.Request())
        self.assertIn(name, listed.result.names)

        def angle():
            answer = client.call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=[name]))
            return answer.values[0].double_value

        self.assertAlmostEqual(angle(), 0.7)

        def result(number):
            value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=number)
            request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
            return client.call(SetParameters, f"{node}/set_parameters", request).results[0]

        self.assertTrue(result(0.25).successful)
        self.assertEqual(angle(), 0.25)
        self.assertFalse(result(math.nan).successful)
        self.assertEqual(angle(), 0.25)

    def test_the_clock_is_published_when_asked_for(self):
        _, client, states = self.with_state("--clock")
        clocks = client.listen(Clock, "/clock", MANY)
        client.wait_for(lambda: len(clocks) > 100, "the clock")
        times = [clock.clock.sec + clock.clock.nanosec * 1e-9 for clock in clocks]
        self.assertEqual(times, sorted(times))
        state = states[-1]
        self.assertAlmostEqual(state.header.stamp.sec + state.header.stamp.nanosec * 1e-9, state.sim_time, delta=1e-3)

    def test_frames_and_the_description_come_when_asked_for(self):
        _, client, states = self.with_state("--tf=100")
        messages = client.listen(TFMessage, "/tf", MANY)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        descriptions = client.listen(String, "/robot_description", latched)

        def common():
            stamps = {(state.header.stamp.sec, state.header.stamp.nanosec): state.pose.position for state in states}
            frames = [transform for message in messages for transform in message.transforms]
            free = [transform for transform in frames if transform.child_frame_id == FREE.strip("/")]
            pairs = [(stamps.get((one.header.stamp.sec, one.header.stamp.nanosec)), one) for one in free]
            return [(position, one) for position, one in pairs if position is not None]

        client.wait_for(common, "a state and a frame of one step")
        position, frame = common()[-1]
        self.assertEqual(frame.header.frame_id, "world")
        at = frame.transform.translation
        self.assertEqual((at.x, at.y, at.z), (position.x, position.y, position.z))
        client.wait_for(lambda: descriptions, "the description")
        links = {link.get("name") for link in xml.etree.ElementTree.fromstring(descriptions[-1].data).iter("link")}
        self.assertEqual(links, {"world", *(transform.child_frame_id for transform in messages[-1].transforms)})

    def test_both_versions_at_once(self):
        with socket.socket() as probe:
            probe.bind(("localhost", 0))
            port = probe.getsockname()[1]
        uri = f"http://localhost:{port}"
        self.simulator("--ros", "both", ROS_MASTER_URI=uri, ROS_HOSTNAME="localhost")
        self.addCleanup(
            subprocess.run, [program("ambf_simulator"), "--end-master"], env=dict(os.environ, ROS_MASTER_URI=uri)
        )
        client = self.client()
        states = client.listen(RigidBodyState, f"{FREE}/State", MANY)
        client.wait_for(lambda: states, "a state")

        def ros1_topics():
            try:
                return dict(xmlrpc.client.ServerProxy(uri).getPublishedTopics("/test", "")[2])
            except (OSError, xmlrpc.client.Error):
                return {}

        client.wait_for(lambda: ros1_topics().get(f"{FREE}/State") == "ambf_msgs/RigidBodyState", "the topic of ROS 1")

    def test_an_arm_is_moved_by_a_client_of_crtk(self):
        """Its states come, a state command is heard, and joints go where they are told."""
        arms = REPOSITORY / "resources/crtk/psm.yaml"
        self.simulator("--ros", "2", "-a", REPOSITORY / "resources/models/psm.yaml", "--crtk", arms)
        client = self.client()
        joints = client.listen(JointState, "/PSM1/measured_js", MANY)
        poses = client.listen(PoseStamped, "/PSM1/measured_cp", MANY)
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        states = client.listen(OperatingState, "/PSM1/operating_state", latched)
        client.wait_for(lambda: joints and poses and states, "states of the arm")
        self.assertEqual((states[0].state, states[0].is_homed), ("ENABLED", True))
        self.assertEqual(len(joints[0].position), 6)
        self.assertEqual(joints[-1].header.frame_id, joints[0].header.frame_id)
        command = client.node.create_publisher(StringStamped, "/PSM1/state_command", 10)
        servo = client.node.create_publisher(JointState, "/PSM1/servo_jp", 10)
        client.wait_for(lambda: servo.get_subscription_count() and command.get_subscription_count(), "subscriptions")
        goal = [0.1, -0.1, 0.12, 0.2, 0.0, 0.0]

        def is_there():
            servo.publish(JointState(position=goal))
            return max(abs(own - wanted) for own, wanted in zip(joints[-1].position, goal)) < 0.01

        client.wait_for(is_there, "the joints are where they were told to be")
        command.publish(StringStamped(string="disable"))
        client.wait_for(lambda: states[-1].state == "DISABLED", "the arm is disabled")

    def test_the_program_is_told_what_nodes_of_ros_2_are_told(self):
        """A namespace, another name, other names of topics and services, parameters of its own and of objects."""
        light = "/ambf/env/lights/lamp"
        words = f"-r {FREE}/State:=/lab/box -r {FREE}/Command:=box_command -r /ambf/env/World/Step:=/step -r __ns:=/lab"
        words += f" -r __node:=sim -p rate:=50 -p {light}/cutoff_angle:=0.25"
        points = "/ambf/env/World/point_cloud_topics"
        file = self.folder / "parameters.yaml"
        file.write_text(f"/**:\n  ros__parameters:\n    {points}: [/points]\n    gains: {{p: 1.5}}\n")
        self.simulator("--ros", "2", "--ros-args", *words.split(), "--params-file", file, "--", "-p", "500")
        client = self.client()
        states = client.listen(RigidBodyState, "/lab/box", MANY)
        client.wait_for(lambda: states, "a state")
        publisher = client.node.create_publisher(RigidBodyCmd, "/lab/box_command", 1)
        client.wait_for(lambda: publisher.get_subscription_count() == 1, "the subscription")
        self.assertTrue(client.call(Step, "/step", Step.Request(steps=1, patience=0.1)).success)

        def nodes():
            return set(client.node.get_node_names_and_namespaces())

        client.wait_for(lambda: {("sim", "/lab"), ("ambf_env_Free", "/lab")} <= nodes(), "the nodes")

        def values(node, *names):
            request = GetParameters.Request(names=names)
            return client.call(GetParameters, f"/lab/{node}/get_parameters", request).values

        rate, gain = values("sim", "rate", "gains.p")
        self.assertEqual((rate.integer_value, gain.double_value), (50, 1.5))
        self.assertEqual(values("ambf_env_lights_lamp", f"{light}/cutoff_angle")[0].double_value, 0.25)
        self.assertEqual(list(values("ambf_env_World", points)[0].string_array_value), ["/points"])

    def test_arguments_of_ros_1_act_on_ros_2(self):
        self.simulator("--ros", "2", f"{FREE}/State:=/lab/box", "__name:=sim", "_rate:=50")
        client = self.client()
        states = client.listen(RigidBodyState, "/lab/box", MANY)
        client.wait_for(lambda: states, "a state")
        client.wait_for(lambda: "sim" in client.node.get_node_names(), "the node")

    def test_arguments_that_are_wrong_say_what_was_expected(self):
        for words, expected in (("-r a=b", "FROM:=TO"), ("--log-level loud", "debug, info"), ("-l 1", "--ros-args")):
            command = [program("ambf_simulator"), "--ros-args", *words.split()]
            ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
            self.assertEqual(ended.returncode, 2, ended.stderr)
            self.assertIn(expected, ended.stderr)

    def test_lines_for_users_are_on_rosout(self):
        """Also those that were said before somebody listened."""
        simulator, client, _ = self.with_state()
        latched = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        lines = client.listen(Log, "/rosout", latched)
        reset = client.node.create_publisher(Empty, "/ambf/env/World/Command/Reset", 1)
        client.wait_for(lambda: reset.get_subscription_count() == 1, "the subscription")

        def ours(text):
            return [line for line in lines if line.name == "ambf_simulator" and text in line.msg]

        def is_said():
            reset.publish(Empty())
            return ours("reset")

        client.wait_for(is_said, "a line")
        line = ours("reset")[-1]
        self.assertEqual(line.level, int.from_bytes(Log.INFO, "little") if isinstance(Log.INFO, bytes) else Log.INFO)
        self.assertAlmostEqual(line.stamp.sec, time.time(), delta=PATIENCE_S)
        late = self.client("late")
        late_lines = late.listen(Log, "/rosout", latched)
        late.wait_for(lambda: [line for line in late_lines if "reset" in line.msg], "the line, later")
        command = client.node.create_publisher(RigidBodyCmd, f"{FREE}/Command", 1)
        client.wait_for(lambda: command.get_subscription_count() == 1, "the subscription")
        wrong = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_FORCE)
        wrong.wrench.force.x = math.nan

        def warned():
            command.publish(wrong)
            return [line for line in ours(f"{FREE}/Command") if line.level == 30]

        client.wait_for(warned, "a warning")
        self.assertIn(warned()[0].msg, simulator.log())

    def test_what_is_less_important_is_not_said(self):
        simulator, client = self.simulator("--ros", "2", "--ros-args", "--log-level", "warn"), self.client()
        lines = client.listen(Log, "/rosout", QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        reset = client.node.create_publisher(Empty, "/ambf/env/World/Command/Reset", 1)
        command = client.node.create_publisher(RigidBodyCmd, f"{FREE}/Command", 1)
        client.wait_for(lambda: command.get_subscription_count() and reset.get_subscription_count(), "subscriptions")
        wrong = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_FORCE)
        wrong.wrench.force.x = math.nan

        def warned():
            reset.publish(Empty())
            command.publish(wrong)
            return [line for line in lines if f"{FREE}/Command" in line.msg]

        client.wait_for(warned, "a warning")
        self.assertNotIn("reset", [line.msg for line in lines])
        self.assertNotIn("reset\n", simulator.log())

    def test_clocked_steps_are_seen_by_clients_of_both_versions(self):
        """A client of ROS 2 clocks the physics, and its states come at once although ROS 1 is served, too."""
        with socket.socket() as probe:
            probe.bind(("localhost", 0))
            uri = f"http://localhost:{probe.getsockname()[1]}"
        self.addCleanup(
            subprocess.run, [program("ambf_simulator"), "--end-master"], env=dict(os.environ, ROS_MASTER_URI=uri)
        )
        arguments = {"ROS_MASTER_URI": uri, "ROS_HOSTNAME": "localhost"}
        simulator = self.simulator("--ros", "both", **arguments)
        client = self.client()
        states = client.listen(WorldState, "/ambf/env/World/State", MANY)
        publisher = client.node.create_publisher(WorldCmd, "/ambf/env/World/Command", MANY)
        client.wait_for(lambda: states and publisher.get_subscription_count() == 1, "the world")
        command = WorldCmd(enable_step_throttling=True, n_skip_steps=1)

        def hold():
            first = len(states)

            def is_held():
                # Said again and again, or the watchdog ends it.
                publisher.publish(command)
                return len(states) > first + 5 and len({state.sim_step for state in states[-5:]}) == 1

            client.wait_for(is_held, "the hold")

        def step():
            """The step counts before and after one clock edge."""
            before = states[-1].sim_step
            command.step_clock = not command.step_clock

            def is_done():
                publisher.publish(command)
                return states[-1].sim_step > before

            client.wait_for(is_done, "the step")
            return before, states[-1].sim_step

        hold()
        done = 0
        while done < 50:
            expired = simulator.log().count('Resetting "World" command')
            before, after = step()
            if simulator.log().count('Resetting "World" command') > expired:
                # On a busy machine the commands paused for so long that the watchdog ended the hold.
                hold()
                continue
            self.assertEqual(after, before + 1)
            done += 1

    def test_a_domain_that_is_none_is_said_and_the_simulation_goes_on(self):
        simulator = self.simulator("--ros", "2", ROS_DOMAIN_ID="abc")
        end = time.monotonic() + PATIENCE_S
        while 'ROS 2 is not available: ROS_DOMAIN_ID is "abc"' not in simulator.log():
            self.assertLess(time.monotonic(), end, simulator.log())
            time.sleep(0.02)
        self.assertIsNone(simulator.process.poll())
