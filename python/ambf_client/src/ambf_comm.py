"""All classes in one place, as scripts of the C++ simulator import them."""

from ambf_client.ambf_comm import *  # noqa: F403
