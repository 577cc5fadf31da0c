"""`GhostObject` under the name that scripts of the C++ simulator import it by."""

from ambf_client.ghost import GhostObject

__all__ = ["GhostObject"]
