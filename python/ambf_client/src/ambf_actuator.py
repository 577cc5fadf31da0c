"""`Actuator` under the name that scripts of the C++ simulator import it by."""

from ambf_client.actuator import Actuator

__all__ = ["Actuator"]
