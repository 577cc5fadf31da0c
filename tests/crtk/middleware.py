"""The version of ROS over which this process talks to arms: 1, or 2 with CRTK_ROS=2. Both modules have the same functions."""

import os

if os.environ.get("CRTK_ROS") == "2":
    from over_ros2 import STEP, TAKES_LATCHED, BackEnd, Publisher, Subscriber, ask, connect, messages, nanoseconds, now
else:
    from over_ros1 import STEP, TAKES_LATCHED, BackEnd, Publisher, Subscriber, ask, connect, messages, nanoseconds, now

__all__ = ["STEP", "TAKES_LATCHED", "BackEnd", "Publisher", "Subscriber", "ask", "connect", "messages", "nanoseconds", "now"]
