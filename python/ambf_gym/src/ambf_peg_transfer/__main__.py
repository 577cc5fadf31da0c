"""The referee as a ROS program, for ROS 1 and ROS 2 (`ROS_VERSION`): it watches a simulator and publishes how the run stands.

`/ambf/env/peg_transfer/score`, `std_msgs/String`: JSON, 10 times a second (`Score.as_dict`). A reset of the world, and a
`std_msgs/Empty` on `/ambf/env/peg_transfer/start`, begin a new run. It needs the package `ambf_client`, and commands nothing.
"""

from __future__ import annotations

import argparse
import json
import threading
from typing import Any, Dict, Optional, Sequence

from ambf_msgs.msg import RigidBodyState
from ros_abstraction_layer import ral
from std_msgs.msg import Empty, String

from .board import ASYMMETRIC, SYMMETRIC
from .referee import Pose, Referee

ENV = "/ambf/env"
ARMS = ("psm1", "psm2")


class Watcher:
    """Newest states, and the referee that looks at them."""

    def __init__(self, referee: Referee, layer: Any) -> None:
        self._referee = referee
        self._lock = threading.Lock()
        self._poses: Dict[str, Pose] = {}
        self._time: Optional[float] = None
        blocks = {name: f"phantom/{name}" for name in referee.board.blocks}
        arms = {f"{arm}/{part}": f"{arm}/{part}" for arm in ARMS for part in ("baselink", "toolyawlink")}
        board = {"board": f"phantom/{referee.board.body}"}
        self._needed = list(blocks)
        self._kept = [
            layer.subscriber(f"{ENV}/{path}/State", RigidBodyState, self._hear(key))
            for key, path in {**blocks, **arms, **board}.items()
        ]
        for topic in ("World/Command/Reset", "World/Command/Reset/Bodies", "peg_transfer/start"):
            self._kept.append(layer.subscriber(f"{ENV}/{topic}", Empty, self._begin))

    def _hear(self, key: str) -> Any:
        def take(state: Any) -> None:
            at, turn = state.pose.position, state.pose.orientation
            with self._lock:
                self._poses[key] = Pose((at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w))
                self._time = float(state.sim_time)

        return take

    def _begin(self, message: Any) -> None:
        del message
        with self._lock:
            self._referee.reset()

    def look(self) -> Optional[str]:
        """The score as JSON; None before all blocks have been seen."""
        with self._lock:
            if self._time is None or any(name not in self._poses for name in self._needed):
                return None
            tools, bases = (
                {arm: self._poses[f"{arm}/{part}"] for arm in ARMS if f"{arm}/{part}" in self._poses}
                for part in ("toolyawlink", "baselink")
            )
            blocks = {name: self._poses[name] for name in self._needed}
            score = self._referee.update(self._time, blocks, tools, bases, self._poses.get("board"))
            return json.dumps(score.as_dict())


def main(arguments: Optional[Sequence[str]] = None) -> None:
    """Watches until ROS ends."""
    parser = argparse.ArgumentParser(prog="python -m ambf_peg_transfer", description=__doc__)
    parser.add_argument("--asymmetric", action="store_true", help="the board of six blocks and 13 pegs")
    parser.add_argument(
        "--print", action="store_true", help="print each score that differs from the one before but for its time"
    )
    options, _ = parser.parse_known_args(arguments)
    layer = ral("peg_transfer_referee")
    watcher = Watcher(Referee(ASYMMETRIC if options.asymmetric else SYMMETRIC), layer)
    publisher = layer.publisher(f"{ENV}/peg_transfer/score", String, 1)
    layer.spin()
    rate = layer.create_rate(50)
    shown: Optional[Dict[str, Any]] = None
    count = 0
    while not layer.is_shutdown():
        text = watcher.look()
        count += 1
        if text is not None and count % 5 == 0:
            publisher.publish(String(data=text))
            values = {**json.loads(text), "time": 0}
            if options.print and values != shown:
                shown = values
                print(text, flush=True)
        rate.sleep()


if __name__ == "__main__":
    main()
