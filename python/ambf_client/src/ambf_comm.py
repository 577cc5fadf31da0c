"""All classes in one place, as scripts of the C++ simulator import them."""

from ambf_client import (
    Actuator,
    Camera,
    Client,
    ContactSensor,
    GhostObject,
    Light,
    Object,
    RigidBody,
    Sensor,
    Vehicle,
    WatchDog,
    World,
)
from ambf_client.env import AmbfEnv

__all__ = [
    "Actuator",
    "AmbfEnv",
    "Camera",
    "Client",
    "ContactSensor",
    "GhostObject",
    "Light",
    "Object",
    "RigidBody",
    "Sensor",
    "Vehicle",
    "WatchDog",
    "World",
]
