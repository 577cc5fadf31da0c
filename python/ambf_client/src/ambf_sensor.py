"""`Sensor` under the name that scripts of the C++ simulator import it by."""

from ambf_client.sensor import Sensor

__all__ = ["Sensor"]
