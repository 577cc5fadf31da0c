"""What the end-to-end tests share."""

import contextlib
import io
import json
import os
import shutil
import sys
import time
import unittest

import harness
import yaml

RESOURCES = harness.REPOSITORY / "resources"


def use_master(port):
    """This process' ROS programs use the master at `port`."""
    for name, value in harness.environment(port).items():
        if name.startswith("ROS_"):
            os.environ[name] = value
    # Environments start the same simulator as the tests.
    os.environ["AMBF_SIMULATOR"] = str(harness.simulator_path())


def moved(name, x):
    """The model of that name in resources/models, `x` m aside, so that several find place side by side; its path."""
    # Aliases in the file would move twice.
    model = json.loads(json.dumps(yaml.safe_load((RESOURCES / "models" / f"{name}.yaml").read_text())))
    keys = [key for kind in ("bodies", "soft bodies", "ghost objects") for key in model.get(kind) or ()]
    for key in keys:
        if not model[key].get("parent"):
            model[key].setdefault("location", {}).setdefault("position", {"x": 0, "y": 0, "z": 0})["x"] += x
    folder = harness.folder / "moved"
    path = folder / "models" / f"{name}_{x}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(model, indent=1))
    shutil.copytree(RESOURCES / "meshes", folder / "meshes", dirs_exist_ok=True)
    return path


def simulator(port, models, *options):
    """A simulator with these model files, in fixed steps, 5 m apart; `models` are names in resources/models."""
    files = ",".join(str(moved(name, 5.0 * i)) for i, name in enumerate(models))
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
