"""Which version of ROS is meant, and whether the Python packages for it are there."""

from __future__ import annotations

import os
from importlib.util import find_spec

from .errors import UnsupportedRos

_ADVICE = {
    1: "Debian's package python3-rospy has it, or source the setup file of your installation. For ROS 2 set ROS_VERSION=2",
    2: "source the setup file of your installation (/opt/ros/DISTRIBUTION/setup.bash), or pip install "
    "'ros-jazzy-rclpy[fastrtps]' ros-jazzy-std-msgs ros-jazzy-geometry-msgs. For ROS 1 set ROS_VERSION=1",
}

_MESSAGES = {
    1: "`source scripts/ros-env` in the simulator's repository makes them",
    2: "build the package resources/ros2/ambf_msgs of the simulator's repository with colcon, and source install/setup.bash; "
    "without colcon scripts/ros2-messages makes them",
}


def ros_version() -> int:
    """1 or 2: what the environment variable ROS_VERSION says; without it 1, unless there is rclpy and no rospy.

    Raises UnsupportedRos for other values of the variable.
    """
    asked = os.environ.get("ROS_VERSION", "")
    if asked in ("1", "2"):
        return int(asked)
    if asked:
        raise UnsupportedRos(f"ROS_VERSION is {asked}: set it to 1 or 2, or unset it")
    return 2 if find_spec("rospy") is None and find_spec("rclpy") is not None else 1


def check_packages() -> int:
    """The version of ROS, as `ros_version`.

    Raises UnsupportedRos if Python packages for it are missing; the message says which, and where they come from.
    """
    version = ros_version()
    library = {1: "rospy", 2: "rclpy"}[version]
    if find_spec(library) is None:
        raise UnsupportedRos(f"the client needs {library} for ROS {version}: {_ADVICE[version]}")
    for package in ("std_msgs", "geometry_msgs"):
        if find_spec(package) is None:
            raise UnsupportedRos(
                f"the client needs the Python classes of {package} for ROS {version}: {_ADVICE[version]}"
            )
    try:
        from ambf_msgs.msg import WorldState
    except ImportError as error:
        raise UnsupportedRos(
            f"the Python classes of ambf_msgs for ROS {version} are missing; {_MESSAGES[version]}"
        ) from error
    # What the generator of ROS 1 writes has it.
    found = 1 if hasattr(WorldState, "_md5sum") else 2
    if found != version:
        raise UnsupportedRos(
            f"ROS {version} is meant, but the Python classes of ambf_msgs that are found first are those for ROS {found}: "
            f"set ROS_VERSION={found}, or change PYTHONPATH; {_MESSAGES[version]}"
        )
    return version
