"""An arm in pybullet: pybullet_peer.py MODEL. Answers each line `CALLS STEPS` with the seconds that so many calls took.

A call sets the set points of all joints, makes STEPS steps of 1 ms and reads the joints and the pose of the last link.
"""

import math
import os
import sys
import time

# The answers own standard output; pybullet prints to it as it likes.
ANSWERS = os.fdopen(os.dup(1), "w", buffering=1)
os.dup2(2, 1)

import pybullet  # noqa: E402


def main():
    """Answers until there are no more lines."""
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setTimeStep(0.001, client)
    pybullet.setGravity(0.0, 0.0, -9.8, client)
    arm = pybullet.loadURDF(sys.argv[1], useFixedBase=True, physicsClientId=client)
    infos = [pybullet.getJointInfo(arm, i, client) for i in range(pybullet.getNumJoints(arm, client))]
    joints = [info[0] for info in infos if info[2] == pybullet.JOINT_REVOLUTE]
    forces = [infos[joint][10] for joint in joints]
    print(len(joints), file=ANSWERS)
    call = 0
    for line in sys.stdin:
        calls, steps = (int(word) for word in line.split())
        begin = time.perf_counter()
        for _ in range(calls):
            call += 1
            goals = [0.3 * math.sin(0.01 * call + joint) for joint in joints]
            pybullet.setJointMotorControlArray(
                arm, joints, pybullet.POSITION_CONTROL, targetPositions=goals, forces=forces, physicsClientId=client
            )
            for _ in range(steps):
                pybullet.stepSimulation(client)
            pybullet.getJointStates(arm, joints, client)
            pybullet.getLinkState(arm, joints[-1], computeLinkVelocity=1, physicsClientId=client)
        print(time.perf_counter() - begin, file=ANSWERS)


if __name__ == "__main__":
    main()
