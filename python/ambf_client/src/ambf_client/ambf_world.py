"""`World` under the name that scripts of client 3.0 import it by."""

from .world import World

__all__ = ["World"]
