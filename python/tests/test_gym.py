"""The environments: exact, repeatable, and clear about what went wrong."""

import os
import pathlib
import signal
import sys
import unittest
import warnings

import gymnasium
import harness
import numpy as np
import support
from ambf_client import ClientError
from ambf_gym import GymError, InvalidAction, InvalidDescription, RosBackend, Scene, SimulatorEnv, Task
from ambf_gym.parts import DriveJoints, JointPositions
from ambf_gym.process import SimulatorProcess
from ambf_gym.tasks import make_lift, make_reach
from ambf_gym.tasks.reach import BASE, JOINTS, SCENE
from gymnasium.utils.env_checker import check_env
from lift_by_hand import Hand


def setUpModule():
    """Environments start this simulator."""
    os.environ["AMBF_SIMULATOR"] = str(harness.simulator_path())
    for name in ("ROS_MASTER_URI", "ROS_IP", "ROS_HOSTNAME"):
        os.environ.pop(name, None)
    warnings.filterwarnings("ignore", message=".*infinity.*")


def roll_out(env, steps, seed):
    """Everything that is observed over two episodes with random actions, as bytes."""
    seen = []
    actions = np.random.default_rng(seed)
    for episode in range(2):
        observation, _ = env.reset(seed=seed + episode)
        seen.append(observation)
        for _ in range(steps):
            action = actions.uniform(env.action_space.low, env.action_space.high)
            observation, reward, *_ = env.step(action)
            seen += [observation, np.array([reward])]
    return b"".join(part.tobytes() for part in seen)


class Environments(support.TimedTest):
    """The worked tasks in simulators of their own."""

    def make(self, maker, *arguments, **options):
        """An environment that is closed at the end."""
        env = maker(*arguments, **options)
        self.addCleanup(env.close)
        return env

    def test_the_checker_of_gymnasium(self):
        """It finds nothing to complain of."""
        for name in ("Reach", "Lift"):
            with self.subTest(name):
                env = self.make(gymnasium.make, f"ambf/{name}-v0", backend="ros")
                check_env(env.unwrapped, skip_render_check=True)

    def test_trajectories_repeat_to_the_bit(self):
        """In simulators that were started afresh, same seeds and actions give the same bytes."""
        for maker in (make_reach, make_lift):
            with self.subTest(maker.__name__):
                first, second = self.make(maker, "ros"), self.make(maker, "ros")
                found = roll_out(first, 30, seed=5)
                self.assertEqual(found, roll_out(second, 30, seed=5))
                self.assertNotEqual(found, roll_out(second, 30, seed=6))
                self.assertEqual(found, roll_out(first, 30, seed=5), "a reset leaves nothing of what was before")
        legacy = Scene(SCENE.models)
        task = Task(
            (JointPositions(BASE, JOINTS),),
            (DriveJoints(BASE, JOINTS),),
            lambda step: step.after.bodies[BASE].position[2],
        )
        first, second = (self.make(SimulatorEnv, RosBackend(legacy), task) for _ in range(2))
        self.assertEqual(roll_out(first, 30, seed=5), roll_out(second, 30, seed=5), "profile legacy")

    def test_no_step_is_skipped_or_doubled(self):
        """The simulator's own count says so."""
        env = self.make(make_reach, "ros")
        env.reset(seed=1)
        begin = env.states.sim_step
        for step in range(1, 51):
            *_, truncated, info = env.step(env.action_space.sample())
            self.assertEqual(env.states.sim_step, begin + 40 * step)
            self.assertEqual((info["iterations"], truncated), (40 * step, step == 50))

    def test_spaces(self):
        """Bounds are the limits of the joints in the scene's file."""
        task = Task(
            (JointPositions(BASE, JOINTS[:2]),), (DriveJoints(BASE, JOINTS[:2]),), lambda _: 0.0, scaled_actions=False
        )
        env = self.make(SimulatorEnv, RosBackend(SCENE), task)
        np.testing.assert_allclose(env.action_space.low, [-2.9, -2.0], rtol=1e-6)
        np.testing.assert_allclose(env.action_space.high, [2.9, 2.0], rtol=1e-6)
        np.testing.assert_allclose(env.observation_space.high, [2.9 + 0.58, 2.0 + 0.4], rtol=1e-6)
        observation, _ = env.reset(seed=0)
        for _ in range(60):
            observation, *_ = env.step([0.5, 0.6])
        np.testing.assert_allclose(observation, [0.5, 0.6], atol=0.05)

    def test_lifting_and_placing_can_be_done(self):
        """By hand: the gripper fetches the block and puts it down at the goal."""
        env = self.make(make_lift, "ros")
        for seed in range(3):
            observation, _ = env.reset(seed=seed)
            hand, over, total = Hand(), False, 0.0
            while not over:
                observation, reward, terminated, truncated, info = env.step(hand(observation))
                over, total = terminated or truncated, total + reward
            self.assertTrue(info["is_success"] and terminated, (seed, info))

    def test_actions_that_are_none(self):
        """Wrong shapes and NaN are refused and move nothing; beyond the bounds is moved to them."""
        env = self.make(make_reach, "ros")
        with self.assertRaises(gymnasium.error.ResetNeeded):
            env.step(np.zeros(7))
        env.reset(seed=1)
        at = env.states.sim_step
        for wrong in (np.zeros(6), np.zeros((1, 7)), np.full(7, np.nan), np.full(7, np.inf), 0.0):
            self.assertRaises(InvalidAction, env.step, wrong)
        self.assertEqual(env.states.sim_step, at)
        observation, *_, info = env.step(np.full(7, 100.0))
        self.assertTrue(info["clipped"])
        other = self.make(make_reach, "ros")
        other.reset(seed=1)
        same, *_, info = other.step(np.full(7, 1.0))
        self.assertFalse(info["clipped"])
        np.testing.assert_array_equal(observation, same)

    def test_a_simulator_that_is_killed_in_an_episode(self):
        """The step fails at once, the next reset starts another one."""
        env = self.make(make_reach, "ros")
        first, _ = env.reset(seed=3)
        env.step(np.zeros(7))
        os.killpg(env._backend._process._process.pid, signal.SIGKILL)
        with self.within(5.0), self.assertRaises(ClientError):
            env.step(np.zeros(7))
        self.assertRaises(gymnasium.error.ResetNeeded, env.step, np.zeros(7))
        again, _ = env.reset(seed=3)
        np.testing.assert_array_equal(first, again)

    def test_somebody_else_steps_too(self):
        """It is noticed."""
        process = SimulatorProcess(SCENE)
        self.addCleanup(process.close)
        env = self.make(make_reach, RosBackend(SCENE, attach=process.namespace))
        env.reset(seed=1)
        env._backend._world.step(7, patience=60.0)
        with self.assertRaisesRegex(GymError, "somebody else"):
            env.step(np.zeros(7))
        env.reset(seed=1)
        env.step(np.zeros(7))
        # After an environment that was attached has gone, the simulator runs freely.
        world = process.namespace + "/ambf/env/World"
        env.close()
        import rospy
        from ambf_msgs.msg import WorldState

        first = rospy.wait_for_message(f"{world}/State", WorldState, 30).sim_step
        harness.wait_for(
            lambda: rospy.wait_for_message(f"{world}/State", WorldState, 30).sim_step > first + 100, "it runs"
        )

    def test_descriptions_that_fit_no_scene(self):
        """They are refused with the name of what is missing."""
        nothing = {"reward": lambda _: 0.0}
        with self.assertRaisesRegex(InvalidDescription, "give low and high"):
            SimulatorEnv(RosBackend(SCENE), Task((), (DriveJoints(BASE, JOINTS, mode="effort"),), **nothing))
        with self.assertRaisesRegex(InvalidDescription, "there is no file"):
            SimulatorEnv(
                RosBackend(Scene(("models/nothing.yaml",))), Task((), (DriveJoints(BASE, ("yaw",)),), **nothing)
            )
        task = Task((JointPositions(BASE, ("yow",)),), (DriveJoints(BASE, ("yaw",)),), **nothing)
        env = self.make(SimulatorEnv, RosBackend(SCENE), task)
        with self.assertRaisesRegex(InvalidDescription, "yow"):
            env.reset()
        task = Task((JointPositions("arm8/base", ("yaw",)),), (DriveJoints(BASE, ("yaw",)),), **nothing)
        env = self.make(SimulatorEnv, RosBackend(SCENE, timeout=3.0), task)
        with self.assertRaisesRegex(InvalidDescription, "arm8/base"):
            env.reset()


class Processes(support.TimedTest):
    """Several environments at once."""

    def run_program(self, text):
        """A program that has to end well; what it printed."""
        env = {name: value for name, value in harness.environment(1).items() if name != "ROS_MASTER_URI"}
        env["AMBF_SIMULATOR"] = str(harness.simulator_path())
        with harness.Program([sys.executable, "-u", "-W", "ignore", "-c", text], env) as program:
            self.assertEqual(program.status(), 0, program.log())
            return program.log()

    def test_a_vector_in_processes(self):
        """Each has a master and a simulator of its own."""
        self.run_program(
            """
import gymnasium, numpy, ambf_gym
if __name__ == '__main__':
    envs = gymnasium.make_vec('ambf/Reach-v0', num_envs=2, vectorization_mode='async', backend='ros')
    observations, _ = envs.reset(seed=[4, 4])
    numpy.testing.assert_array_equal(observations[0], observations[1])
    for _ in range(60):
        action = numpy.tile(numpy.full(7, 0.01), (2, 1))
        observations, rewards, *_ = envs.step(action)
    assert not numpy.array_equal(observations[0][:7], numpy.zeros(7))
    envs.close()
"""
        )

    def test_a_vector_in_this_process(self):
        """They share a master, and are told apart by namespaces."""
        self.run_program(
            """
import gymnasium, numpy, ambf_gym
envs = gymnasium.make_vec('ambf/Reach-v0', num_envs=2, vectorization_mode='sync', backend='ros')
observations, _ = envs.reset(seed=[4, 4])
numpy.testing.assert_array_equal(observations[0], observations[1])
for _ in range(10):
    observations, *_ = envs.step(numpy.full((2, 7), 0.02))
    numpy.testing.assert_array_equal(observations[0], observations[1])
envs.close()
"""
        )

    def test_no_simulator_outlives_its_environment(self):
        """However the program ends."""
        log = self.run_program(
            """
import os, signal, ambf_gym
from ambf_gym.tasks import make_reach
if os.fork() == 0:
    env = make_reach('ros'); env.reset()
    print('guard', env._backend._process._process.pid, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
os.wait()
"""
        )
        guard = int(log.split("guard")[1].split()[0])
        harness.wait_for(lambda: not os.path.exists(f"/proc/{guard}"), "the guard ends, after its simulator")

    def test_no_simulator_outlives_its_guard(self):
        """As when a program kills its children before it ends."""
        env = make_reach("ros")
        self.addCleanup(env.close)
        env.reset()
        guard = env._backend._process._process.pid
        simulator = int(pathlib.Path(f"/proc/{guard}/task/{guard}/children").read_text())
        os.kill(guard, signal.SIGKILL)
        harness.wait_for(lambda: not os.path.exists(f"/proc/{simulator}"), "the simulator ends")


if __name__ == "__main__":
    unittest.main()
