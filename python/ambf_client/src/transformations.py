"""Rotations and transforms under the name that scripts of the C++ simulator import them by."""

from ambf_client.transformations import *  # noqa: F403
from ambf_client.transformations import __all__  # noqa: F401
