"""Two fake arms of a da Vinci Research Kit, each a real ROS node's, move two grippers of the scene `teleop`."""

import math

import harness
import rospy
from ambf_msgs.msg import RigidBodyState
from geometry_msgs.msg import WrenchStamped
from poses import distance, pose_of
from simulated import MODELS, RESOURCES, Ros, Simulated

SCENE = "/ambf/env/teleop"
ARMS = {"MTMR": ("simulated_device/palm", "rightring", 1.0), "MTML": ("simulated_device/palm1", "leftring", -1.0)}
# The middle of a ring that lies on the board, m; of one that hangs clear of the pegs.
LYING, CLEAR = -0.985, -0.885
# How far from the middle a ring may lie that is on a peg, m: half its hole less the radius of the peg.
PLAY = 0.06 - 0.015
# Metres of the scene for a metre of the hand.
SCALE = 2.5
# The reference stays at its start for so long, and a margin, s.
HOLD_S = 4.0


def setUpModule():
    """One master for all."""
    Ros.start()


def tearDownModule():
    """It ends last."""
    Ros.stop()


def stretched(text, factor=2.0):
    """A script that takes `factor` times as long: busy machines then keep the order of poses and pedals too, and the
    grippers close in time where simulated time falls behind the clock."""
    lines = (line.split("#")[0].split(maxsplit=1) for line in text.splitlines())
    return "".join(f"{float(time) * factor} {rest}\n" for time, rest in filter(None, lines))


class History:
    """Everything that a topic has said, so that what lasts a moment is not missed by a slow test."""

    def __init__(self, topic, kind, value):
        """`value`: what is kept of a message."""
        self.values = []
        self._topic, self._value = topic, value
        self._subscriber = rospy.Subscriber(topic, kind, self._receive, queue_size=1000)

    def _receive(self, message):
        self.values.append(self._value(message))

    def close(self):
        """Unsubscribes."""
        self._subscriber.unregister()

    def passes(self, condition, what, start=0):
        """Index of the first value from `start` on that meets `condition`; waits for it."""
        place = start

        def look():
            nonlocal place
            while place < len(self.values):
                if condition(self.values[place]):
                    return True
                place += 1
            return False

        harness.wait_for(look, f"{self._topic}: {what}")
        return place


def position(state):
    """Of a body, m."""
    return pose_of(state.pose)[0]


def force(message):
    """Its size, N."""
    return math.hypot(message.wrench.force.x, message.wrench.force.y, message.wrench.force.z)


class Teleoperation(Simulated):
    """The scene with the first two devices of the shipped file, which may push back, and no arms yet."""

    FILES = (MODELS / "teleop.yaml",)
    ARGUMENTS = ("-i", "0,1", "-e", "1")

    def setUp(self):
        super().setUp()
        names = {name for arm in ARMS.values() for name in arm[:2]}
        self.simulator.wait_for_topics(*(f"{SCENE}/{name}/State" for name in names))
        self.bodies = {name: self.follow(f"{SCENE}/{name}/State", RigidBodyState, position) for name in names}
        self.forces = {arm: self.follow(f"/{arm}/body/servo_cf", WrenchStamped, force) for arm in ARMS}
        self.pass_time(HOLD_S)

    def follow(self, topic, kind, value):
        """A history that ends with the test."""
        history = History(topic, kind, value)
        self.addCleanup(history.close)
        return history

    def arms(self, script):
        """Starts fake arms that do what `script` says, at half its speed; they end with the test."""
        program = harness.simulator_path().parent / "fake_dvrk"
        self.assertTrue(program.exists(), f"no {program}: run cargo build --workspace")
        file = harness.folder / "hands.txt"
        file.write_text(stretched(script))
        command = [program, *ARMS, "--rate", "250", "--quiet", "--script", file]
        fake = harness.Program(command, harness.environment(Ros.master.port))
        self.addCleanup(fake.stop)
        return fake

    def now(self, name):
        """Where a body is, m."""
        count = len(self.bodies[name].values)
        return self.bodies[name].values[self.bodies[name].passes(lambda _: True, "a state", count)]

    def until(self, name, condition, what):
        """Waits for a position of a body from now on."""
        self.bodies[name].passes(condition, what, len(self.bodies[name].values))

    def test_rings_are_carried_with_a_clutch_press_in_between(self):
        """As the shipped script says, which `scripts/simulate --scene teleop` runs."""
        for name in ("backfinger", "frontfinger"):
            self.assertNotIn(f"{SCENE}/{name}/State", harness.published(Ros.master.port))
        for _, ring, side in ARMS.values():
            self.assertLess(distance(self.now(ring), [0.0, 0.4 * side, LYING]), 0.003)
        self.arms((RESOURCES / "teleop/hands.txt").read_text())
        for palm, ring, _ in ARMS.values():
            self.until(ring, lambda p: p[2] > CLEAR, "it is lifted")
            gap = distance(self.now(palm), self.now(ring))
            self.assertLess(abs(gap - math.hypot(0.075, 0.115)), 0.03, "it hangs between the fingers")
        for arm, (_, ring, side) in ARMS.items():
            # The hand moves by 0.05 m twice, with its way back in between, for which the clutch is pressed.
            way = self.bodies[ring]
            lifted = way.passes(lambda p: p[2] > CLEAR, "it is lifted")
            there = way.passes(lambda p, side=side: p[2] > CLEAR and p[1] * side < 0.17, "it is over the peg", lifted)
            lies = way.passes(lambda p: p[2] < LYING + 0.003, "it lies on the board", there)
            # It is let go there, and nothing moves it.
            later = way.passes(lambda _: True, "a state a little later", lies + 25)
            self.assertLess(distance(way.values[later], [0.0, 0.15 * side, LYING]), PLAY, f"{ring} is on the inner peg")
            self.forces[arm].passes(lambda newton: newton > 0.05, "the ring was felt")

    def test_arms_that_vanish_and_come_back(self):
        """The gripper holds where it is and what it has, without force; later it goes on from there."""
        palm, ring, _ = ARMS["MTMR"]
        forces = self.forces["MTMR"].values
        # The hands rest until the simulator has found them; it puts them where it sees them first.
        fake = self.arms(
            "0 pose 0 0 0 0 0 0\n3 pose 0 0 0 0 0 0\n5 pose 0 0 -0.068 0 0 0\n6 gripper 1\n6.5 gripper 0\n"
            "8 pose 0 0 -0.068 0 0 0\n18 pose 0 0 0 0 0 0\n"
        )
        self.until(ring, lambda p: p[2] > LYING + 0.04, "it is on its way up")
        self.forces["MTMR"].passes(lambda newton: newton > 0.05, "the ring is felt")
        fake.kill()
        harness.wait_for(lambda: forces[-1] == 0.0, "the force ends")
        self.pass_time(1.0)
        quiet = len(forces)
        before = [self.now(name) for name in (palm, ring)]
        self.pass_time(2.0)
        for name, place in zip((palm, ring), before):
            self.assertLess(distance(self.now(name), place), 0.002, f"{name} holds still")
        self.assertGreater(before[1][2], LYING + 0.03, "the ring is held")
        self.assertFalse(any(forces[quiet:]), "no force")

        # The hands are elsewhere meanwhile, and closed.
        rest = "pose 0.03 0.02 -0.05 0 0 0"
        self.arms(f"0 gripper 0\n0 {rest}\n3 {rest}\n5 pose 0.03 0.02 -0.03 0 0 0\n9 gripper 0\n9.5 gripper 1\n")
        raised = 0.02 * SCALE
        self.until(palm, lambda p: p[2] > before[0][2] + 0.9 * raised, "it goes up with the hand")
        self.forces["MTMR"].passes(lambda newton: newton > 0.05, "the ring is felt again", quiet)
        self.until(ring, lambda p: p[2] < LYING + 0.005, "the hand has opened")
        expected = [before[0][0], before[0][1], before[0][2] + raised]
        self.assertLess(distance(self.now(palm), expected), 0.015, "it went on from where it was")
