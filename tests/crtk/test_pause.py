"""Stamps while the simulation stands still (20): of an arm with the clock of the simulation, and of one with that of the wall."""

import pathlib
import tempfile
import time
import unittest

import back_end

CARTS = pathlib.Path(__file__).resolve().parents[2] / "resources/crtk/cart.yaml"


def setUpModule():
    global backend, arms, middleware, folder
    if back_end.external():
        raise unittest.SkipTest("another back end may have no service that holds it")
    folder = tempfile.TemporaryDirectory()
    unittest.addModuleCleanup(folder.cleanup)
    text = CARTS.read_text().replace("  - name: PSM1\n", "  - name: PSM1\n    clock: sim\n")
    assert "clock: sim" in text
    file = pathlib.Path(folder.name) / "cart.yaml"
    file.write_text(text)
    backend = back_end.start([*back_end.CART[:-1], str(file)])
    import middleware
    from arm_client import Arm

    arms = {"sim": Arm("/PSM1"), "wall": Arm("/ECM", jaw=False)}
    for arm in arms.values():
        arm.check_connections()


def stamps(arm):
    """Of what came last, s."""
    return [middleware.nanoseconds(header.stamp) / 1e9 for _, header in list(arm.arrivals["measured_js"])[-3:]]


class Pause(unittest.TestCase):
    """A client holds the simulation for some seconds with a step of no iterations."""

    def test_20_messages_go_on_while_the_simulation_stands(self):
        from ambf_msgs.srv import Step

        clocks = []
        kind = middleware.messages().Clock
        listener = middleware.Subscriber("/clock", kind, lambda message: clocks.append(middleware.nanoseconds(message.clock)))
        for arm in arms.values():
            arm.fresh("measured_js", 5)
        self.assertTrue(all(stamp > 0 for stamp in stamps(arms["sim"])), stamps(arms["sim"]))
        answer = middleware.ask(middleware.STEP, Step, steps=0, patience=30.0)
        self.assertTrue(answer.success, answer.message)
        # Standing still shows after a tenth of a second.
        arms["sim"].wait(lambda: stamps(arms["sim"]) == [0.0] * 3, "stamps are 0")
        arms["wall"].fresh("measured_js", 5)
        times = stamps(arms["wall"])
        self.assertTrue(times[0] < times[1] < times[2] and abs(times[2] - time.time()) < 5.0, times)
        # What was on its way has arrived.
        time.sleep(0.2)
        clocks.clear()
        arms["sim"].fresh("measured_js", 20)
        arms["sim"].wait(lambda: len(clocks) > 5, "/clock goes on")
        self.assertEqual(len(set(clocks)), 1, clocks)
        self.assertAlmostEqual(clocks[0] / 1e9, answer.sim_time, delta=0.01)
        # Somebody else lets it go.
        answer = middleware.ask(middleware.STEP, Step, steps=1, patience=0.01)
        arms["sim"].wait(lambda: 0.0 not in stamps(arms["sim"]), "stamps go on")
        self.assertGreaterEqual(stamps(arms["sim"])[-1], answer.sim_time)
        del listener


if __name__ == "__main__":
    unittest.main()
