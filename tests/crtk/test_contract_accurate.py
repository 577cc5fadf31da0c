"""The contract again, with the physics of the profile `accurate`."""

import os
import unittest

import back_end
import test_contract
from test_contract import Contract  # noqa: F401

def setUpModule():
    """The same arms in the other profile."""
    if back_end.external():
        raise unittest.SkipTest("another back end has no profiles")
    os.environ["CRTK_PROFILE"] = "accurate"
    test_contract.setUpModule()
