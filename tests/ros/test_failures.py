"""What the user got wrong: clear messages, the original's exit statuses, and never a panic."""

import bad_scenes
import harness
from scenes import WORLD

BODY = "/ambf/env/Free"


class Starting(harness.RosTest):
    """Wrong files and options."""

    def run_to_end(self, *arguments):
        """Exit status and output of a simulator that ends by itself."""
        with harness.Simulator(self.port, *arguments, gui=()) as simulator:
            status = simulator.status()
            return status, simulator.log()

    def keeps_running(self, *arguments, topics=(f"{WORLD}/State",)):
        """Output of a simulator that comes up all the same."""
        with harness.Simulator(self.port, *arguments) as simulator:
            simulator.wait_for_topics(*topics)
            harness.ros(self.port, "rostopic", "echo", "-n", "1", f"{WORLD}/State")
            self.assertEqual(simulator.interrupt(), 0)
            return simulator.log()

    def test_unusable_launch_files(self):
        """Exit status 255 and the file's name."""
        for name in ("missing.yaml", "broken.yaml", "unfinished_launch.yaml"):
            with self.subTest(name):
                status, log = self.run_to_end("-g0", "--launch_file", harness.scene / name)
                self.assertEqual(status, 255, log)
                self.assertIn(name, log)

    def test_models_that_can_not_be_loaded(self):
        """They are named and skipped; the rest is there."""
        launch = ("--launch_file", harness.scene / "launch.yaml")
        for index, word in (("2", "broken.yaml"), ("3", "nothere.STL"), ("99", "99"), ("x", "x")):
            with self.subTest(index):
                log = self.keeps_running(*launch, "-l", f"{index},1", topics=(f"{WORLD}/State", f"{BODY}/State"))
                self.assertIn(word, log)
        for name in ("broken.yaml", "missing.yaml"):
            with self.subTest(name):
                log = self.keeps_running(*launch, "-a", harness.scene / name)
                self.assertIn(name, log)

    def test_mistakes_in_models(self):
        """Each is named with its file; what is sound is there, and every published number is finite."""
        files = [harness.bad_scene / name for name in bad_scenes.FILES]
        arguments = ("--launch_file", harness.scene / "launch.yaml", "-l1", "-a", ",".join(map(str, files)))
        with harness.Simulator(self.port, *arguments) as simulator:
            simulator.wait_for_topics(f"{BODY}/State", "/ambf/env/Same/State", "/ambf/env/ZeroAxisB/State")
            bodies = [name for name in harness.published(self.port) if name.endswith("/State") and "World" not in name]
            for name in bodies:
                text = harness.ros(self.port, "rostopic", "echo", "-n", "1", name)
                self.assertNotRegex(text, r"\b(nan|inf)\b")
            self.assertTrue(simulator.running())
            self.assertEqual(simulator.interrupt(), 0)
            log = simulator.log()
        for name, (_, words) in bad_scenes.FILES.items():
            lines = [line for line in log.splitlines() if name in line or name == "same_name.yaml"]
            for word in words:
                self.assertTrue(any(word in line for line in lines), f"{word} of {name} in:\n{log}")

    def test_nothing_to_load(self):
        """An empty world is a world."""
        self.keeps_running("--launch_file", harness.scene / "launch.yaml", "-l99")

    def test_unknown_options_are_named(self):
        """A typing error doesn't stay unnoticed."""
        log = self.keeps_running("--launch_file", harness.scene / "launch.yaml", "--frobnicate", "17", "__name:=me")
        for word in ("--frobnicate", "17"):
            self.assertIn(word, log)
        # Arguments of ROS are no unknown options.
        self.assertIn("node /me", log)
        self.assertNotIn("__name", log)

    def test_malformed_options(self):
        """A sentence with the option's name and exit status 2."""
        for option, *more in (
            ("--phx_frequency", "fast"),
            ("--ns",),
            ("--phx_frequency=1", "-p2"),
            ("--show_gui", "maybe"),
        ):
            with self.subTest(option):
                status, log = self.run_to_end(option, *more)
                self.assertEqual(status, 2, log)
                self.assertIn(option.split("=")[0], log)

    def test_help_and_version(self):
        """Exit status 0."""
        for option, word in (
            ("--help", "--load_multibodies"),
            ("-h", "--launch_file"),
            ("--version", "ambf_simulator"),
        ):
            status, log = self.run_to_end(option)
            self.assertEqual(status, 0)
            self.assertIn(word, log)
