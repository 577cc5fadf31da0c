"""`BaseObject` under the name that scripts of client 3.0 import it by."""

from .base_object import BaseObject

__all__ = ["BaseObject"]
