"""In the style of client 3.0: an arm comes down on the table, and the contact sensor at its tip says on what, where and how deep."""

import sys
import time

import numpy as np
from ambf_client.ambf_client import Client
from instrument_arm import InstrumentArm, expect
from ros_abstraction_layer import ral

layer = ral("touch")
layer.spin()
client = Client("touch", 10)
client.connect()
arm = InstrumentArm(client, "psm2")
sensor = client.get_obj_handle("tip_contact")
time.sleep(0.3)


def tip(z):
    """The upright tool with its tip at this height; the arm looks the other way than the world."""
    pose = np.diag([-1.0, -1.0, 1.0, 1.0])
    pose[:3, 3] = 0.6, 0.2, z
    return pose


def touched():
    """Names of what is touched."""
    return [sensor.get_contact_object_name(i) for i in range(sensor.get_num_contact_events())]


arm.set_jaw_angle(0.0)
arm.move_cp(tip(0.3))
expect("nothing is touched", lambda: touched() == [], arm.hold)
# The jaws are 0.15 m long.
arm.move_cp(tip(0.149))
expect("the table is touched", lambda: [name.split("BODY ")[-1] for name in touched()] == ["table"], arm.hold)
# What was seen is kept: the next state may have no contact, because the tip bounces.
points = []


def seen():
    """Keeps the contact points of the first event, if there is one."""
    event = sensor.get_contact_event(0)
    points[:] = event.contact_data if event else []
    return bool(points)


expect("contact points", seen, arm.hold)
for data in points:
    point, normal = data.contact_point, data.contact_normal
    print(f"at {point.x:.3f} {point.y:.3f} {point.z:.3f} m, normal {normal.x:.2f} {normal.y:.2f} {normal.z:.2f}")
    print(f"distance {data.distance.data:.5f} m")
    if abs(point.x - 0.6) > 0.05 or abs(point.z) > 0.01 or abs(normal.z) < 0.99:
        sys.exit(1)
arm.move_cp(tip(0.3))
expect("nothing is touched any more", lambda: touched() == [], arm.hold)
client.clean_up()
layer.shutdown()
print("done", flush=True)
