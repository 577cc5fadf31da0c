"""A script as users of the C++ simulator's client write them: finds objects, commands them, reads back, cleans up.

Ends with status 0 when everything obeyed. It uses nothing that the original's client does not have."""

import sys
import time

from ambf_client import Client


def expect(what, condition, do=lambda: None):
    """Ends the script if a command is not obeyed, however long that may take on a busy machine; does `do` meanwhile."""
    end = time.time() + 30.0
    while not condition() and time.time() < end:
        do()
        time.sleep(0.01)
    print(what, "ok" if condition() else "FAILED", flush=True)
    if not condition():
        sys.exit(1)


c = Client("original_usage")
c.connect()
time.sleep(0.3)
print(c.get_obj_names())

base = c.get_obj_handle("arm7/base")
ball = c.get_obj_handle("Capsule")
palm = c.get_obj_handle("gripper/palm")
sensor = c.get_obj_handle("gripper/proximity")
time.sleep(0.5)

expect("joint names", lambda: base.get_joint_names()[:2] == ["yaw", "shoulder"])
expect("joints", lambda: base.get_num_joints() == 7)
expect("children", lambda: "flange" in base.get_children_names())
expect("no such object", lambda: c.get_obj_handle("nothing of that name") is None)

# Joint positions: by name and by index.
base.set_joint_pos("shoulder", 0.5)
base.set_joint_pos(0, 0.3)
expect("joint position by name", lambda: abs(base.get_joint_pos("shoulder") - 0.5) < 0.1)
expect("joint position by index", lambda: abs(base.get_joint_pos(0) - 0.3) < 0.1)
expect("all joint positions", lambda: len(base.get_all_joint_pos()) == 7)

# The pose of a body without mass is set.
palm.set_pos(5, 0, -0.9)
palm.set_rpy(0, 0, 0.5)
expect("pose", lambda: abs(palm.get_pose()[2] + 0.9) < 1e-3 and abs(palm.get_pose()[5] - 0.5) < 1e-3)

# A force holds as long as it is refreshed.
height = ball.get_pos().z
expect("force", lambda: ball.get_pos().z > height + 0.1, do=lambda: ball.set_force(0, 0, 15))

# A velocity holds by itself.
ball.set_linear_vel(0.5, 0, 0)
expect("velocity", lambda: abs(ball.get_linear_vel().x - 0.5) < 0.1)

expect("sensor", lambda: sensor.get_count() == 1 and sensor.get_measurement(0) is not None)

w = c.get_world_handle()
w.reset_bodies()
time.sleep(0.3)
c.clean_up()
print("cleaned up", flush=True)
