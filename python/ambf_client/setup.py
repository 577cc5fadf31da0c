"""For `colcon build`, which looks for this file; everything else is in pyproject.toml."""

from setuptools import setup

setup(
    # By these, programs of ROS 2 find the package.
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/ambf_client"]),
        ("share/ambf_client", ["package.xml"]),
    ],
)
