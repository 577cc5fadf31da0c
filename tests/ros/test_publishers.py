"""Publishers of commands that misbehave cost one line of the log, and no other client anything."""

import contextlib
import io
import os
import struct
import threading
import time

import harness
import node
import rospy
import tcpros
from ambf_msgs.msg import RigidBodyCmd, RigidBodyState
from std_msgs.msg import Empty

WALL = "/ambf/env/Wall"
KIND, MD5 = RigidBodyCmd._type, RigidBodyCmd._md5sum  # pylint: disable=protected-access
HUGE = struct.pack("<I", 0xFFFFFFFF)
GOOD = {"callerid": "/somebody", "type": KIND, "md5sum": MD5}


def place(y):
    """The bytes of a command that puts the wall at `y` m."""
    command = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_POSITION)
    command.pose.position.y, command.pose.orientation.w = y, 1.0
    data = io.BytesIO()
    command.serialize(data)
    return tcpros.block(data.getvalue())


def says(*parts, fields=None):
    """A publisher that reads the subscriber's header, sends its own and those bytes, and holds the line."""

    def behave(raw):
        tcpros.read_block(raw)
        for part in (tcpros.header_of(**(fields or GOOD)), *parts):
            raw.sendall(part)
        # Until the subscriber leaves.
        raw.recv(1)

    return behave


def sends(data):
    """A publisher that sends nothing but those bytes, and holds the line."""

    def behave(raw):
        tcpros.read_block(raw)
        raw.sendall(data)
        raw.recv(1)

    return behave


def silent(raw):
    """Takes the subscriber's header and says nothing."""
    while raw.recv(4096):
        pass


def breaks_off(raw):
    """Ends in the middle of a message."""
    tcpros.read_block(raw)
    raw.sendall(tcpros.header_of(**GOOD) + place(9.0)[:-1])


def never_sends_a_whole(raw):
    """A byte now and then of a message that is never complete."""
    tcpros.read_block(raw)
    raw.sendall(tcpros.header_of(**GOOD) + struct.pack("<I", 10_000))
    while True:
        raw.sendall(b"\0")
        time.sleep(0.5)


# Name → (behaviour, words of the one line about it; None if there is nothing to say about a program that comes and goes).
HOSTILE = {
    "wrong_sum": (says(place(9.0), fields={**GOOD, "md5sum": "0" * 32}), ["0" * 32, MD5, "version of the message"]),
    "wrong_type": (says(place(9.0), fields={**GOOD, "type": Empty._type}), ["std_msgs/Empty", KIND]),
    "any_type": (says(place(9.0), fields={"type": "*", "md5sum": "*"}), ["it sends *", KIND]),
    "refuses": (says(fields={"error": "not\ntoday"}), ["refuses us: not today"]),
    "huge_header": (sends(HUGE), ["4294967295 bytes"]),
    "no_header": (sends(tcpros.block(b"\xff" * 40)), ["no header"]),
    "silent": (silent, ["says nothing"]),
    "huge_message": (says(HUGE), ["4294967295 bytes"]),
    "long_message": (says(struct.pack("<I", 2 << 20)), ["2097152 bytes"]),
    "breaks_off": (breaks_off, None),
    "never_whole": (never_sends_a_whole, None),
    "hangs_up": (lambda raw: None, None),
}


class Misbehaving(harness.RosTest):
    """One simulator; the wall stands where the last command put it."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        node.start(cls.port)
        # As on a small computer.
        arguments = ("--launch_file", harness.scene / "launch.yaml", "-l", "1")
        cls.simulator = harness.Simulator(cls.port, *arguments, address_space=8 << 30)
        cls.simulator.wait_for_topics(f"{WALL}/State")

    @classmethod
    def tearDownClass(cls):
        rospy.signal_shutdown("done")
        cls.simulator.stop()
        super().tearDownClass()

    def setUp(self):
        self.wall = node.Listener(f"{WALL}/State", RigidBodyState)
        self.addCleanup(self.wall.close)
        self.wall.newest()

    def tearDown(self):
        self.assertTrue(self.simulator.running())
        self.simulator.check_log()

    def publisher(self, name, behave):
        """A node that publishes the wall's commands in its own way."""
        return tcpros.Publisher(self.port, name, f"{WALL}/Command", KIND, behave)

    def stands_at(self, y, seconds=harness.PATIENCE_S):
        """Waits until the wall is at `y` m."""
        self.wall.until(lambda state: abs(state.pose.position.y - y) < 1e-4, f"the wall at {y} m", seconds)

    def use(self, what):
        """Threads, open files or memory (kB) of the simulator."""
        folder = f"/proc/{self.simulator.process.pid}"
        if what == "files":
            return len(os.listdir(f"{folder}/fd"))
        with open(f"{folder}/status", encoding="ascii") as lines:
            return next(int(line.split()[1]) for line in lines if line.startswith(what))

    def lines_about(self, name):
        """Lines of the log in which a publisher is named."""
        return [line for line in self.simulator.log().splitlines() if f" /{name} " in line]

    def test_each_is_named_once_and_costs_nobody_anything(self):
        """All of them publish to one body that an honest client moves."""
        before = {what: self.use(what) for what in ("files", "Threads", "VmRSS", "VmSize")}
        with contextlib.ExitStack() as stack:
            crowd = {name: stack.enter_context(self.publisher(name, behave)) for name, (behave, _) in HOSTILE.items()}
            command = RigidBodyCmd(cartesian_cmd_type=RigidBodyCmd.TYPE_POSITION)
            command.pose.position.y, command.pose.orientation.w = 1.0, 1.0
            with node.Stream(f"{WALL}/Command", command):
                self.stands_at(1.0)
                for name, (_, words) in HOSTILE.items():
                    # They are connected to again, in case they have come to their senses.
                    attempts = 1 if name in ("silent", "never_whole") else 3
                    harness.wait_for(lambda name=name, n=attempts: crowd[name].connections >= n, f"{name} is tried")
                    if words:
                        harness.wait_for(lambda name=name: self.lines_about(name), f"a line about {name}")
                command.pose.position.y = 2.0
                self.stands_at(2.0)
            during = {what: self.use(what) for what in before}
        for name, (_, words) in HOSTILE.items():
            with self.subTest(name):
                lines = self.lines_about(name)
                self.assertEqual(len(lines), 1 if words else 0, self.simulator.log())
                for word in words or ():
                    self.assertIn(word, lines[0])
                self.assertLess(crowd[name].connections, 60)
        self.assertNotIn("are not a", self.simulator.log())
        self.assertLess(during["VmRSS"] - before["VmRSS"], 30_000)
        self.assertLess(during["VmSize"] - before["VmSize"], 1_000_000)
        self.assertLessEqual(during["Threads"], before["Threads"] + len(HOSTILE) + 8)
        for what in ("Threads", "files"):
            harness.wait_for(lambda what=what: self.use(what) <= before[what] + 8, f"{what} of them are given back")

    def test_the_last_of_a_burst_counts(self):
        """However many commands arrive at once."""
        go, bursts = threading.Event(), [[0.01 * turn + 1e-5 * i for i in range(1000)] for turn in range(1, 11)]
        pending = iter(bursts)

        def behave(raw):
            tcpros.read_block(raw)
            raw.sendall(tcpros.header_of(**GOOD))
            for burst in pending:
                go.wait()
                go.clear()
                raw.sendall(b"".join(map(place, burst)))
            raw.recv(1)

        with self.publisher("bursts", behave):
            for burst in bursts:
                go.set()
                self.stands_at(burst[-1])

    def test_a_slow_sender_is_understood(self):
        """Byte by byte is a message too."""
        def behave(raw):
            tcpros.read_block(raw)
            for byte in tcpros.header_of(**GOOD) + place(3.0):
                raw.sendall(bytes([byte]))
                time.sleep(0.002)
            raw.recv(1)

        with self.publisher("slow", behave):
            self.stands_at(3.0)
        self.assertEqual(self.lines_about("slow"), [])

    def test_a_client_that_cannot_be_reached_is_named(self):
        """As one on a machine whose name is not known here."""
        with tcpros.Publisher(self.port, "far", f"{WALL}/Command", KIND, silent, host="nowhere.invalid"):
            line = harness.wait_for(lambda: self.lines_about("far"), "it is named")[0]
            self.assertIn("cannot be reached: http://nowhere.invalid", line)
            # It is tried some more times, without a further word.
            time.sleep(4.0)
            self.assertEqual(len(self.lines_about("far")), 1)

    def test_a_killed_client_comes_back_under_its_name(self):
        """The master still lists it meanwhile, and nothing is said."""
        first = self.publisher("phoenix", says(place(4.0)))
        self.stands_at(4.0)
        first.die()
        time.sleep(2.0)
        with self.publisher("phoenix", says(place(5.0))):
            self.stands_at(5.0)
        self.assertEqual(self.lines_about("phoenix"), [])
