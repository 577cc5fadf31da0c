"""`Object` under the name that scripts of the C++ simulator import it by."""

from ambf_client.legacy_object import Object

__all__ = ["Object"]
