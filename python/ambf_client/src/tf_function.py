"""What the package of that name held in the C++ simulator's sources: `transformations` and all that is in it."""

from ambf_client import transformations  # noqa: F401
from ambf_client.transformations import *  # noqa: F403
