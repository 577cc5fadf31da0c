"""Two fake arms of a da Vinci Research Kit teleoperate the peg transfer, and score."""

import json
import math
import pathlib
import sys
import unittest

import harness
import rospy
from ambf_peg_transfer.arms import about
from ambf_peg_transfer.player import SPEED, THERE, Player, scene
from std_msgs.msg import String
from support import use_master

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/crtk"))

import over_ros1  # noqa: E402
from teleoperation import Settings, Teleoperation  # noqa: E402

FOLDER = ROOT / "resources/peg_transfer"
STEP = 0.005
MASTERS = {"MTML": "PSM1", "MTMR": "PSM2"}
# Metres of the instrument for a metre of the hand; the widest angle of a finger, rad, for the open gripper.
SCALE, WIDEST = 0.5, 0.2
# Of the hands against the player's: clocks of busy machines run ahead of their simulation.
SLOWER = 2.0
# Greatest speed of a tool, m/s.
UNSEEN = 0.04
# Axes of the cameras' frame in the world, and of a master's viewer in its device frame.
CAMERA = about(2, -3.14159) @ about(0, 0.69813)
VIEWER = about(2, -1.57079)


def roll_pitch_yaw(axes):
    """About fixed axes, rad."""
    pitch = -math.asin(max(-1.0, min(1.0, axes[2, 0])))
    return math.atan2(axes[2, 1], axes[2, 2]), pitch, math.atan2(axes[1, 0], axes[0, 0])


class Recorder(Player):
    """Writes down where the tools are to be, and how far the jaws are open."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.lines, self._ticks = [], 0

    def line(self, arm, goal, within=THERE, speed=SPEED):
        """As slowly as hands move that don't see what the jaws do."""
        super().line(arm, goal, within, min(speed, UNSEEN))

    def tick(self):
        """Each fifth tick."""
        if self._ticks % 5 == 0:
            self.lines.append((self._ticks * 0.01, [(arm.commanded, arm.jaw) for arm in self.arms.values()]))
        self._ticks += 1
        return super().tick()


def hands(lines):
    """The script by which fake masters make instruments do what was written down; both begin where they are."""
    starts = [place for place, _ in lines[0][1]]
    text = []
    for time, places in lines:
        for (place, jaw), start, master in zip(places, starts, MASTERS):
            moved = VIEWER.T @ CAMERA.T @ (place.position - start.position) / SCALE
            turned = VIEWER.T @ CAMERA.T @ place.axes @ start.axes.T @ CAMERA @ VIEWER
            numbers = " ".join(f"{value:.7f}" for value in (*moved, *roll_pitch_yaw(turned)))
            text.append(f"{SLOWER * time:.3f} {master} pose {numbers}")
            text.append(f"{SLOWER * time:.3f} {master} gripper {min(1.0, jaw / WIDEST):.5f}")
    return "\n".join(text) + "\n"


class Teleoperated(unittest.TestCase):
    """Over ROS alone: masters, instruments, referee."""

    def test_fake_arms_bring_a_block_over(self):
        """What a script does in this process, hands of fake masters do over topics: one block, one point."""
        sim = scene(FOLDER.parent, None, step=STEP)
        player = Recorder(sim, STEP)
        player.wait(1.0)
        player.transfer("block1", "peg18_s")
        player.wait(1.0)
        self.assertEqual(player.referee.score.points, 1)
        sim.close()
        script = harness.folder / "peg_transfer_hands.txt"
        script.write_text(hands(player.lines))
        seconds = SLOWER * player.lines[-1][0]

        master = harness.Master()
        self.addCleanup(master.stop)
        words = (
            "--launch_file",
            FOLDER / "launch.yaml",
            "-l",
            "0,1,2,4",
            "-p",
            "200",
            "-t",
            "1",
            "--profile",
            "accurate",
        )
        with harness.Simulator(master.port, *words, "--crtk", FOLDER / "crtk_both.yaml") as simulator:
            simulator.wait_for_topics("/PSM1/setpoint_cp", "/ambf/env/phantom/block2/State")
            use_master(master.port)
            rospy.init_node("operator", disable_signals=True)
            over_ros1.messages()
            settings = Settings(scale=SCALE, jaw=(0.0, WIDEST))
            couplings = [Teleoperation(f"/{hand}", f"/{arm}", settings) for hand, arm in MASTERS.items()]
            referee = harness.Program(
                [sys.executable, "-u", "-m", "ambf_peg_transfer"], harness.environment(master.port)
            )
            with referee:
                scores = []
                rospy.Subscriber(
                    "/ambf/env/peg_transfer/score", String, lambda message: scores.append(json.loads(message.data))
                )
                harness.wait_for(lambda: scores and scores[-1]["on_peg"]["block1"] == "peg4_s", "the block rests")
                program = harness.simulator_path().parent / "fake_dvrk"
                self.assertTrue(program.exists(), f"no {program}: run cargo build --workspace")
                command = [program, *MASTERS, "--rate", "250", "--quiet", "--script", script]
                with harness.Program(command, harness.environment(master.port)):
                    # The point is given where the block first rests; jaws that leave may move it once more.
                    harness.wait_for(
                        lambda: scores[-1]["points"] == 1 and scores[-1]["on_peg"]["block1"] == "peg18_s",
                        "a point",
                        seconds=seconds + harness.PATIENCE_S,
                    )
            for coupling in couplings:
                coupling.close()
        self.assertEqual(scores[-1]["hand_offs"], 1)


if __name__ == "__main__":
    unittest.main()
