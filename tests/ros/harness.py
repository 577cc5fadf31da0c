"""Starts ROS masters and the simulator for the tests, and waits for conditions instead of for time to pass."""

import contextlib
import ipaddress
import os
import pathlib
import resource
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import unittest

import rosgraph

import bad_scenes
import scenes

REPOSITORY = pathlib.Path(__file__).resolve().parents[2]
sys.path.append(str(REPOSITORY / "tests"))

from waiting import PATIENCE_S, wait_for  # noqa: E402

STOP_S = 20.0

folder = pathlib.Path(tempfile.mkdtemp(prefix="ambf-ros-tests-"))
scene = folder / "scene"
bad_scene = folder / "bad"
python_messages = folder / "python"


def set_up():
    """Writes the scenes and generates the messages' Python classes; call once a process, before importing ambf_msgs."""
    scenes.write(scene)
    bad_scenes.write(bad_scene)
    subprocess.run([REPOSITORY / "scripts/python-messages", python_messages], check=True)
    sys.path.insert(0, str(python_messages))


def tear_down():
    """Removes what `set_up` and the tests wrote."""
    shutil.rmtree(folder, ignore_errors=True)


def simulator_path():
    """$AMBF_SIMULATOR, else the program built last."""
    if os.environ.get("AMBF_SIMULATOR"):
        return pathlib.Path(os.environ["AMBF_SIMULATOR"])
    target = REPOSITORY / os.environ.get("CARGO_TARGET_DIR", "target")
    built = [target / kind / "ambf_simulator" for kind in ("debug", "release")]
    built = [program for program in built if program.exists()]
    if not built:
        raise FileNotFoundError(f"no ambf_simulator in {target}: run cargo build, or set AMBF_SIMULATOR")
    return max(built, key=lambda program: program.stat().st_mtime)


def free_port():
    """A TCP port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return probe.getsockname()[1]


def listening(process):
    """Address and port of each TCP socket on which a process listens."""
    folder = pathlib.Path(f"/proc/{process}/fd")
    own = {os.readlink(entry) for entry in folder.iterdir() if entry.is_symlink()}
    found = []
    for table, size in (("tcp", 4), ("tcp6", 16)):
        for line in pathlib.Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            row = line.split()
            if row[3] == "0A" and f"socket:[{row[9]}]" in own:
                address, port = row[1].split(":")
                words = [bytes.fromhex(address[i : i + 8])[::-1] for i in range(0, 2 * size, 8)]
                found.append((str(ipaddress.ip_address(b"".join(words))), int(port, 16)))
    return found


def environment(port, **more):
    """Environment of a program whose ROS master is at `port` of this host."""
    env = {name: value for name, value in os.environ.items() if not name.startswith("ROS_")}
    path = [str(python_messages)] + [part for part in env.get("PYTHONPATH", "").split(":") if part]
    env.update(
        ROS_MASTER_URI=f"http://localhost:{port}",
        ROS_HOSTNAME="localhost",
        ROS_HOME=str(folder / "ros"),
        ROS_LOG_DIR=str(folder / "ros/log"),
        ROS_PACKAGE_PATH=f"{REPOSITORY}/resources/ros:/usr/share",
        PYTHONPATH=":".join(path),
        PYTHONUNBUFFERED="1",
    )
    env.update(more)
    return env


def children(process):
    """The processes that `process` has started."""
    found = []
    for entry in pathlib.Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(FileNotFoundError, ProcessLookupError):
                # After the name, which may hold anything: state, parent.
                if int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1]) == process:
                    found.append(int(entry.name))
    return found


class Program:
    """A child process whose output goes to a file; always ended when the `with` block ends."""

    def __init__(self, command, env, address_space=resource.RLIM_INFINITY):
        """`address_space`: bytes that it may reserve."""
        handle, name = tempfile.mkstemp(dir=folder, suffix=".log")
        self._log = pathlib.Path(name)
        self.process = subprocess.Popen(
            [str(word) for word in command],
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=handle,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (address_space, resource.RLIM_INFINITY)),
        )
        os.close(handle)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()

    def log(self):
        """Everything it has printed so far."""
        return self._log.read_text(errors="replace")

    def running(self):
        """Whether it has not ended."""
        return self.process.poll() is None

    def interrupt(self):
        """Sends Ctrl+C and returns the exit status."""
        self.process.send_signal(signal.SIGINT)
        return self.status()

    def status(self):
        """Waits for the exit status."""
        try:
            return self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"does not end; it printed:\n{self.log()}") from None

    def stop(self):
        """Ends it, by force if it doesn't heed Ctrl+C."""
        if self.running():
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(STOP_S)
            except subprocess.TimeoutExpired:
                self.kill()

    def kill(self):
        """Ends it at once, with all its children."""
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()


class Master(Program):
    """A real `roscore`, up when the constructor returns."""

    def __init__(self, port=None):
        self.port = port or free_port()
        super().__init__(["roscore", "-p", self.port], environment(self.port))
        wait_for(lambda: state_of(self.port) and "/rosout" in nodes(self.port), "roscore answers")

    def kill(self):
        """Ends master and log aggregator too: `roscore` gives each a session of its own, in which it outlives `roscore`."""
        parts = children(self.process.pid)
        super().kill()
        for part in parts:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(part, signal.SIGKILL)
        wait_for(lambda: state_of(self.port) is None, "the master is gone")


class Simulator(Program):
    """The simulator, headless. `with` and `close` check that it never panicked."""

    def __init__(self, port, *arguments, gui=("-g", "0"), address_space=resource.RLIM_INFINITY, **env):
        self.port = port
        super().__init__([simulator_path(), *gui, *arguments], environment(port, **env), address_space)

    def __exit__(self, kind, *_):
        self.stop()
        if kind is None:
            self.check_log()
        else:
            print(f"--- the simulator printed:\n{self.log()}---", file=sys.stderr)

    def check_log(self):
        """Fails if the program panicked in any of its threads."""
        assert "panicked" not in self.log(), self.log()

    def while_commanded(self, name, attempt, times=5):
        """Does `attempt`, and again if it fails while the watchdog of `name` has cleared its command: on a busy machine a stream of
        commands may pause for that long."""
        for left in reversed(range(times)):
            expired = self.log().count(f'Resetting "{name}" command')
            try:
                return attempt()
            except AssertionError:
                if not left or self.log().count(f'Resetting "{name}" command') == expired:
                    raise
        raise AssertionError("no attempt at all")

    def wait_for_topics(self, *names, seconds=PATIENCE_S):
        """Waits until the simulator publishes all of `names`."""

        def there():
            assert self.running(), f"ended with status {self.process.poll()}:\n{self.log()}"
            return set(names) <= published(self.port)

        wait_for(there, f"{names} are published", seconds)
        return self


def state_of(port):
    """(publishers, subscribers, services) at the master as lists of [name, [node, …]]; None if it doesn't answer."""
    previous = socket.getdefaulttimeout()
    socket.setdefaulttimeout(5.0)
    try:
        return rosgraph.Master("/harness", f"http://localhost:{port}").getSystemState()
    except (OSError, rosgraph.MasterException):
        return None
    finally:
        socket.setdefaulttimeout(previous)


def published(port):
    """Names of all topics with a publisher."""
    state = state_of(port)
    return {name for name, _ in state[0]} if state else set()


def nodes(port):
    """Names of all nodes."""
    state = state_of(port)
    return {node for part in state or () for _, users in part for node in users}


def simulator_nodes(port):
    """Names of the simulator's nodes."""
    return {node for node in nodes(port) if node.startswith("/ambf_comm_node")}


def ros(port, *command, seconds=PATIENCE_S):
    """Runs a ROS command line program and returns what it prints."""
    done = subprocess.run(
        [str(word) for word in command],
        env=environment(port),
        stdin=subprocess.DEVNULL,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=seconds,
        check=False,
    )
    if done.returncode != 0:
        raise AssertionError(f"{' '.join(map(str, command))} ended with {done.returncode}:\n{done.stdout}")
    return done.stdout


class RosTest(unittest.TestCase):
    """Tests that share one roscore; each class may start simulators on it."""

    @classmethod
    def setUpClass(cls):
        cls.master = Master()
        cls.port = cls.master.port

    @classmethod
    def tearDownClass(cls):
        cls.master.stop()
