"""`GhostObject` under the name that scripts of client 3.0 import it by."""

from .ghost import GhostObject

__all__ = ["GhostObject"]
