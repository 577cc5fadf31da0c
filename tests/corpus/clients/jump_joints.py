"""In the style of client 2.0: seven joints of each arm jump over their whole range at once; the client repeats the commands at 120 Hz."""

import time

from ambf_client import Client
from instrument_arm import HOME, JAWS, JOINTS, expect

# Out of the way of the table, and of the other arm: both lean to the same side.
LOW = [-1.3, -0.8, 0.4, -2.7, -1.4, -1.4]
HIGH = [1.3, 0.8, 1.1, 2.7, 1.4, 1.4]
TOLERANCE = [0.02, 0.02, 0.01, 0.02, 0.02, 0.02, 0.02]

c = Client("jump_joints")
c.connect(120)
time.sleep(0.3)
bases = {name: c.get_obj_handle(f"{name}/baselink") for name in ("psm1", "psm2")}
needle = c.get_obj_handle("Needle")
time.sleep(0.5)


def send(name, goal):
    """Seven joints, by name, and the second jaw."""
    for joint, position in zip(JOINTS + JAWS, goal + goal[-1:]):
        bases[name].set_joint_pos(joint, position)


def errors(name, goal):
    """How far each of the seven is from its goal."""
    return [abs(bases[name].get_joint_pos(joint) - position) for joint, position in zip(JOINTS + JAWS, goal)]


def mirrored(goal):
    """The other arm stands opposite: its yaw has the other sign."""
    return [-goal[0], *goal[1:]]


class Settled:
    """True once `there` has held at every look for 60 steps (0.3 s): an arm that passes its goal at speed is not there. The next jump of an
    arm that still moves would swing its tool out of the instrument into the table."""

    def __init__(self, there):
        self.there = there
        self.since = None

    def __call__(self):
        step = bases["psm1"].get_sim_step()
        if not self.there():
            self.since = None
        elif self.since is None:
            self.since = step
        return self.since is not None and step - self.since >= 60


for turn in range(3):
    goal = [*LOW, 0.0] if turn % 2 else [*HIGH, 1.1]
    goals = {"psm1": goal, "psm2": mirrored(goal)}

    def again(goals=goals):
        for name, positions in goals.items():
            send(name, positions)

    def there(goals=goals):
        return all(e < t for name, positions in goals.items() for e, t in zip(errors(name, positions), TOLERANCE))

    begin = bases["psm1"].get_sim_step()
    expect(f"jump {turn}", Settled(there), again)
    print(
        bases["psm1"].get_sim_step() - begin,
        "steps;",
        {n: [round(e, 4) for e in errors(n, g)] for n, g in goals.items()},
        flush=True,
    )

home = {"psm1": [*HOME, 0.0], "psm2": [*HOME, 0.0]}
expect(
    "home",
    lambda: all(max(errors(name, goal)) < 0.02 for name, goal in home.items()),
    lambda: [send(name, goal) for name, goal in home.items()],
)
# Arms that swing over so fast may sweep the needle off the table, but not out of the room, and it comes back.
place = needle.get_pos()
assert abs(place.x) < 5.0 and abs(place.y) < 5.0 and -1.6 < place.z < 3.0, place
c.get_world_handle().reset()
expect(
    "the needle is where it was",
    lambda: abs(needle.get_pos().z - 0.014) < 0.005 and abs(needle.get_pos().y + 0.2) < 0.01,
)
c.clean_up()
print("done", flush=True)
