"""`ral` under the name that scripts of the C++ simulator import it by."""

from ambf_client.ros_abstraction_layer import ral

__all__ = ["ral"]
