"""The peg-transfer scene as clients of the competition's interface program and of its bridge to the headset see it."""

import json
import math
import pathlib
import socket
import time
import unittest

import harness
import rospy
from ambf_msgs.msg import RigidBodyState
from ambf_peg_transfer import SYMMETRIC, draw
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import ChannelFloat32, JointState
from std_msgs.msg import Empty, UInt32
from support import use_master

FOLDER = pathlib.Path(__file__).resolve().parents[2] / "resources/peg_transfer"
SEED = 5


def udp_port():
    """A free one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class PegTransfer(unittest.TestCase):
    """One simulator with a seed, for all tests."""

    @classmethod
    def setUpClass(cls):
        cls.master = harness.Master()
        cls.headset = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        cls.headset.bind(("127.0.0.1", 0))
        cls.headset.settimeout(harness.PATIENCE_S)
        cls.ports = {name: udp_port() for name in ("5701", "5702", "5703")}
        text = (FOLDER / "crtk_headset.yaml").read_text()
        for name, port in cls.ports.items():
            text = text.replace(f"listen: {name}", f"listen: 127.0.0.1:{port}")
        text = text.replace("to: 127.0.0.1:48051", f"to: 127.0.0.1:{cls.headset.getsockname()[1]}")
        crtk = pathlib.Path(harness.folder) / "headset.yaml"
        crtk.write_text(text)
        cls.simulator = harness.Simulator(
            cls.master.port,
            *("--launch_file", FOLDER / "launch.yaml", "-l", "0,1,2,3,4,5", "-p", "200", "-t", "1"),
            *("--profile", "accurate", "--crtk", crtk, "--seed", str(SEED)),
            *("--override_max_comm_freq", "100", "--override_min_comm_freq", "100"),
        )
        cls.simulator.wait_for_topics("/CRTK/psm1/measured_js", "/ambf/env/phantom/block2/State")
        use_master(cls.master.port)
        rospy.init_node("competitor", disable_signals=True)
        cls.newest, cls.counts = {}, {}
        for name in (
            "phantom/block1",
            "phantom/block2",
            "psm1/baselink",
            "psm1/toolyawlink",
            "psm2/toolyawlink",
            "CameraFrame",
        ):
            rospy.Subscriber(f"/ambf/env/{name}/State", RigidBodyState, cls.keep(name))
        for name in (
            "psm1/measured_js",
            "psm2/measured_js",
            "psm1/jaw/measure_js",
            "psm1/jaw/measured_js",
            "ecm/measured_js",
        ):
            rospy.Subscriber(f"/CRTK/{name}", JointState, cls.keep(name))
        for name in ("psm1/measured_cp", "psm1/T_b_w", "ecm/measured_cp"):
            rospy.Subscriber(f"/CRTK/{name}", PoseStamped, cls.keep(name))
        cls.publishers = {}

    @classmethod
    def tearDownClass(cls):
        cls.headset.close()
        cls.simulator.stop()
        cls.master.stop()

    @classmethod
    def keep(cls, name):
        def take(message):
            cls.newest[name] = message
            cls.counts[name] = cls.counts.get(name, 0) + 1

        return take

    def wait(self, condition, what):
        """`condition` may look for what has not come yet."""

        def holds():
            try:
                return condition()
            except KeyError:
                return False

        harness.wait_for(holds, what)

    def joints(self, name="psm1"):
        return self.newest[f"{name}/measured_js"].position

    def publish(self, topic, message):
        if topic not in self.publishers:
            self.publishers[topic] = rospy.Publisher(topic, type(message), queue_size=1)
            self.wait(self.publishers[topic].get_num_connections, f"somebody listens to {topic}")
        self.publishers[topic].publish(message)

    def move(self, name, goal):
        self.publish(f"/CRTK/{name}/move_jp", JointState(position=goal))
        self.wait(lambda: max(abs(a - b) for a, b in zip(self.joints(name), goal)) < 1e-3, f"{name} is at {goal}")

    def come_in_time(self, rates, right):
        """Messages come at this rate, Hz: not faster, and not much slower on a machine that others keep busy."""
        for _ in range(15):
            found = rates()
            # What had waited comes at once.
            self.assertLess(max(found), 1.2 * right)
            if min(found) > 0.25 * right:
                return
        self.fail(f"{found} Hz")

    def errors(self):
        """What the simulator's joints are beyond the measured ones, yaw, pitch and insertion of PSM1."""
        true, told = self.newest["psm1/baselink"].joint_positions, self.joints()
        return [a - b for a, b in zip(true[:3], told[:3])]

    def test_1_messages_are_those_of_the_interface(self):
        """8 names, 6 positions, 6 velocities; both spellings of the jaw; the base in the world; 120 a second."""
        self.wait(lambda: self.newest["psm1/measured_js"] and self.newest["psm1/T_b_w"], "states come")
        state = self.newest["psm1/measured_js"]
        self.assertEqual((len(state.name), len(state.position), len(state.velocity), len(state.effort)), (8, 6, 6, 0))
        self.assertEqual(
            (state.header.frame_id, state.name[0], state.name[7]),
            ("", "baselink-yawlink", "toolyawlink-toolgripperrightlink"),
        )
        self.assertEqual(self.newest["psm1/measured_cp"].header.frame_id, "psm1/baselink")
        base = self.newest["psm1/T_b_w"]
        self.assertEqual(base.header.frame_id, "world")
        self.assertAlmostEqual(base.pose.position.x, 0.1313066, places=6)
        self.wait(lambda: abs(self.newest["psm1/jaw/measure_js"].position[0] - 0.5) < 0.01, "the jaw opens to 0.5")
        self.wait(
            lambda: abs(self.newest["psm1/jaw/measured_js"].position[0] - 0.5) < 0.01,
            "and is told so in both spellings",
        )

        def rates():
            before, begin = self.counts["psm1/measured_js"], time.monotonic()
            time.sleep(2.0)
            return [(self.counts["psm1/measured_js"] - before) / (time.monotonic() - begin)]

        self.come_in_time(rates, 120.0)

    def test_2_a_seed_draws_what_python_draws(self):
        """Blocks stand where `draw` puts them, and joints are off by its errors."""
        drawn = draw(SEED)
        for name, (peg, _) in drawn.blocks.items():
            self.wait(lambda name=name: self.newest[f"phantom/{name}"], "a block is told")
            at = self.newest[f"phantom/{name}"].pose.position
            x, y = SYMMETRIC.pegs[peg]
            self.assertLess(math.hypot(at.x - x, at.y - y), 0.0028, (name, peg))
        self.move("psm1", [0.05, 0.1, 0.1, 0.2, 0.1, 0.1])
        for got, expected in zip(self.errors(), drawn.errors["psm1"]):
            self.assertAlmostEqual(got, expected, delta=1e-3)

    def test_3_errors_are_set_by_a_message(self):
        """What is measured stays, the joints of the scene move."""
        topic = "/ambf/env/psm1/errors_model/set_errors"
        self.move("psm1", [0.0, 0.0, 0.12, 0.0, 0.0, 0.0])
        for errors in ((0.0, 0.0, 0.0), (0.05, -0.05, 0.004), (0.0, 0.0, 0.0)):
            self.publish(topic, ChannelFloat32(values=errors))

            def there(errors=errors):
                is_there = all(abs(got - wanted) < 5e-4 for got, wanted in zip(self.errors(), errors))
                return is_there and abs(self.joints()[0]) < 1e-3 and abs(self.joints()[2] - 0.12) < 1e-3

            self.wait(there, f"errors are {errors}")

    def test_4_a_seed_by_a_message_and_a_reset(self):
        """Blocks are placed anew at once, and after each reset."""

        def placed():
            for name, (peg, _) in draw(9).blocks.items():
                at = self.newest[f"phantom/{name}"].pose.position
                x, y = SYMMETRIC.pegs[peg]
                if math.hypot(at.x - x, at.y - y) > 0.0028 or not 0.7240 < at.z < 0.7253:
                    return False
            return True

        self.publish("/crtk/seed", UInt32(data=9))
        self.wait(placed, "blocks stand where seed 9 puts them")
        self.publish("/ambf/env/World/Command/Reset", Empty())
        time.sleep(0.5)
        self.wait(placed, "and after a reset, too")

    def test_5_the_headset(self):
        """60 of each a second, without blanks; tips in front of it; 20 mm are 20 mm; silence holds."""
        # Channel PSM1 drives psm2: --swap.
        self.publish("/ambf/env/psm2/errors_model/set_errors", ChannelFloat32(values=[0.0, 0.0, 0.0]))
        self.move("psm2", [0.0, 0.0, 0.12, 0.0, 0.0, 0.0])
        # What has been told before is read away.
        self.headset.setblocking(False)
        try:
            while True:
                self.headset.recv(2048)
        except BlockingIOError:
            pass
        self.headset.settimeout(harness.PATIENCE_S)
        pose = None

        def rates():
            nonlocal pose
            begin, counts = time.monotonic(), {}
            while time.monotonic() - begin < 2.0:
                text, source = self.headset.recvfrom(2048)
                self.assertEqual(source[1], self.ports["5701"])
                self.assertLess(len(text), 1024)
                self.assertNotIn(b" ", text)
                for key, value in json.loads(text).items():
                    counts[key] = counts.get(key, 0) + 1
                    pose = value if key == "setpoint_cp" else pose
            self.assertEqual(set(counts), {"setpoint_cp", "jaw/setpoint_js"})
            return [count / (time.monotonic() - begin) for count in counts.values()]

        self.come_in_time(rates, 60.0)
        x, y, z = pose["Position"]["Translation"]
        self.assertAlmostEqual(z, 0.1798, delta=1e-4)
        start = self.newest["psm2/toolyawlink"].pose.position
        goal = {"Rotation": pose["Position"]["Rotation"], "Translation": [x, y + 0.02, z]}
        command = json.dumps({"move_cp": {"Goal": goal}}).encode() + b"\n\0\0"

        def moved():
            at = self.newest["psm2/toolyawlink"].pose.position
            return math.dist((at.x, at.y, at.z), (start.x, start.y, start.z))

        def settled():
            self.headset.sendto(command, ("127.0.0.1", self.ports["5701"]))
            return abs(moved() - 0.02) < 5e-4

        self.wait(settled, "the tip has moved by 20 mm")
        time.sleep(3.0)
        self.assertAlmostEqual(moved(), 0.02, delta=5e-4)

    def test_6_the_cameras_are_moved(self):
        """As an endoscope arm that is not in the scene; at 0 they are where they were."""
        self.wait(lambda: self.newest["ecm/measured_cp"] and self.newest["CameraFrame"], "the camera is told")
        self.assertEqual(self.newest["ecm/measured_js"].name, ["j0", "j1", "j2", "j3"])

        def place():
            at = self.newest["CameraFrame"].pose.position
            return at.x, at.y, at.z

        start = place()
        self.assertAlmostEqual(start[2], 0.90445, places=5)
        self.publish("/CRTK/ecm/servo_jp", JointState(position=[0.0, 0.0, 0.02, 0.0]))
        self.wait(lambda: abs(math.dist(place(), start) - 0.02) < 1e-6, "it has moved by 20 mm")
        # Along its view: down, and away from the surgeon.
        ahead = [b - a for a, b in zip(start, place())]
        for got, expected in zip(ahead, (0.0, -0.01286, -0.01532)):
            self.assertAlmostEqual(got, expected, delta=1e-4)
        there = place()[2]
        self.wait(lambda: abs(self.newest["ecm/measured_cp"].pose.position.z - there) < 1e-6, "its pose is told")
        self.publish("/CRTK/ecm/servo_jp", JointState(position=[0.0, 0.0, 0.0, 0.0]))
        self.wait(lambda: math.dist(place(), start) < 1e-9, "it is back")


if __name__ == "__main__":
    unittest.main()
