"""In the style of client 3.0: jaws close around the needle, what the ghosts in them sense is held by the actuator, lifted, and let go."""

import sys
import time

import numpy as np
from ambf_client.ambf_client import Client
from instrument_arm import InstrumentArm, expect
from ros_abstraction_layer import ral

GRASPABLE = ["Needle", "Thread"]
# What overlaps a ghost has no weight: to let something fall, the jaws open wide enough to take the ghosts away from it.
OPEN, CLOSED, WIDE = 0.4, -0.05, 1.1

layer = ral("grasp")
layer.spin()
client = Client("grasp", 10)
client.connect()
arm = InstrumentArm(client, "psm1")
needle = client.get_obj_handle("Needle")
proximity = client.get_obj_handle("psm1/tip_proximity")
time.sleep(0.3)
client.get_world_handle().reset()
time.sleep(0.3)


def tip(x, y, z):
    """The upright tool with its tip there."""
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def middle():
    """The middle of the needle's arc, in the world."""
    position, (_, _, yaw) = needle.get_pos(), needle.get_rpy()
    return position.x - 0.2 * np.sin(yaw), position.y + 0.2 * np.cos(yaw), position.z


def graspable():
    """Names that are allowed, in the order of what is preferred."""
    sensed = arm.sensed()
    return [name for part in GRASPABLE for name in sensed if part in name]


arm.set_jaw_angle(OPEN)
x, y, z = middle()
print("the needle is at", np.round([x, y, z], 3))
arm.move_cp(tip(x, y, 0.5))
expect("nothing between open jaws", lambda: graspable() == [], arm.hold)
arm.move_cp(tip(x, y, z + 0.142))
expect(
    "the proximity sensor sees the needle",
    lambda: proximity.is_triggered(0) and "Needle" in proximity.get_sensed_object(0),
    arm.hold,
)
arm.set_jaw_angle(CLOSED)
expect(
    "both jaws sense the needle",
    lambda: all(any("Needle" in n for n in g.get_all_sensed_obj_names()) for g in arm.ghosts),
    arm.hold,
)
names = graspable()
print("between the jaws:", names)
if "/ambf/env/BODY Needle" not in names:
    sys.exit(1)
held = next(name for name in names if "Needle" in name)
arm.actuator.actuate(held)
expect("the actuator holds", lambda: arm.actuator._state.actuated, arm.hold)
ground = needle.get_pos().z
offset = np.array(middle()) - arm.measured_cp()[:3, 3]
arm.move_cp(tip(x, y, z + 0.45))
expect("the needle is lifted", lambda: middle()[2] > ground + 0.27, arm.hold)
slipped = float(np.linalg.norm(np.array(middle()) - arm.measured_cp()[:3, 3] - offset))
print(f"lifted by {middle()[2] - ground:.3f} m; off its place in the jaws by {slipped:.4f} m")
# The states of arm and needle may be of different steps.
expect("it follows", lambda: np.linalg.norm(np.array(middle()) - arm.measured_cp()[:3, 3] - offset) < 0.03, arm.hold)
arm.actuator.deactuate()
arm.set_jaw_angle(WIDE)
expect("the needle falls", lambda: needle.get_pos().z < ground + 0.03, arm.hold)
expect("the jaws are empty", lambda: graspable() == [], arm.hold)
arm.move_cp(tip(x, y, 0.5))
client.get_world_handle().reset()
time.sleep(0.3)
client.clean_up()
layer.shutdown()
print("done", flush=True)
