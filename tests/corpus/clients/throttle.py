"""In the style of learners that step the simulation themselves: 200 iterations by clock edges, an iteration of physics for each."""

import sys
import time

from ambf_client import Client

STEPS = 200

c = Client("throttle")
c.connect()
time.sleep(0.3)
world = c.get_world_handle()
base = c.get_obj_handle("psm1/baselink")
time.sleep(0.3)
world.enable_throttling(True)
world.set_num_step_skips(1)
world.set_active()
world.update()


def settled():
    """The step at which the physics waits."""
    end, step = time.time() + 60.0, None
    while time.time() < end:
        now = base.get_sim_step()
        if now == step:
            return now
        step = now
        time.sleep(0.3)
    print("the physics does not wait")
    sys.exit(1)


begin = step = settled()
for i in range(STEPS):
    base.set_joint_pos("baselink-yawlink", 0.3)
    world.update()
    end = time.time() + 60.0
    while base.get_sim_step() <= step and time.time() < end:
        time.sleep(0.0005)
    if base.get_sim_step() != step + 1:
        print(f"edge {i}: from step {step} to {base.get_sim_step()}")
        sys.exit(1)
    step += 1
print(f"{step - begin} steps, yaw {base.get_joint_pos('baselink-yawlink'):.4f} rad")
if step - begin != STEPS or settled() != step:
    sys.exit(1)
world.enable_throttling(False)
world.update()
end = time.time() + 60.0
while base.get_sim_step() < step + 20 and time.time() < end:
    time.sleep(0.01)
if base.get_sim_step() < step + 20:
    print("the physics does not run freely again")
    sys.exit(1)
world.reset()
time.sleep(0.2)
c.clean_up()
print("done", flush=True)
