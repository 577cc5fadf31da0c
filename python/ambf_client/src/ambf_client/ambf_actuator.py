"""`Actuator` under the name that scripts of client 3.0 import it by."""

from .actuator import Actuator

__all__ = ["Actuator"]
