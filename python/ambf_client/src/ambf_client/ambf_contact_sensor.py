"""`ContactSensor` under the name that scripts of client 3.0 import it by."""

from .contact_sensor import ContactSensor

__all__ = ["ContactSensor"]
