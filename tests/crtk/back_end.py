"""What the tests of this folder talk to: the simulator, started with an arm of ours, or whatever runs already.

With CRTK_ARM=/PSM1 the arm of that name space is tested on the master of ROS_MASTER_URI, and nothing is started. Otherwise a roscore and
the simulator are."""

import os
import subprocess
import sys
import urllib.parse

import harness

CART = ["-a", "resources/models/psm.yaml,resources/models/ecm.yaml", "--crtk", "resources/crtk/cart.yaml"]
ALONE = ["-a", "resources/models/psm.yaml", "--crtk", "resources/crtk/psm.yaml"]


def external():
    """Name space of the arm of another back end; None: ours is started."""
    return os.environ.get("CRTK_ARM")


def messages():
    """Generates the Python classes of crtk_msgs."""
    source = harness.REPOSITORY / "resources/ros/crtk_msgs/msg"
    package = harness.python_messages / "crtk_msgs"
    generator = ["/usr/bin/python3", "/usr/lib/genpy/genmsg_py.py"]
    package.mkdir(parents=True, exist_ok=True)
    (package / "__init__.py").touch()
    files = [source / "OperatingState.msg", source / "StringStamped.msg"]
    include = ["-I", f"crtk_msgs:{source}", "-I", "std_msgs:/usr/share/std_msgs/msg"]
    subprocess.run([*generator, "-p", "crtk_msgs", "-o", package / "msg", *include, *files], check=True)
    subprocess.run([*generator, "--initpy", "-o", package / "msg"], check=True)
    if str(harness.python_messages) not in sys.path:
        sys.path.insert(0, str(harness.python_messages))


class BackEnd:
    """A master, and a simulator on it unless another back end is tested."""

    def __init__(self, *arguments):
        self.master = self.simulator = None
        if external():
            self.port = urllib.parse.urlparse(os.environ["ROS_MASTER_URI"]).port
        else:
            self.master = harness.Master()
            self.port = self.master.port
            os.chdir(harness.REPOSITORY)
            self.simulator = harness.Simulator(self.port, *arguments)

    def stop(self):
        """Ends what was started."""
        if self.simulator:
            self.simulator.stop()
            self.simulator.check_log()
        if self.master:
            self.master.stop()
