"""Bags that a program records of its own doings."""

import atexit
import signal
import subprocess

from instrument_arm import expect


class Recorder:
    """`rosbag record` of topics into the file `path`, from the time when it has more than `begun` bytes until `stop`.

    ROS's own program is started without its front end in Python, which has no option for the space that must be free on the disk:
    by default it records nothing where less than 1 GB is free."""

    def __init__(self, path, begun, *topics):
        self.path = path
        partial = path.with_suffix(".bag.active")
        for old in (path, partial):
            old.unlink(missing_ok=True)
        command = ["/usr/lib/rosbag/record", "--quiet", "--min-space=20M", "-O", path, *topics]
        self._process = subprocess.Popen(command)
        atexit.register(self._process.terminate)
        expect("recording", lambda: partial.exists() and partial.stat().st_size > begun)

    def stop(self):
        """Closes the bag."""
        self._process.send_signal(signal.SIGINT)
        self._process.wait(30)
        expect("the bag is closed", self.path.exists)
