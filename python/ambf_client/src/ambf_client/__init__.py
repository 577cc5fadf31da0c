"""Client of the AMBF simulator: finds its objects over ROS 1 or ROS 2, commands them and reads their states.

SI units and radians everywhere. Poses of bodies, wrenches and twists are in world axes, poses of cameras, lights, sensors and
actuators in the frame of their parent. Quaternions are (x, y, z, w).
"""

from __future__ import annotations

from . import installed  # noqa: F401
from .actuator import Actuator
from .base_object import BaseObject
from .client import Client
from .contact_sensor import ContactSensor
from .errors import (
    ClientError,
    MasterNotFound,
    ObjectNotFound,
    SimulationLost,
    SimulatorNotFound,
    SimulatorTimeout,
    StepRefused,
    UnsupportedCommand,
    UnsupportedRos,
)
from .ghost import GhostObject
from .legacy_object import Object
from .posed import Camera, Light
from .rigid_body import RigidBody
from .sensor import Sensor
from .soft_body import SoftBody
from .vehicle import Vehicle
from .watch_dog import WatchDog
from .world import StepResult, World

__all__ = [
    "Actuator",
    "BaseObject",
    "Camera",
    "Client",
    "ClientError",
    "ContactSensor",
    "GhostObject",
    "Light",
    "MasterNotFound",
    "Object",
    "ObjectNotFound",
    "RigidBody",
    "Sensor",
    "SimulationLost",
    "SimulatorNotFound",
    "SimulatorTimeout",
    "SoftBody",
    "StepRefused",
    "StepResult",
    "UnsupportedCommand",
    "UnsupportedRos",
    "Vehicle",
    "WatchDog",
    "World",
]
