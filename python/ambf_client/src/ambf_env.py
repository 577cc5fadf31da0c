"""`AmbfEnv` under the name that scripts of the C++ simulator import it by."""

from ambf_client.env import AmbfEnv, Observation

__all__ = ["AmbfEnv", "Observation"]
