"""`Vehicle` under the name that scripts of the C++ simulator import it by."""

from ambf_client.vehicle import Vehicle

__all__ = ["Vehicle"]
