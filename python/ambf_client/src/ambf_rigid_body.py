"""`RigidBody` under the name that scripts of the C++ simulator import it by."""

from ambf_client.rigid_body import RigidBody

__all__ = ["RigidBody"]
