"""The simulator as a program that tests start, and the scene it shows."""

import pathlib
import signal
import subprocess
import sys
import tempfile

from ambf_msgs.msg import RigidBodyState
from harness import REPOSITORY, STOP_S, Ros2Test, environment, program
from rclpy.qos import QoSProfile

sys.path.append(str(REPOSITORY / "tests/ros"))
import scenes  # noqa: E402

MANY = QoSProfile(depth=5000)
FREE = "/ambf/env/Free"


class Simulator:
    """The simulator without windows. `scene`: a launch file, and which of its models; by default a free box and a wall."""

    def __init__(self, domain, folder, *arguments, scene=None, **variables):
        file, index = scene or (folder / "launch.yaml", 1)
        command = [program("ambf_simulator"), "-g", "0", "-l", str(index), "--launch_file", file, *arguments]
        self.log_file = folder / "log"
        with self.log_file.open("w") as log:
            self.process = subprocess.Popen(
                command, env=dict(environment(domain), **variables), stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )

    def log(self):
        """What it has said."""
        return self.log_file.read_text()

    def threads(self):
        """Names of its threads."""
        tasks = pathlib.Path(f"/proc/{self.process.pid}/task").iterdir()
        return sorted((task / "comm").read_text().strip() for task in tasks)

    def ticks(self, name):
        """Processor time of its threads called `name`, hundredths of a second."""
        tasks = pathlib.Path(f"/proc/{self.process.pid}/task").iterdir()
        stats = [(task / "stat").read_text() for task in tasks if (task / "comm").read_text().strip() == name]
        return sum(int(field) for stat in stats for field in stat.rsplit(")", 1)[1].split()[11:13])

    def maps(self):
        """What is in its memory: libraries above all."""
        return pathlib.Path(f"/proc/{self.process.pid}/maps").read_text()

    def close(self):
        """Ends it as Ctrl+C does."""
        self.process.send_signal(signal.SIGINT)
        try:
            assert self.process.wait(STOP_S) == 0, self.log()
        finally:
            self.process.kill()
        assert "panicked" not in self.log(), self.log()


class Simulated(Ros2Test):
    """Tests with a simulator."""

    def setUp(self):
        super().setUp()
        folder = tempfile.TemporaryDirectory(prefix="ambf-ros2-tests-")
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name) / "scene"
        scenes.write(self.folder)

    def simulator(self, *arguments, **variables):
        """A simulator that lasts no longer than the test."""
        simulator = Simulator(self.domain, self.folder, *arguments, **variables)
        self.addCleanup(simulator.close)
        return simulator

    def with_state(self, *arguments, **variables):
        """A simulator, a client, and the states of the free box, of which there is one."""
        simulator, client = self.simulator("--ros", "2", *arguments, **variables), self.client()
        states = client.listen(RigidBodyState, f"{FREE}/State", MANY)
        client.wait_for(lambda: states, "a state")
        return simulator, client, states
