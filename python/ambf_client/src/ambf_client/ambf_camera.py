"""`Camera` under the name that scripts of client 3.0 import it by."""

from .posed import Camera

__all__ = ["Camera"]
