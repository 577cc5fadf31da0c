"""Tasks in one ambf.Batch: the same as in simulations of their own, to the last bit."""

import importlib.util
import unittest
import warnings

import gymnasium
import numpy as np
from ambf_gym import (
    DriveBody,
    DriveJoints,
    InProcessBackend,
    InvalidAction,
    InvalidDescription,
    Scene,
    SimulatorEnv,
    Task,
)
from ambf_gym.backend import BodyCommand
from ambf_gym.parts import (
    Hold,
    JointEfforts,
    JointPositions,
    JointVelocities,
    Measurements,
    Position,
    Rotation,
    Twist,
)
from ambf_gym.tasks import lift, needle_pick, reach
from ambf_gym.worlds import Worlds
from lift_by_hand import Hand

N = 3


def other_task():
    """Bodies that are pushed, joints by effort, commands that are always the same, states at the start."""

    def also(commands):
        commands.bodies.setdefault(reach.BASE, BodyCommand()).joints["elbow"] = (2, 0.1)

    def start(rng):
        drawn = rng.uniform(-0.2, 0.2)
        return {"joint_positions": {"yaw": drawn}} if drawn > -0.1 else {}

    return Task(
        observe=(
            JointPositions(reach.BASE, reach.JOINTS),
            JointVelocities(reach.BASE, ("yaw",)),
            JointEfforts(reach.BASE, ("yaw", "roll")),
            Position(reach.FLANGE, relative_to=reach.BASE),
            Rotation(reach.FLANGE),
            Twist(reach.FLANGE),
        ),
        act=(
            DriveJoints(reach.BASE, ("roll", "wrist"), mode="effort", low=-2, high=2),
            DriveBody(reach.FLANGE, low=-3, high=3, size=6),
        ),
        reward=lambda step: step.after.bodies[reach.FLANGE].position[2] + step.after.sim_step - step.before.sim_step,
        terminated=lambda step: step.after.bodies[reach.FLANGE].position[2] > -0.6,
        start=start,
        also=also,
        settle_steps=3,
        max_steps=9,
    )


class Above(Position):
    """A part of one's own: one number."""

    def bounds(self, limits):
        return np.full(1, -np.inf), np.full(1, np.inf)

    def read(self, states):
        return states.bodies[self.body].position[..., 2:] + 1.0


class TestWorlds(unittest.TestCase):
    """Against `SimulatorEnv`."""

    def setUp(self):
        warnings.filterwarnings("ignore", message=".*infinity.*")

    def test_each_world_is_an_environment(self):
        """Observations, rewards, ends and infos, over episodes that end at different times; both profiles."""
        legacy = Scene(reach.SCENE.models, options=("--profile", "legacy"))
        for scene, task in (
            (reach.SCENE, reach.TASK),
            (Scene(reach.SCENE.models), other_task()),
            (legacy, other_task()),
        ):
            worlds = Worlds(scene, task, N, max_episode_steps=6)
            self.addCleanup(worlds.close)
            singles = [SimulatorEnv(InProcessBackend(scene), task, max_episode_steps=6) for _ in range(N)]
            for env in singles:
                self.addCleanup(env.close)
            self.assertEqual(
                (worlds.action_space, worlds.observation_space), (singles[0].action_space, singles[0].observation_space)
            )
            found = worlds.reset(seeds=[5, 6, 7])
            np.testing.assert_array_equal(found, [env.reset(seed=5 + i)[0] for i, env in enumerate(singles)])
            rng = np.random.default_rng(1)
            ends = 0
            for _ in range(20):
                actions = rng.uniform(-1.3, 1.3, size=(N, *worlds.action_space.shape))
                observations, rewards, terminated, truncated, infos = worlds.step(actions)
                for i, env in enumerate(singles):
                    expected = env.step(actions[i])
                    np.testing.assert_array_equal(observations[i], expected[0])
                    self.assertEqual((rewards[i], terminated[i], truncated[i], infos[i]), expected[1:])
                over = terminated | truncated
                # Some at other times, so that only part of the worlds is reset.
                over[0] |= rng.random() < 0.3
                ends += over.sum()
                if over.any():
                    observations = worlds.reset(over)
                    for i in np.flatnonzero(over):
                        np.testing.assert_array_equal(observations[i], singles[i].reset()[0])
            self.assertGreater(ends, N)

    def test_rays_are_observed(self):
        """Of a sensor with one ray, which is asked for two: the second is 0."""
        task = Task(
            (Measurements("proximity", 2), Position("block")),
            (DriveBody("palm", "velocity", low=-1, high=1),),
            lambda step: 0.0,
        )
        worlds = Worlds(lift.SCENE, task, 2)
        self.addCleanup(worlds.close)
        singles = [SimulatorEnv(InProcessBackend(lift.SCENE), task) for _ in range(2)]
        found = [worlds.reset(seeds=[1, 2])]
        expected = [[env.reset(seed=seed)[0] for seed, env in zip((1, 2), singles)]]
        for step in range(15):
            actions = np.array([[0, 0, -0.2], [0.3, 0, -0.01 * step]])
            found.append(worlds.step(actions)[0])
            expected.append([env.step(action)[0] for env, action in zip(singles, actions)])
        for env in singles:
            env.close()
        np.testing.assert_array_equal(found, expected)
        self.assertGreater(len({*np.array(found)[:, :, 0].ravel()}), 2)
        self.assertFalse(np.array(found)[:, :, 1].any())

    def test_actuators_hold_and_tasks_remember(self):
        """Blocks that are lifted, and needles that change hands, in worlds that are at different places of their scripts."""
        for module, player, steps in (
            (lift, lambda env: Hand(), 150),
            (needle_pick, lambda env: needle_pick.Player(), 120),
        ):
            task = lift.TASK if module is lift else needle_pick.task()
            worlds = Worlds(module.SCENE, task, N)
            self.addCleanup(worlds.close)
            singles = [SimulatorEnv(InProcessBackend(module.SCENE), task) for _ in range(N)]
            seen = worlds.reset(seeds=[1, 2, 3])
            expected = [env.reset(seed=seed)[0] for seed, env in zip((1, 2, 3), singles)]
            players = [player(env) for env in singles]
            held, told = set(), set()
            for step in range(steps):
                np.testing.assert_array_equal(seen, expected)
                if module is lift:
                    actions = [one(observation) for one, observation in zip(players, expected)]
                else:
                    actions = [one.action(env.states) for one, env in zip(players, singles)]
                # One world lags behind the others.
                actions[2] *= step > 20
                seen, rewards, terminated, _, infos = worlds.step(np.stack(actions))
                results = [env.step(action) for env, action in zip(singles, actions)]
                expected = [result[0] for result in results]
                self.assertEqual(list(zip(rewards, terminated)), [result[1:3] for result in results])
                self.assertEqual(list(infos), [result[4] for result in results])
                held.add(tuple(worlds.batch.holding.any(axis=1)))
                told.add(tuple(info.get("stage") for info in infos))
                if terminated.any():
                    break
            for env in singles:
                env.close()
            self.assertTrue({(False,) * 3, (True,) * 3} <= held and len(held) > 2, held)
            self.assertTrue(module is lift or {stage for stages in told for stage in stages} >= {0, 1}, told)

    def test_parts_of_ones_own(self):
        """They read arrays of worlds, between those of the package; alone they read the same of one."""
        task = Task(
            (Position("block"), Above("block"), Position("palm"), Above("palm")),
            (DriveBody("palm", "velocity", low=-1, high=1),),
            lambda step: np.zeros(len(step.after)) if step.after.flat.ndim > 1 else 0.0,
            of_arrays=True,
        )
        worlds = Worlds(lift.SCENE, task, 2)
        self.addCleanup(worlds.close)
        singles = [SimulatorEnv(InProcessBackend(lift.SCENE), task) for _ in range(2)]
        np.testing.assert_array_equal(
            worlds.reset(seeds=[1, 2]), [env.reset(seed=seed)[0] for seed, env in zip((1, 2), singles)]
        )
        actions = np.array([[0, 0, -0.2], [0.3, 0, 0.1]])
        for _ in range(5):
            seen = worlds.step(actions)[0]
            np.testing.assert_array_equal(seen, [env.step(action)[0] for env, action in zip(singles, actions)])
        np.testing.assert_allclose(seen[:, 3], seen[:, 2] + 1.0, atol=1e-6)
        for env in singles:
            env.close()

    def test_joints_that_are_tied(self):
        """One number opens both fingers, which are kept where they are to be at rest; alone and in many worlds."""
        fingers = ("leftslide", "rightslide")
        task = Task(
            (JointPositions("palm", fingers), JointVelocities("palm", fingers)),
            (DriveJoints("palm", fingers, tied=True, at_rest=0.01),),
            lambda step: 0.0,
            settle_steps=300,
        )
        worlds, env = Worlds(lift.SCENE, task, 2), SimulatorEnv(InProcessBackend(lift.SCENE), task)
        self.addCleanup(worlds.close)
        self.addCleanup(env.close)
        self.assertEqual((worlds.action_space.shape, env.action_space.shape), ((1,), (1,)))
        seen, alone = worlds.reset(seeds=[1, 2]), env.reset(seed=1)[0]
        np.testing.assert_array_equal(seen[0], alone)
        rested = seen[0, :2]
        other = Worlds(lift.SCENE, Task(**{**vars(task), "act": (DriveJoints("palm", fingers, tied=True),)}), 1)
        self.addCleanup(other.close)
        self.assertGreater(np.abs(rested - other.reset()[0, :2]).min(), 0.005)
        for _ in range(30):
            seen, alone = worlds.step(np.array([[1.0], [-1.0]]))[0], env.step([1.0])[0]
            np.testing.assert_array_equal(seen[0], alone)
        # Both fingers of a world go one way, and those of the other one the other.
        self.assertLess(np.ptp(seen[0, :2]), 1e-3)
        self.assertGreater(seen[0, :2].min(), seen[1, :2].max() + 0.005)
        with self.assertRaisesRegex(InvalidDescription, "at rest"):
            DriveJoints("palm", fingers, mode="effort", at_rest=0.1)

    def test_integrators(self):
        """They are those of single environments."""
        worlds = Worlds(reach.SCENE, reach.TASK, 1, integrator="euler")
        self.addCleanup(worlds.close)
        env = SimulatorEnv(InProcessBackend(reach.SCENE, integrator="euler"), reach.TASK)
        self.addCleanup(env.close)
        np.testing.assert_array_equal(worlds.reset(seeds=[3])[0], env.reset(seed=3)[0])
        for _ in range(5):
            np.testing.assert_array_equal(worlds.step(np.full((1, 7), 0.4))[0][0], env.step(np.full(7, 0.4))[0])

    def test_infos(self):
        """Columns are arrays; dicts of worlds are made of them, and keep what is added."""
        worlds = Worlds(reach.SCENE, reach.TASK, 3)
        self.addCleanup(worlds.close)
        worlds.reset(seeds=[1, 2, 3])
        *_, infos = worlds.step(np.full((3, 7), 1.5))
        self.assertEqual(list(infos.columns), ["iterations", "clipped", "distance", "is_success"])
        self.assertEqual(infos.columns["distance"].shape, (3,))
        infos[1]["seen"] = True
        self.assertEqual(len(infos), 3)
        for i, info in enumerate(infos):
            self.assertEqual((info["iterations"], info["clipped"], info["is_success"]), (40, True, False))
            self.assertEqual((info["distance"], "seen" in info), (infos.columns["distance"][i], i == 1))
            self.assertEqual([type(value) for value in list(info.values())[:4]], [int, bool, float, bool])
        self.assertEqual(infos[-2:], list(infos)[1:])
        self.assertRaises(IndexError, lambda: infos[3])

    def test_what_is_refused(self):
        """And nothing moves."""
        worlds = Worlds(reach.SCENE, reach.TASK, 2)
        self.addCleanup(worlds.close)
        self.assertRaises(gymnasium.error.ResetNeeded, worlds.step, np.zeros((2, 7)))
        worlds.reset()
        before = worlds.batch.poses.copy()
        for wrong in (np.zeros(7), np.zeros((3, 7)), np.full((2, 7), np.nan)):
            self.assertRaises(InvalidAction, worlds.step, wrong)
        np.testing.assert_array_equal(worlds.batch.poses, before)
        self.assertRaises(ValueError, worlds.reset, np.ones(3, dtype=bool))
        self.assertRaises(ValueError, Worlds, reach.SCENE, reach.TASK, 0)
        hand = Hold("hand", sensor="proximity")
        with self.assertRaisesRegex(InvalidDescription, "hand"):
            Worlds(lift.SCENE, Task((Position("block"),), (hand,), lambda step: 0.0), 2)
        own = Task((Above("block"),), lift.TASK.act, lambda step: 0.0)
        with self.assertRaisesRegex(InvalidDescription, "of_arrays"):
            Worlds(lift.SCENE, own, 2)
        with self.assertRaisesRegex(InvalidDescription, "nobody"):
            Worlds(reach.SCENE, Task((Position("nobody"),), (), lambda step: 0.0), 2)

    def test_a_world_that_is_lost(self):
        """It is terminated, and its next episode is sound."""
        worlds = Worlds(reach.SCENE, reach.TASK, 2)
        self.addCleanup(worlds.close)
        worlds.reset(seeds=[1, 2])
        flange = worlds.batch.body(reach.FLANGE)
        worlds.batch.kinds[1, flange], worlds.batch.target_twists[1, flange] = 2, 1e300
        _, rewards, terminated, _, infos = worlds.step(np.zeros((2, 7)))
        self.assertEqual((terminated.tolist(), rewards[1]), ([False, True], 0.0))
        self.assertIn("lost", infos[1])
        worlds.reset(terminated)
        self.assertFalse(worlds.step(np.zeros((2, 7)))[2].any())


@unittest.skipUnless(importlib.util.find_spec("stable_baselines3"), "stable-baselines3 is not installed")
class StableBaselines(unittest.TestCase):
    """What learners expect."""

    def test_episodes_go_on_by_themselves(self):
        """The last observation is told, and that of the next episode returned."""
        from ambf_gym.sb3 import VecEnv

        env = VecEnv(reach.SCENE, reach.TASK, N, max_episode_steps=4)
        self.addCleanup(env.close)
        worlds = Worlds(reach.SCENE, reach.TASK, N, max_episode_steps=4)
        self.addCleanup(worlds.close)
        env.seed(3)
        np.testing.assert_array_equal(env.reset(), worlds.reset(seeds=[3, 4, 5]))
        for step in range(1, 10):
            actions = np.full((N, 7), 0.3, dtype=np.float32)
            observations, rewards, dones, infos = env.step(actions)
            last, expected, *_ = worlds.step(actions)
            np.testing.assert_array_equal(rewards, expected.astype(np.float32))
            self.assertEqual(dones.tolist(), [step % 4 == 0] * N)
            if step % 4 == 0:
                for i, info in enumerate(infos):
                    np.testing.assert_array_equal(info["terminal_observation"], last[i])
                    self.assertTrue(info["TimeLimit.truncated"])
                last = worlds.reset()
            np.testing.assert_array_equal(observations, last)
        self.assertEqual(env.get_attr("render_mode"), [None] * N)
        self.assertEqual(env.env_is_wrapped(gymnasium.Wrapper), [False] * N)


if __name__ == "__main__":
    unittest.main()
