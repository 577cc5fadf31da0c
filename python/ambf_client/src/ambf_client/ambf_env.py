"""`AmbfEnv` under the name that scripts of client 3.0 import it by."""

from .env import AmbfEnv, Observation

__all__ = ["AmbfEnv", "Observation"]
