"""An X server without a screen, for windows in tests."""

import os
import subprocess


class Display:
    """Runs until `stop`, or to the end of a `with`, which gives its name, such as `:7`."""

    def __init__(self, size=(800, 600)):
        read, write = os.pipe()
        screen = f"{size[0]}x{size[1]}x24"
        self.process = subprocess.Popen(
            ["Xvfb", "-displayfd", str(write), "-screen", "0", screen, "-nolisten", "tcp", "+extension", "GLX"],
            pass_fds=(write,),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(write)
        with os.fdopen(read) as number:
            self.name = f":{number.readline().strip()}"

    def stop(self):
        """Ends the server, as if the window system went away."""
        self.process.terminate()
        self.process.wait()

    def __enter__(self):
        return self.name

    def __exit__(self, *_):
        self.stop()
