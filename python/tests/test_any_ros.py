"""One program for client 3.0 with ROS 1; tests/ros2/test_client.py runs it with ROS 2."""

import sys

import harness
import jaws
import support


class AnyRos(support.TimedTest):
    """Beside a simulator with an object of each kind."""

    def test_the_program(self):
        master = harness.Master()
        self.addCleanup(master.stop)
        with harness.Simulator(master.port, *jaws.everything(harness.folder), gui=()):
            command = [sys.executable, "-u", harness.REPOSITORY / "python/tests/any_ros.py", jaws.ADDED, "1"]
            with harness.Program(command, harness.environment(master.port)) as program:
                harness.wait_for(lambda: not program.running(), "the program ends", 3 * harness.PATIENCE_S)
                self.assertEqual(program.status(), 0, program.log())
                self.assertIn("everything obeyed", program.log())
