"""In the style of client 2.0: finds everything by parts of names, and reads states at 50 Hz without commanding anything."""

import sys
import time

from ambf_client import Client

c = Client("look_up")
c.connect()
time.sleep(0.3)
names = c.get_obj_names()
c.get_world_handle().reset()
print(len(names), "objects, common namespace", c.get_common_namespace())

# `Entry1` is part of `ghostEntry1` too, and so with all of them.
markers = [f"{kind}{i + 1}" for kind in ("Entry", "Exit") for i in range(4)]
for marker in markers:
    handle = c.get_obj_handle(marker)
    if handle is None or handle.object_type != "RIGID_BODY" or handle.get_name() != f"/ambf/env/phantom/{marker}":
        print(marker, "is not found:", handle)
        sys.exit(1)
print("markers at", [round(c.get_obj_handle(marker).get_pos().x, 3) for marker in markers])

# Two arms have one each; a peg is `passive` and has no topics; a ring has a name of its own.
for text, wanted in (
    ("Actuator0", False),
    ("psm2/Actuator0", True),
    ("peg3", False),
    ("block3", True),
    ("cameraL", True),
    ("Needle", True),
):
    if (c.get_obj_handle(text) is not None) != wanted:
        print(text, "should", "" if wanted else "not ", "be found")
        sys.exit(1)

handles = {name: c.get_obj_handle(name) for name in names}
lost = [name for name, handle in handles.items() if handle is None]
if lost:
    print("listed, but not found:", lost)
    sys.exit(1)
kinds = {}
for handle in handles.values():
    kinds[handle.object_type] = kinds.get(handle.object_type, 0) + 1
print("handles:", kinds)

base = c.get_obj_handle("psm1/baselink")
print("joints of psm1:", base.get_joint_names(), "children:", base.get_children_names())
if base.get_num_joints() != 8 or len(base.get_children_names()) != 8:
    sys.exit(1)
c.clean_up()

# A reader that commands nothing: a new client, of which no handle is asked for by name.
reader = Client("look_up")
reader.connect()
needle = reader._objects["/ambf/env/Needle"]
stamps, heights = [], []
begin = time.time()
while len(stamps) < 50 and time.time() < begin + 60.0:
    if needle.get_sim_step() not in stamps:
        stamps.append(needle.get_sim_step())
        heights.append(needle.get_pos().z)
    time.sleep(0.02)
print(f"{len(stamps)} states in {time.time() - begin:.2f} s, steps {stamps[0]} to {stamps[-1]}")
print(f"the needle lies at {min(heights):.4f} to {max(heights):.4f} m")
if len(stamps) < 50 or stamps != sorted(stamps) or not 0.01 < min(heights) <= max(heights) < 0.05:
    sys.exit(1)
reader.clean_up()
print("done", flush=True)
