"""Which backend a task runs in."""

from __future__ import annotations

from typing import Any, Dict

from ..backend import Backend
from ..errors import InvalidDescription
from ..scene import Scene


def make_backend(scene: Scene, in_process: bool, ros: Dict[str, Any]) -> Backend:
    """A backend for `scene`. What it needs, ROS or the package `ambf`, is imported here."""
    if not in_process:
        from ..ros_backend import RosBackend

        return RosBackend(scene, **ros)
    if ros:
        raise InvalidDescription(f"in_process has no options, so not {sorted(ros)}")
    from ..in_process import InProcessBackend

    return InProcessBackend(scene)
