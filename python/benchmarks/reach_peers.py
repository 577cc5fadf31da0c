"""The reach task of ambf_gym in other simulators: reach_peers.py pybullet|mujoco sync|async WORLDS MODEL.

As Gymnasium's vector environments do it: `sync` steps all worlds in one process, one after the other; `async` has a process a world.
Answers each line `CALLS` with the seconds that so many steps of all worlds took, actions drawn before. Same arm, observation, reward,
length of an episode, 40 steps of 1 ms; position control of the joints. Runs in the virtual environment of scripts/peers.
"""

import os
import sys
import time

# The answers own standard output; libraries print to it as they like.
ANSWERS = os.fdopen(os.dup(1), "w", buffering=1)
os.dup2(2, 1)

import gymnasium  # noqa: E402
import numpy as np  # noqa: E402

SKIP, LENGTH = 40, 50
INCREMENT = 0.08
SPREAD = np.array([0.15, 0.3, 0.2])
SUCCESS = 0.03


class Reach(gymnasium.Env):
    """The task; `simulator` has `count` joints, `lower`, `upper`, `reset()`, `step(goals, steps)` and `state()`: q, dq, flange."""

    def __init__(self, simulator):
        self.simulator = simulator
        self.home = simulator.state()[2].copy()
        count = simulator.count
        self.action_space = gymnasium.spaces.Box(-INCREMENT, INCREMENT, (count,), np.float32)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2 * count + 6,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.simulator.reset()
        self.goal = self.home + self.np_random.uniform(-SPREAD, SPREAD)
        self.targets = self.simulator.state()[0].copy()
        self.made = 0
        return self.observe()[0], {}

    def observe(self):
        positions, velocities, flange = self.simulator.state()
        seen = np.concatenate([positions, velocities, flange, self.goal]).astype(np.float32)
        return seen, float(np.linalg.norm(flange - self.goal))

    def step(self, action):
        self.targets = np.clip(self.targets + action, self.simulator.lower, self.simulator.upper)
        self.simulator.step(self.targets, SKIP)
        self.made += 1
        seen, away = self.observe()
        reward = -away - 0.02 * float(np.mean(np.square(action / INCREMENT))) + 0.5 * (away < SUCCESS)
        return seen, reward, False, self.made >= LENGTH, {"distance": away, "is_success": away < SUCCESS}


class PyBullet:
    """The arm in pybullet."""

    def __init__(self, model):
        import pybullet

        self.library = pybullet
        self.client = client = pybullet.connect(pybullet.DIRECT)
        pybullet.setTimeStep(0.001, client)
        pybullet.setGravity(0.0, 0.0, -9.8, client)
        self.arm = pybullet.loadURDF(model, useFixedBase=True, physicsClientId=client)
        infos = [pybullet.getJointInfo(self.arm, i, client) for i in range(pybullet.getNumJoints(self.arm, client))]
        infos = [info for info in infos if info[2] == pybullet.JOINT_REVOLUTE]
        self.joints, self.count = [info[0] for info in infos], len(infos)
        self.lower, self.upper = np.array([info[8] for info in infos]), np.array([info[9] for info in infos])
        self.forces = [info[10] for info in infos]

    def reset(self):
        for joint in self.joints:
            self.library.resetJointState(self.arm, joint, 0.0, 0.0, self.client)

    def step(self, goals, steps):
        self.library.setJointMotorControlArray(
            self.arm,
            self.joints,
            self.library.POSITION_CONTROL,
            targetPositions=goals,
            forces=self.forces,
            physicsClientId=self.client,
        )
        for _ in range(steps):
            self.library.stepSimulation(self.client)

    def state(self):
        states = self.library.getJointStates(self.arm, self.joints, self.client)
        flange = self.library.getLinkState(self.arm, self.joints[-1], physicsClientId=self.client)
        return np.array([state[0] for state in states]), np.array([state[1] for state in states]), np.array(flange[4])


class MuJoCo:
    """The arm in MuJoCo. Its links do not collide with each other, as they do not in the others."""

    def __init__(self, model):
        import mujoco

        self.library = mujoco
        spec = mujoco.MjSpec.from_file(model)
        spec.option.timestep, spec.option.gravity = 0.001, [0.0, 0.0, -9.8]
        for geom in spec.geoms:
            geom.contype = geom.conaffinity = 0
        for joint in spec.joints:
            actuator = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            actuator.set_to_position(kp=200.0, kv=20.0)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.count = self.model.nu
        self.lower, self.upper = self.model.jnt_range.T
        self.flange = self.model.nbody - 1
        mujoco.mj_forward(self.model, self.data)

    def reset(self):
        self.library.mj_resetData(self.model, self.data)
        self.library.mj_forward(self.model, self.data)

    def step(self, goals, steps):
        self.data.ctrl[:] = goals
        self.library.mj_step(self.model, self.data, nstep=steps)

    def state(self):
        return self.data.qpos, self.data.qvel, self.data.xpos[self.flange]


def main():
    """Answers until there are no more lines."""
    library, way, worlds, model = sys.argv[1:]
    simulator = {"pybullet": PyBullet, "mujoco": MuJoCo}[library]
    kind = {"sync": gymnasium.vector.SyncVectorEnv, "async": gymnasium.vector.AsyncVectorEnv}[way]
    env = kind([lambda: Reach(simulator(model))] * int(worlds))
    env.reset(seed=0)
    env.action_space.seed(0)
    print(env.single_action_space.shape[0], file=ANSWERS)
    for line in sys.stdin:
        actions = [env.action_space.sample() for _ in range(int(line))]
        begin = time.perf_counter()
        for action in actions:
            env.step(action)
        print(time.perf_counter() - begin, file=ANSWERS)
    env.close()


if __name__ == "__main__":
    main()
