"""`Vehicle` under the name that scripts of client 3.0 import it by."""

from .vehicle import Vehicle

__all__ = ["Vehicle"]
