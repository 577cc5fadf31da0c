"""`Sensor` under the name that scripts of client 3.0 import it by."""

from .sensor import Sensor

__all__ = ["Sensor"]
