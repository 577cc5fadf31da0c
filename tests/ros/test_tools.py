"""ROS's command line tools see and drive the simulator."""

import re

import harness
import yaml
from scenes import CAMERA, LIGHT, WORLD

BODY = "/ambf/env/Free"


class Tools(harness.RosTest):
    """One simulator for all tests."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.simulator = harness.Simulator(cls.port, "--launch_file", harness.scene / "launch.yaml", "-l0,1")
        cls.simulator.wait_for_topics(f"{WORLD}/State", f"{BODY}/State", "/ambf/env/Link/State")

    @classmethod
    def tearDownClass(cls):
        cls.simulator.stop()
        super().tearDownClass()

    def tearDown(self):
        self.assertTrue(self.simulator.running())
        self.simulator.check_log()

    def test_rostopic_list(self):
        """All states and commands, normalised, and none of passive bodies."""
        listed = set(harness.ros(self.port, "rostopic", "list").split())
        objects = ["World", "Base", "Link", "Free", "Wall", "lights/lamp", "cameras/eye"]
        expected = {f"/ambf/env/{name}/{end}" for name in objects for end in ("State", "Command")}
        resets = ("Reset", "Reset/Bodies", "ResetBodies")
        expected |= {f"{WORLD}/Command/{name}" for name in resets} | {f"{WORLD}/Timing"}
        found = {name for name in listed if name.startswith("/ambf")} - {
            f"{WORLD}/point_cloud",
            f"{WORLD}/point_cloud/radius",
        }
        self.assertEqual(found, expected)
        self.assertFalse([name for name in listed if "//" in name])

    def test_rostopic_type(self):
        """Types by which clients find objects."""
        for topic, kind in (
            (f"{WORLD}/State", "ambf_msgs/WorldState"),
            (f"{WORLD}/Command", "ambf_msgs/WorldCmd"),
            (f"{WORLD}/Command/Reset", "std_msgs/Empty"),
            (f"{WORLD}/Timing", "ambf_msgs/Timing"),
            (f"{BODY}/State", "ambf_msgs/RigidBodyState"),
            (f"{BODY}/Command", "ambf_msgs/RigidBodyCmd"),
            (f"{LIGHT}/State", "ambf_msgs/LightState"),
            (f"{CAMERA}/State", "ambf_msgs/CameraState"),
            (f"{CAMERA}/Command", "ambf_msgs/CameraCmd"),
        ):
            self.assertEqual(harness.ros(self.port, "rostopic", "type", topic).strip(), kind)

    def test_rostopic_echo(self):
        """A state can be printed and read back."""
        text = harness.ros(self.port, "rostopic", "echo", "-n", "1", f"{BODY}/State")
        state = yaml.safe_load(text.split("---")[0])
        self.assertEqual((state["name"]["data"], state["mass"]), ("Free", 1.0))

    def test_rostopic_hz(self):
        """Both ways of counting agree on about 50 Hz."""
        with harness.Program(["rostopic", "hz", f"{WORLD}/State"], harness.environment(self.port)) as tool:
            rates = lambda: re.findall(r"average rate: ([\d.]+)", tool.log())  # noqa: E731
            harness.wait_for(lambda: rates() and 35 <= float(rates()[-1]) <= 65, "rostopic hz prints about 50 Hz")

    def test_rostopic_pub(self):
        """A command from the shell moves a body."""
        command = [
            "rostopic",
            "pub",
            "-r",
            "20",
            f"{BODY}/Command",
            "ambf_msgs/RigidBodyCmd",
            "{wrench: {force: {y: 2.0}}}",
        ]

        def speed():
            text = harness.ros(self.port, "rostopic", "echo", "-n", "1", f"{BODY}/State/twist/linear/y")
            return float(text.split()[0]) > 0.1

        with harness.Program(command, harness.environment(self.port)):
            harness.wait_for(speed, "the body is faster than 0.1 m/s")

    def test_rosparam(self):
        """Parameters of the world and of lights."""
        names = ["/ambf/env/World/point_cloud_topics"]
        names += [f"{LIGHT}/{name}" for name in ("cutoff_angle", "parent_name", "type")]
        names += [f"{CAMERA}/{name}" for name in ("near_plane", "far_plane", "field_view_angle", "projection", "mode")]
        harness.wait_for(lambda: set(names) <= set(harness.ros(self.port, "rosparam", "list").split()), names)
        self.assertEqual(yaml.safe_load(harness.ros(self.port, "rosparam", "get", names[0])), [f"{WORLD}/point_cloud"])
        self.assertAlmostEqual(float(harness.ros(self.port, "rosparam", "get", names[1])), 0.7, places=5)
        self.assertEqual(harness.ros(self.port, "rosparam", "get", names[3]).strip(), "SPOT")
        self.assertEqual(harness.ros(self.port, "rosparam", "get", f"{CAMERA}/far_plane").strip(), "20.0")

    def test_parameters_of_no_use(self):
        """They are named, change nothing, and the next sound one works."""
        clouds = f"{WORLD}/point_cloud_topics"
        bad = {f"{LIGHT}/cutoff_angle": "wide", f"{CAMERA}/mode": "QUAD", clouds: "7"}
        harness.wait_for(lambda: set(bad) <= set(harness.ros(self.port, "rosparam", "list").split()), "parameters")
        for name, value in bad.items():
            harness.ros(self.port, "rosparam", "set", name, value)
        for word in ("cutoff_angle: expected", "mode: expected", "point_cloud_topics: expected"):
            harness.wait_for(lambda word=word: word in self.simulator.log(), word)
        harness.ros(self.port, "rosparam", "set", f"{LIGHT}/cutoff_angle", "0.7")
        harness.ros(self.port, "rosparam", "set", f"{CAMERA}/mode", "MONO")
        harness.ros(self.port, "rosparam", "set", clouds, f"[{WORLD}/point_cloud, /scan]")
        harness.wait_for(
            lambda: "/scan" in {name for name, _ in harness.state_of(self.port)[1]}, "the simulator listens to /scan"
        )
        harness.ros(self.port, "rosparam", "set", clouds, f"[{WORLD}/point_cloud]")
        harness.wait_for(
            lambda: "/scan" not in {name for name, _ in harness.state_of(self.port)[1]}, "it listens no more"
        )

    def test_rosnode_list(self):
        """One node, with the original's name and a suffix."""
        listed = [name for name in harness.ros(self.port, "rosnode", "list").split() if "ambf" in name]
        self.assertEqual(len(listed), 1, listed)
        self.assertRegex(listed[0], r"^/ambf_comm_node_\w+$")
        info = harness.ros(self.port, "rosnode", "info", listed[0])
        for part in (f"{BODY}/State [ambf_msgs/RigidBodyState]", f"{WORLD}/step", "/rosout [rosgraph_msgs/Log]"):
            self.assertIn(part, info)

    def test_nobody_else_gets_in(self):
        """With a master on this machine: two ports, and only programs of this machine reach them."""
        ports = harness.listening(self.simulator.process.pid)
        self.assertEqual(len(ports), 2, ports)
        self.assertEqual({address for address, _ in ports}, {"127.0.0.1"})


class Names(harness.RosTest):
    """How names depend on options and scene."""

    def states(self, *arguments, expected):
        """Starts a simulator and waits until exactly `expected` bodies are published."""
        with harness.Simulator(self.port, "--launch_file", harness.scene / "launch.yaml", *arguments) as simulator:
            names = {f"{name}/State" for name in expected}
            simulator.wait_for_topics(*names)
            found = {name for name in harness.published(self.port) if name.endswith("/State")}
            self.assertEqual({name for name in found if not re.search("lamp|eye|World", name)}, names)
            texts = [
                harness.ros(self.port, "rostopic", "echo", "-n", "1", f"{name}/State/identifier/data")
                for name in expected
            ]
            return [text.split("---")[0].strip().strip('"') for text in texts]

    def test_duplicates_get_a_number(self):
        """The same model twice is two sets of topics."""
        names = ["/ambf/env/Free", "/ambf/env/Wall", "/ambf/env/Free1", "/ambf/env/Wall1"]
        identifiers = self.states("-l", "1,1", expected=names)
        self.assertEqual(identifiers[::2], ["/ambf/env/BODY Free", "/ambf/env/BODY Free1"])

    def test_prefix_of_all_names(self):
        """`--ns` goes before every topic and identifier."""
        names = ["/left/ambf/env/Free", "/left/ambf/env/Wall"]
        self.assertEqual(self.states("-l1", "--ns", "/left", expected=names)[0], "/left/ambf/env/BODY Free")

    def test_two_simulators_on_one_master(self):
        """Each under its own prefix."""
        launch = ("--launch_file", harness.scene / "launch.yaml", "-l1")
        with harness.Simulator(self.port, *launch, "--ns", "/a") as one, harness.Simulator(
            self.port, *launch, "--ns", "/b"
        ) as two:
            one.wait_for_topics("/a/ambf/env/Free/State")
            two.wait_for_topics("/b/ambf/env/Free/State", "/a/ambf/env/Free/State")
            self.assertEqual(one.interrupt(), 0)
            harness.wait_for(
                lambda: not any(name.startswith("/a/") for name in harness.published(self.port)), "/a is gone"
            )
            harness.ros(self.port, "rostopic", "echo", "-n", "1", "/b/ambf/env/Free/State")


class Endings(harness.RosTest):
    """Ctrl+C leaves nothing behind."""

    def ends_clean(self, simulator):
        """Interrupts and looks at what the master still knows."""
        self.assertEqual(simulator.interrupt(), 0, simulator.log())
        simulator.check_log()
        self.assertEqual(harness.ros(self.port, "rostopic", "list").split(), ["/rosout", "/rosout_agg"])
        self.assertEqual(harness.simulator_nodes(self.port), set())

    def test_while_running(self):
        """With a client listening to it."""
        with harness.Simulator(self.port, "--launch_file", harness.scene / "launch.yaml") as simulator:
            simulator.wait_for_topics(f"{BODY}/State")
            echo = ["rostopic", "echo", "--noarr", f"{BODY}/State"]
            with harness.Program(echo, harness.environment(self.port)) as listener:
                harness.wait_for(lambda: "name" in listener.log(), "rostopic prints a state")
                self.assertEqual(simulator.interrupt(), 0)
            self.ends_clean_after(simulator)

    def ends_clean_after(self, simulator):
        """The same for a simulator that has ended and whose clients have gone."""
        simulator.check_log()
        harness.wait_for(
            lambda: not any(name.startswith("/ambf") for name in harness.published(self.port)), "no topic is left"
        )
        self.assertEqual(harness.simulator_nodes(self.port), set())

    def test_while_loading(self):
        """As soon as it has said a word, and again when the first topic is there."""
        arguments = ("--launch_file", harness.scene / "launch.yaml", "-l4")
        with harness.Simulator(self.port, *arguments) as simulator:
            harness.wait_for(simulator.log, "a first line of output")
            self.ends_clean(simulator)
        with harness.Simulator(self.port, *arguments) as simulator:
            harness.wait_for(
                lambda: any(name.startswith("/ambf") for name in harness.published(self.port)), "a first topic"
            )
            self.ends_clean(simulator)
