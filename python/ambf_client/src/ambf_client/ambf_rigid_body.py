"""`RigidBody` under the name that scripts of client 3.0 import it by."""

from .rigid_body import RigidBody

__all__ = ["RigidBody"]
