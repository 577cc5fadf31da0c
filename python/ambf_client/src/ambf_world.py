"""`World` under the name that scripts of the C++ simulator import it by."""

from ambf_client.world import World

__all__ = ["World"]
