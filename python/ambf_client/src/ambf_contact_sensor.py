"""`ContactSensor` under the name that scripts of the C++ simulator import it by."""

from ambf_client.contact_sensor import ContactSensor

__all__ = ["ContactSensor"]
