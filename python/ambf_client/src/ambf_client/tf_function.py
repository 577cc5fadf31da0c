"""The package of client 2.0 that held `transformations`: everything of that module, and the module itself."""

from . import transformations  # noqa: F401
from .transformations import *  # noqa: F403
