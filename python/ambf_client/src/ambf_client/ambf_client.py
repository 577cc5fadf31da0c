"""`Client` under the name that scripts of client 3.0 import it by."""

from .client import Client

__all__ = ["Client"]
