"""A simulator of one's own: a program that ends with this one, on a ROS master of this process."""

from __future__ import annotations

import itertools
import os
import socket
import subprocess
import tempfile
from pathlib import Path
from typing import Any, Optional

from .errors import SimulatorFailed
from .scene import Scene, resources, simulator

_NUMBERS = itertools.count()
_MASTER: Optional[Any] = None
_MASTER_PROCESS = 0

# Ends the simulator when its input is closed, which happens however this process ends. Some programs kill their children before they
# end, Ray's workers for example: then the guard's end is the simulator's too.
_GUARD = 'setpriv --pdeathsig KILL "$@" </dev/null & child=$!; read -r _; kill -TERM $child 2>/dev/null; wait $child'


def own_master() -> str:
    """Address of a ROS master in this process, which is this process' from now on unless it is a ROS node already.

    Raises SimulatorFailed in a process that was forked from a ROS node: rospy's threads are not there.
    """
    global _MASTER, _MASTER_PROCESS
    import rospy

    if _MASTER is not None and os.getpid() != _MASTER_PROCESS:
        raise SimulatorFailed(
            "this process was forked from one that had an environment open; start it with 'spawn' instead"
        )
    if _MASTER is None:
        if rospy.get_name() != "/unnamed":
            return os.environ["ROS_MASTER_URI"]
        # Local, and known by that name, whatever this host is called.
        os.environ["ROS_HOSTNAME"] = "localhost"
        os.environ.pop("ROS_IP", None)
        import rosmaster.master

        _MASTER = rosmaster.master.Master(_free_port())
        _MASTER.start()
        _MASTER_PROCESS = os.getpid()
        os.environ["ROS_MASTER_URI"] = _MASTER.uri
    return str(_MASTER.uri)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return int(probe.getsockname()[1])


class SimulatorProcess:
    """Runs `ambf_simulator` with fixed steps; in a namespace of its own, so there may be many."""

    def __init__(self, scene: Scene, shown: bool = False) -> None:
        """`shown`: with windows."""
        self.namespace = f"/gym{os.getpid()}_{next(_NUMBERS)}"
        self.master = own_master()
        launch = scene.launch() or str(resources() / "launch.yaml")
        handle, log = tempfile.mkstemp(prefix="ambf_gym_", suffix=".log")
        self._log = Path(log)
        command = [
            simulator(),
            "-g",
            "1" if shown else "0",
            "-t",
            "1",
            "--hold",
            "--ns",
            self.namespace,
            "--launch_file",
            launch,
        ]
        command += ["-a", ",".join(scene.model_files()), *scene.profile_options(), *scene.options]
        self._process = subprocess.Popen(
            ["/bin/sh", "-c", _GUARD, "ambf_gym", *command],
            stdin=subprocess.PIPE,
            stdout=handle,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        os.close(handle)

    def log(self) -> str:
        """What it has printed."""
        try:
            return self._log.read_text(errors="replace")
        except FileNotFoundError:
            return ""

    def close(self) -> None:
        """Ends it, within 5 s by force."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, 9)
            self._process.wait()
        self._log.unlink(missing_ok=True)
