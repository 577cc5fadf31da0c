"""What the end-to-end tests share."""

import contextlib
import io
import os
import sys
import time
import unittest

import harness
import jaws
from jaws import RESOURCES


def use_master(port):
    """This process' ROS programs use the master at `port`."""
    for name, value in harness.environment(port).items():
        if name.startswith("ROS_"):
            os.environ[name] = value
    # Environments start the same simulator as the tests.
    os.environ["AMBF_SIMULATOR"] = str(harness.simulator_path())


def simulator(port, models, *options):
    """A simulator with these model files, in fixed steps, 5 m apart; `models` are names in resources/models."""
    files = ",".join(str(jaws.moved(name, 5.0 * i, harness.folder)) for i, name in enumerate(models))
    arguments = ("-t", "1", "--launch_file", RESOURCES / "launch.yaml", "-a", files, *options)
    return harness.Simulator(port, *arguments).wait_for_topics("/ambf/env/World/State")


def script(port, text, *arguments):
    """A Python program that runs `text`."""
    return harness.Program([sys.executable, "-u", "-c", text, *arguments], harness.environment(port))


def quiet():
    """Catches what is said to the user."""
    return contextlib.redirect_stderr(io.StringIO())


class TimedTest(unittest.TestCase):
    """Tests that bound how long something takes."""

    @contextlib.contextmanager
    def within(self, seconds):
        """Fails if the block takes longer."""
        begin = time.monotonic()
        yield
        self.assertLess(time.monotonic() - begin, seconds)
