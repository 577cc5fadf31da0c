"""`BaseObject` under the name that scripts of the C++ simulator import it by."""

from ambf_client.base_object import BaseObject

__all__ = ["BaseObject"]
