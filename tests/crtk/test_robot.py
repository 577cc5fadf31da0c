"""What clients of the real dVRK call beyond the simulators' contract: ratios of trajectories, a base frame, ends of moves, instruments,
services. Numbers are those of the list of what the contract demands."""

import math
import unittest

import back_end
from poses_math import distance, moved, psm_point
from waiting import wait_for

HOME = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]
AWAY = [0.3, 0.1, 0.1, 0.2, 0.1, -0.1]

# Publishers and subscribers of dvrk.arm and dvrk.psm (Python), by type, beside those of arm_client.
READ = {
    "spatial/measured_cf": "WrenchStamped",
    "body/measured_cf": "WrenchStamped",
    "spatial/jacobian": "Float64MultiArray",
    "body/jacobian": "Float64MultiArray",
    "trajectory_j/ratio": "Float64",
}
SENT = {
    "spatial/servo_cf": "WrenchStamped",
    "body/servo_cf": "WrenchStamped",
    "hold": "Empty",
    "free": "Empty",
    "servo_jr": "JointState",
    "servo_jf": "JointState",
    "move_jr": "JointState",
    "use_gravity_compensation": "Bool",
    "body/set_cf_orientation_absolute": "Bool",
    "trajectory_j/set_ratio": "Float64",
    "jaw/servo_jf": "JointState",
    "emulate_tool_present": "Bool",
}


def setUpModule():
    global arm, kinds, middleware
    if back_end.external():
        raise unittest.SkipTest("another back end may have no topics of the real robot")
    backend = back_end.start(back_end.CART)
    import middleware
    from arm_client import Arm

    kinds = middleware.messages()
    arm = Arm("/PSM1", robot=True)
    arm.check_connections()


class Topic:
    """A topic of the arm: what came on it, and what is sent on it."""

    def __init__(self, name, kind, is_latched=False):
        self.came = []
        self._kind = getattr(kinds, kind)
        self._arguments = (f"/PSM1/{name}", self._kind)
        self._is_latched = is_latched
        self._peer = None

    def listen(self):
        """Hears what comes from now on, and what was latched."""
        self._peer = middleware.Subscriber(*self._arguments, self.came.append, self._is_latched)
        wait_for(self._peer.is_connected, f"{self._arguments[0]} is published")
        return self

    def send(self, **fields):
        """Sends a message when somebody listens."""
        if self._peer is None:
            self._peer = middleware.Publisher(*self._arguments)
            wait_for(self._peer.is_connected, f"{self._arguments[0]} is listened to")
        self._peer.publish(self._kind(**fields))

    def is_connected(self):
        """Whether there is somebody on the other side."""
        return self._peer.is_connected()

    def last(self):
        """What the newest message holds."""
        return self.came[-1].data if self.came else None


class Robot(unittest.TestCase):
    """Each test begins with the arm enabled, homed and at home."""

    def setUp(self):
        arm.command("enable")
        arm.command("home")
        arm.move("move_jp", position=HOME)
        arm.warnings.clear()

    def test_47_all_topics_of_the_python_client_are_connected(self):
        """check_connections of dvrk.psm: each of its topics has somebody on the other side."""
        topics = [Topic(name, kind, name == "trajectory_j/ratio").listen() for name, kind in READ.items()]
        for name, kind in SENT.items():
            topic = Topic(name, kind)
            topic._peer = middleware.Publisher(*topic._arguments)
            topics.append(topic)
        wait_for(lambda: all(topic.is_connected() for topic in topics), "all topics are connected")

    def test_ratios_of_trajectories(self):
        """They are told, latched, and moves take longer; what is no ratio gives a warning."""
        ratio = Topic("trajectory_j/ratio", "Float64", True).listen()
        speed = Topic("trajectory_j/ratio_v", "Float64", True).listen()
        wait_for(lambda: ratio.last() == 1.0, "the latched ratio")
        setter = Topic("trajectory_j/set_ratio", "Float64")
        setter.send(data=0.1)
        wait_for(lambda: (ratio.last(), speed.last()) == (0.1, 0.1), "the new ratio")
        # The insertion moves at 0.4 m/s at most: 0.1 m in 2.5 s at a tenth of that.
        self.assertGreater(arm.move("move_jp", position=[0.0, 0.0, 0.22, 0.0, 0.0, 0.0]), 2.4)
        setter.send(data=1.5)
        wait_for(lambda: arm.warnings, "a warning")
        self.assertIn("1.5", arm.warnings[-1].string)
        Topic("trajectory_j/set_ratio_v", "Float64").send(data=0.5)
        wait_for(lambda: (ratio.last(), speed.last()) == (0.1, 0.5), "the new ratio of speeds")
        setter.send(data=1.0)
        wait_for(lambda: (ratio.last(), speed.last()) == (1.0, 1.0), "the old ratio")

    def test_goal_reached(self):
        """True for a move that ends, false for one that a servo command ends."""
        goal = Topic("goal_reached", "Bool", True).listen()
        wait_for(lambda: goal.came, "that of the move before")
        goal.came.clear()
        arm.move("move_jp", position=AWAY)
        wait_for(lambda: goal.came, "the end of the move")
        # On a busy machine that of the move before may come twice: when it was latched, and when it is sent.
        self.assertTrue(all(message.data for message in goal.came))
        arm.send("move_jp", position=[0.0, 0.0, 0.24, 0.0, 0.0, 0.0])
        arm.wait(lambda: arm.states[-1].is_busy, "it moves")
        arm.send("servo_jp", position=HOME)
        wait_for(lambda: not goal.came[-1].data, "the end of the move, which did not reach its goal")

    def test_set_base_frame(self):
        """Poses are in the frame that the message names; a place in it is gone to; a reset brings the old one back."""
        base = kinds.PoseStamped()
        base.header.frame_id = "camera"
        base.pose.position.x, base.pose.position.y, base.pose.position.z = 0.1, -0.2, 0.3
        base.pose.orientation.w = 1.0
        Topic("set_base_frame", "PoseStamped").send(header=base.header, pose=base.pose)
        arm.wait(lambda: arm.newest["setpoint_cp"].header.frame_id == "camera", "the frame is called so")
        arm.fresh("setpoint_cp")
        arm.fresh("local/setpoint_cp")
        local = arm.pose("local/setpoint_cp")
        expected = moved(local, x=0.1, y=-0.2, z=0.3)
        self.assertLess(distance(arm.pose("setpoint_cp"), expected), 1e-9)
        arm.move("move_jp", position=AWAY)
        arm.move("move_cp", pose=expected, frame="camera")
        arm.wait(lambda: max(abs(a - b) for a, b in zip(arm.joints("setpoint_js"), HOME)) < 1e-6, "home by the camera")
        self.assertEqual(arm.warnings, [])
        publisher = middleware.Publisher("/ambf/env/World/Command/Reset", kinds.Empty)
        wait_for(publisher.is_connected, "somebody resets the world")
        publisher.publish(kinds.Empty())
        arm.wait(lambda: arm.newest["setpoint_cp"].header.frame_id == "ECM_view", "the frame of the configuration")

    def test_instruments(self):
        """One of the same lengths can be named, others cannot; without any, poses are not valid."""
        tool = Topic("tool_type", "String", True).listen()
        wait_for(lambda: tool.last() == "420006", "the latched number")
        setter = Topic("set_tool_type", "String")
        setter.send(data="LARGE_NEEDLE_DRIVER_400006")
        wait_for(lambda: tool.last() == "400006", "the number of the new one")
        setter.send(data="420093")
        wait_for(lambda: arm.warnings, "a warning")
        setter.send(data="420006")
        wait_for(lambda: tool.last() == "420006", "the old number")
        there = Topic("emulate_tool_present", "Bool")
        there.send(data=False)
        stamp = lambda name: middleware.nanoseconds(arm.newest[name].header.stamp)  # noqa: E731
        arm.wait(lambda: not stamp("measured_cp") and not stamp("setpoint_cp"), "poses are not valid")
        self.assertTrue(stamp("measured_js"))
        arm.warnings.clear()
        arm.send("servo_cp", pose=arm.pose("setpoint_cp"))
        wait_for(lambda: arm.warnings, "a warning")
        there.send(data=True)
        arm.wait(lambda: stamp("measured_cp") and stamp("setpoint_cp"), "poses are valid again")

    def test_services(self):
        """Kinematics there and back, in the base and in the reference frame; the state; what cannot be answered says so."""
        forward, inverse = kinds.QueryForwardKinematics, kinds.QueryInverseKinematics
        local = middleware.ask("/PSM1/local/forward_kinematics", forward, jp=AWAY)
        self.assertTrue(local.result, local.message)
        place = local.cp.position
        self.assertLess(math.dist((place.x, place.y, place.z), psm_point(AWAY)), 1e-6)
        arm.move("move_jp", position=AWAY)
        arm.fresh("setpoint_cp")
        seen = middleware.ask("/PSM1/forward_kinematics", forward, jp=AWAY)
        self.assertLess(distance(seen.cp, arm.pose("setpoint_cp")), 1e-6)
        back = middleware.ask("/PSM1/inverse_kinematics", inverse, cp=seen.cp, jp=HOME)
        self.assertTrue(back.result, back.message)
        self.assertLess(max(abs(a - b) for a, b in zip(back.jp, AWAY)), 1e-6)
        wrong = middleware.ask("/PSM1/forward_kinematics", forward, jp=[0.0])
        self.assertFalse(wrong.result)
        self.assertIn("expected 6", wrong.message)
        far = middleware.ask("/PSM1/inverse_kinematics", inverse, cp=moved(seen.cp, x=5.0))
        self.assertFalse(far.result)
        self.assertTrue(far.message)
        state = middleware.ask("/PSM1/operating_state", kinds.TriggerOperatingState).operating_state
        self.assertEqual((state.state, state.is_homed, state.is_busy), ("ENABLED", True, False))


if __name__ == "__main__":
    unittest.main()
