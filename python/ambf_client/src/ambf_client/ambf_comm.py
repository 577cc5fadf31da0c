"""All classes in one place, as scripts of client 3.0 import them."""

from . import (
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
from .env import AmbfEnv

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
