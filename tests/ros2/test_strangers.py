"""A program with a participant, and somebody on another machine of its network: who gets an answer, and who does not.

Both machines are network namespaces that are joined by a cable of their own. Skipped where these cannot be made."""

import json
import os
import subprocess
import unittest

from harness import PATIENCE_S, environment, program

VICTIM, STRANGER, ELSEWHERE = "10.77.0.1", "10.77.0.2", "10.99.0.9"
DOMAIN = 1

# What the other machine does: sends announcements of a participant to all ports, and counts what comes over the cable.
SCRIPT = """
import json, socket, struct, sys, time
victim, own, given = sys.argv[1:4]
wire = socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.htons(0x0800))
out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
out.bind((own, 0))
out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(own))
def parameter(number, value): return struct.pack("<HH", number, len(value)) + value
prefix = b"\\x01\\x10" + given.encode()[:10].ljust(10)
locator = struct.pack("<iI", 1, out.getsockname()[1]) + bytes(12) + socket.inet_aton(given)
announcement = (b"\\0\\3\\0\\0" + parameter(0x15, b"\\2\\2\\0\\0") + parameter(0x16, b"\\1\\x10\\0\\0") + parameter(0x50, prefix + b"\\0\\0\\1\\xc1")
    + parameter(0x31, locator) + parameter(0x32, locator) + parameter(0x58, struct.pack("<I", 0xc3f))
    + parameter(2, struct.pack("<iI", 20, 0)) + parameter(1, b""))
body = struct.pack("<HH", 0, 16) + b"\\0\\1\\0\\xc7\\0\\1\\0\\xc2" + struct.pack("<iI", 0, 1) + announcement
packet = b"RTPS\\2\\2\\1\\x10" + prefix + b"\\x15\\5" + struct.pack("<H", len(body)) + body
ports = range(7400 + 250, 7400 + 250 + 14)
counts, start, sent = {}, time.monotonic(), 0
wire.settimeout(0.1)
while time.monotonic() < start + 4:
    if sent < 4 and time.monotonic() > start + sent:
        sent += 1
        for port in ports:
            out.sendto(packet, (victim, port))
            out.sendto(packet, ("239.255.0.1", port))
    try:
        data, address = wire.recvfrom(65536)
    except TimeoutError:
        continue
    # From the victim: packets that the stranger sends are seen, too.
    if address[2] != socket.PACKET_OUTGOING and data[9] == socket.IPPROTO_UDP and data[12:16] == socket.inet_aton(victim):
        to = socket.inet_ntoa(data[16:20])
        counts[to] = counts.get(to, 0) + 1
print(json.dumps(counts))
"""


def namespace():
    """A process in a network of its own."""
    process = subprocess.Popen(["unshare", "--net", "sleep", "300"], stderr=subprocess.PIPE)
    return process


def within(process, *command, **options):
    return subprocess.run(["nsenter", f"--net=/proc/{process.pid}/ns/net", *command], check=True, timeout=PATIENCE_S, **options)


class Strangers(unittest.TestCase):
    def setUp(self):
        try:
            self.here, self.there = namespace(), namespace()
            for process in (self.here, self.there):
                self.addCleanup(process.wait)
                self.addCleanup(process.kill)
                # It has entered its network once its name has changed.
                while process.poll() is None and not open(f"/proc/{process.pid}/comm").read().startswith("sleep"):
                    pass
            cable = ["link", "add", "cable", "netns", str(self.here.pid), "type", "veth"]
            subprocess.run(["ip", *cable, "peer", "name", "cable", "netns", str(self.there.pid)], check=True)
            for process, address in ((self.here, VICTIM), (self.there, STRANGER)):
                within(process, "ip", "link", "set", "lo", "up")
                within(process, "ip", "address", "add", f"{address}/24", "dev", "cable")
                within(process, "ip", "link", "set", "cable", "up")
            within(self.here, "ip", "route", "add", "default", "via", STRANGER)
        except (OSError, subprocess.SubprocessError) as error:
            print(f"SKIPPED: no network namespaces: {error}")
            self.skipTest("no network namespaces")

    def answers(self, discovery, given=STRANGER):
        """Packets that the program sends to each address when somebody announces itself at the address `given`."""
        command = [f"--net=/proc/{self.here.pid}/ns/net", program("examples", "peer"), "20"]
        settings = dict(environment(DOMAIN), ROS_AUTOMATIC_DISCOVERY_RANGE=discovery)
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        with subprocess.Popen(["nsenter", *command], env=settings, **pipes) as victim:
            self.assertIn("ready", victim.stdout.readline())
            script = ["/usr/bin/python3", "-c", SCRIPT, VICTIM, STRANGER, given]
            counts = within(self.there, *script, stdout=subprocess.PIPE, env=os.environ).stdout
            self.assertIsNone(victim.poll(), "it has ended")
            victim.stdin.close()
        return json.loads(counts)

    def test_nobody_outside_is_told_anything_unless_asked_for(self):
        for discovery in ("LOCALHOST", "OFF"):
            self.assertEqual(self.answers(discovery), {}, discovery)

    def test_on_the_subnet_its_members_get_answers_and_nobody_else(self):
        self.assertGreater(self.answers("SUBNET").get(STRANGER, 0), 20)
        counts = self.answers("SUBNET", ELSEWHERE)
        self.assertNotIn(ELSEWHERE, counts)
        # Announcements to everybody.
        self.assertEqual(set(counts), {"239.255.0.1"})


if __name__ == "__main__":
    unittest.main()
