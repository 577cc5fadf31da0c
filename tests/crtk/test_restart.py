"""What outlives a simulator: a state command that is latched (10)."""

import unittest

import back_end


def setUpModule():
    global backend, arm, middleware
    if back_end.external():
        raise unittest.SkipTest("another back end cannot be started again")
    backend = back_end.start(back_end.ALONE)
    import middleware
    from arm_client import Arm

    arm = Arm("/PSM1")
    arm.check_connections()


class Restart(unittest.TestCase):
    """The client stays while the simulator is started again."""

    def test_10_a_state_command_that_is_older_than_the_simulator(self):
        """The publisher of state commands is latched: over ROS 1 the command is applied once, over ROS 2 it is not for the new one."""
        self.assertEqual(arm.command("disable").state, "DISABLED", arm.states)
        count = len(arm.states)
        backend.restart()
        arm.check_connections()
        arm.wait(lambda: len(arm.states) > count, "a state of the new one")
        first = arm.states[count]
        # The state at the start, unless the command was faster than this client.
        self.assertIn(first.state, ("ENABLED", "DISABLED"))
        last = "DISABLED" if middleware.TAKES_LATCHED else "ENABLED"
        arm.wait(lambda: arm.states[-1].state == last, f"it is {last}")
        # Everything that the arm says from now on is an answer.
        arm.fresh("measured_js", 200)
        told = [state.state for state in arm.states[count:]]
        self.assertLessEqual(told.count("DISABLED"), 1 if middleware.TAKES_LATCHED else 0, told)
        self.assertEqual(arm.command("enable").state, "ENABLED")


if __name__ == "__main__":
    unittest.main()
