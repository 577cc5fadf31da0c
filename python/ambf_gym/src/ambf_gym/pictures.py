"""Pictures that a simulator publishes over ROS."""

from __future__ import annotations

import threading
import time
from typing import Any, Dict, List, Optional, Tuple

import numpy as np
import rospy
from numpy.typing import NDArray
from sensor_msgs.msg import Image

from .backend import Picture
from .errors import InvalidDescription, SimulatorFailed

_TOPICS = {
    "rgb": ("ImageData", "rgb8", np.uint8, 3, "publish image"),
    "depth": ("DepthImage", "32FC1", np.float32, 1, "publish depth"),
}


class CameraTopics:
    """Subscriptions of the cameras of a simulator, made when their pictures are asked for."""

    def __init__(self, namespace: str) -> None:
        """`namespace`: what the topics of the simulator begin with."""
        self._namespace = namespace
        self._streams: Dict[str, _Stream] = {}

    def take(
        self,
        camera: Optional[str],
        size: Tuple[Optional[int], Optional[int]],
        rgb: bool,
        depth: bool,
        stamp: Optional[Any],
        timeout: float,
    ) -> Picture:
        """Pictures whose stamp is `stamp` or later, of one frame; `timeout` in s."""
        wanted = [name for name, is_wanted in (("rgb", rgb), ("depth", depth)) if is_wanted]
        deadline = time.monotonic() + timeout
        streams = [self._stream(name, camera) for name in wanted]
        picture: Picture = {}
        for name, stream in zip(wanted, streams):
            picture[name] = _array(name, stream.wait(stamp, deadline, timeout), size)
        return picture

    def close(self) -> None:
        """Ends all subscriptions."""
        streams, self._streams = self._streams, {}
        for stream in streams.values():
            stream.close()

    def _stream(self, name: str, camera: Optional[str]) -> _Stream:
        suffix, _, _, _, key = _TOPICS[name]
        published: List[Tuple[str, str]] = rospy.get_published_topics(self._namespace or "/")
        topics = sorted(
            topic for topic, kind in published if kind == "sensor_msgs/Image" and topic.endswith(f"/{suffix}")
        )
        cameras = [topic[: -len(suffix) - 1] for topic in topics]
        if not cameras:
            raise InvalidDescription(
                f"no camera publishes {suffix}: over ROS pictures are those of cameras with `{key}: true` in their file; in this process "
                "(in_process=True) every camera has pictures"
            )
        found = [one for one in cameras if camera is None or one == camera or one.endswith(f"/{camera}")][
            : 1 if camera is None else None
        ]
        found = found or [one for one in cameras if camera is not None and camera in one]
        if len(found) != 1:
            several = "several cameras that publish" if found else "none of the cameras that publish"
            raise InvalidDescription(f'"{camera}" names {several} {suffix}: {", ".join(found or cameras)}')
        topic = f"{found[0]}/{suffix}"
        if topic not in self._streams:
            self._streams[topic] = _Stream(topic)
        return self._streams[topic]


class _Stream:
    """The newest message of a topic."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._changed = threading.Condition()
        self._newest: Optional[Image] = None
        self._subscriber = rospy.Subscriber(topic, Image, self._take, queue_size=1, buff_size=2**25)

    def _take(self, message: Image) -> None:
        with self._changed:
            self._newest = message
            self._changed.notify_all()

    def wait(self, stamp: Optional[Any], deadline: float, timeout: float) -> Image:
        """The newest picture that is no older than `stamp`."""
        with self._changed:
            while self._newest is None or (stamp is not None and self._newest.header.stamp < stamp):
                left = deadline - time.monotonic()
                if left <= 0.0:
                    raise SimulatorFailed(f"no picture of the last step on {self._topic} within {timeout} s")
                self._changed.wait(left)
            return self._newest

    def close(self) -> None:
        """Unsubscribes."""
        self._subscriber.unregister()


def _array(name: str, message: Image, size: Tuple[Optional[int], Optional[int]]) -> NDArray[Any]:
    _, encoding, kind, channels, _ = _TOPICS[name]
    if message.encoding != encoding:
        raise SimulatorFailed(f"pictures of {name} are encoded as {message.encoding}, not {encoding}")
    for given, there in zip(size, (message.width, message.height)):
        if given is not None and given != there:
            raise InvalidDescription(
                f"over ROS pictures have the size that the camera publishes, {message.width}x{message.height}; "
                f"{size[0]}x{size[1]} is asked for"
            )
    order = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    pixels: NDArray[Any] = rows[:, : message.width * channels * order.itemsize].copy().view(order).astype(kind)
    return pixels.reshape(
        (message.height, message.width, channels) if channels > 1 else (message.height, message.width)
    )
