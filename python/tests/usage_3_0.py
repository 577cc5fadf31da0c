"""A script as users of the C++ simulator's client 3.0 write them: grasps what the ghosts in the jaws of a gripper see, lifts it, drops it.

Ends with status 0 when everything obeyed. It uses nothing that the original's client does not have."""

import sys
import time

from ambf_client.ambf_actuator import Actuator
from ambf_client.ambf_client import Client
from ambf_client.ambf_ghost_object import GhostObject
from ambf_client.ambf_rigid_body import RigidBody
from ros_abstraction_layer import ral

OPEN, CLOSED = 0.0, 0.4
GRASPABLE = ["Needle", "Thread"]

ral_instance = ral("usage_3_0")
ral_instance.spin()
client = Client("usage_3_0", 10)
client.connect()
rate = client.create_rate(100)
time.sleep(0.3)


def expect(what, condition):
    """Ends the script if a command is not obeyed, however long that may take on a busy machine."""
    end = client.get_time() + 60.0
    obeyed = condition()
    while not client.is_shutdown() and not obeyed and client.get_time() < end:
        rate.sleep()
        obeyed = condition()
    print(what, "ok" if obeyed else "FAILED", flush=True)
    if not obeyed:
        sys.exit(1)


arm = client.get_obj_handle("/ambf/env/psm1/baselink")
needle = client.get_obj_handle("Needle")
actuator = client.get_obj_handle("psm1/Actuator0")
ghosts = [client.get_obj_handle(f"psm1/{side}_finger_ghost") for side in ("left", "right")]
time.sleep(0.5)
print([handle.get_name() for handle in (arm, needle, actuator, *ghosts)], arm.get_joint_names(), flush=True)
assert isinstance(arm, RigidBody) and isinstance(actuator, Actuator) and isinstance(ghosts[0], GhostObject)
assert [ghost.object_type for ghost in ghosts] == ["GHOST", "GHOST"]


def sensed():
    """Names of what the jaws have between them."""
    return ghosts[0].get_all_sensed_obj_names() + ghosts[1].get_all_sensed_obj_names()


def set_jaws(angle):
    """Moves both jaws."""
    for jaw in ("left_jaw", "right_jaw"):
        arm.set_joint_pos(jaw, angle)


arm.set_joint_pos("lift", 0.0)
set_jaws(OPEN)
expect("nothing between open jaws", lambda: sensed() == [] and ghosts[0].get_sensed_obj_name(0) is None)
ground = needle.get_pos().z

set_jaws(CLOSED)
names = []


def both_feel():
    """Whether both ghosts feel something; keeps the names of what can be grasped: a thing that is being pinched may bounce."""
    felt = [ghost.get_all_sensed_obj_names() for ghost in ghosts]
    names[:] = [name for prefix in GRASPABLE for name in felt[0] + felt[1] if prefix in name]
    return all(felt)


expect("both jaws feel the needle", both_feel)
print(names, flush=True)
assert names == ["/ambf/env/BODY Needle"] * 2
actuator.actuate(names[0])
expect("the actuator holds", lambda: actuator._state.actuated)

set_jaws(OPEN)
expect("the jaws open", lambda: abs(arm.get_joint_pos("left_jaw")) < 0.02 and sensed() == [])
arm.set_joint_pos("lift", 0.2)
expect("the needle is lifted", lambda: needle.get_pos().z > ground + 0.18)
for _ in range(20):
    rate.sleep()
assert needle.get_pos().z > ground + 0.18
actuator.deactuate()
expect("the needle falls", lambda: abs(needle.get_pos().z - ground) < 0.005)

client.get_world_handle().reset()
time.sleep(0.3)
client.clean_up()
ral_instance.shutdown()
print("cleaned up", flush=True)
