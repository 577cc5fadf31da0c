"""`Camera` under the name that scripts of the C++ simulator import it by."""

from ambf_client.posed import Camera

__all__ = ["Camera"]
