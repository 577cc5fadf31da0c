"""`Object` under the name that scripts of client 3.0 import it by."""

from .legacy_object import Object

__all__ = ["Object"]
