"""What the tests of this folder talk to: the simulator, started with an arm of ours, or whatever runs already.

With CRTK_ARM=/PSM1 the arm of that name space is tested, on the master of ROS_MASTER_URI or, with CRTK_ROS=2, in the domain ROS_DOMAIN_ID,
and nothing is started. Otherwise the simulator is, with a roscore for ROS 1. CRTK_PROFILE is the profile of its physics."""

import os
import pathlib
import sys
import unittest

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))

CART = ["-a", "resources/models/psm.yaml,resources/models/ecm.yaml", "--crtk", "resources/crtk/cart.yaml"]
ALONE = ["-a", "resources/models/psm.yaml", "--crtk", "resources/crtk/psm.yaml"]


def external():
    """Name space of the arm of another back end; None: ours is started."""
    return os.environ.get("CRTK_ARM")


def start(arguments):
    """Starts what is to be tested and connects this process to it; what was started ends with the module, also where its set-up fails."""
    from middleware import BackEnd, connect

    profile = os.environ.get("CRTK_PROFILE")
    more = ["--profile", profile] if profile else []
    backend = BackEnd([*arguments, *more], external=bool(external()))
    unittest.addModuleCleanup(backend.stop)
    connect(backend)
    return backend
