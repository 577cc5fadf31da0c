"""The environment of the ring on the wire."""

import unittest
import warnings

import ambf
import ambf_gym
import gymnasium
import numpy as np
from ambf_gym import InvalidDescription, Pixels
from ambf_gym.tasks import ring_on_wire
from ambf_peg_transfer.arms import quaternion_of
from ambf_ring_on_wire import plan, wire
from gymnasium.utils.env_checker import check_env

NAME = "ambf/RingOnWire-v0"


def setUpModule():
    """Bounds of positions are infinite."""
    warnings.filterwarnings("ignore", message=".*infinity.*")


def make(**options):
    """One environment, in this process."""
    return gymnasium.make(NAME, backend="process", **options)


def rest(env):
    """An action that moves nothing and keeps the jaws closed."""
    action = np.zeros(env.action_space.shape, np.float32)
    action[6] = -1.0
    return action


class Environment(unittest.TestCase):
    """What Gymnasium asks for, and what the judge says."""

    def test_it_is_one_of_gymnasiums(self):
        """Spaces, seeds, types."""
        self.assertIn("RingOnWire", ambf_gym.__doc__)
        env = make(max_episode_steps=20)
        check_env(env.unwrapped, skip_render_check=True)
        env.close()

    def test_the_ring_starts_in_the_jaws(self):
        """Around the wire, held as the seed has it; the same seed, the same run. It stays there."""
        env = make()
        seen, held = [], set()
        for seed in (4, 5, 4):
            run = [env.reset(seed=seed)[0]]
            states = env.unwrapped.states
            ring, tool = states.bodies[ring_on_wire.RING], states.bodies[ring_on_wire.TOOL]
            self.assertLess(wire.nearest(ring.position).distance, 0.001)
            held.add(tuple((tool.position - ring.position).round(4)))
            for _ in range(40):
                observation, reward, terminated, _, info = env.step(rest(env))
                run.append(observation)
                self.assertAlmostEqual(reward, 0.0, delta=0.02)
                self.assertFalse(terminated)
            self.assertEqual((info["score"]["drops"], info["score"]["touches"]), (0, 0))
            moved = np.linalg.norm(env.unwrapped.states.bodies[ring_on_wire.RING].position - ring.position)
            self.assertLess(moved, 3e-4)
            seen.append(np.concatenate(run).tobytes())
        self.assertEqual(seen[0], seen[2])
        self.assertEqual(len(held), 2)
        env.close()

    def test_many_at_once_are_as_each_alone(self):
        """The same observations and rewards."""
        alone, many = make(), gymnasium.make_vec(NAME, num_envs=2, backend="process")
        observations, _ = many.reset(seed=7)
        action = np.random.default_rng(1).uniform(-1, 1, alone.action_space.shape).astype(np.float32)
        stepped, rewards, _, _, infos = many.step(np.stack([action, action]))
        for world in range(2):
            observation, _ = alone.reset(seed=7 + world)
            np.testing.assert_array_equal(observation, observations[world])
            observation, reward, _, _, info = alone.step(action)
            np.testing.assert_array_equal(observation, stepped[world])
            self.assertEqual(reward, rewards[world])
            self.assertEqual(info["score"]["along"], infos["score"]["along"][world])
        alone.close()
        many.close()

    def test_the_way_is_rewarded(self):
        """A ring that is put further along, and at the end, by hand; sparse knows the end alone."""
        for reward in ("sparse", "shaped"):
            env = make(reward=reward)
            env.reset(seed=1)
            sums = []
            for along in (0.08, wire.LENGTH - wire.GOAL):
                at = plan.ring_at(along, 1.0)
                env.unwrapped._backend.simulation.set_state(
                    poses={ring_on_wire.RING: (*at.position, *quaternion_of(at.axes))},
                    twists={ring_on_wire.RING: np.zeros(6)},
                )
                # The first of an episode's steps shows the state that was set.
                _, got, terminated, _, info = env.step(rest(env))
                sums.append(got)
            self.assertTrue(terminated and info["is_success"], info)
            if reward == "sparse":
                self.assertEqual(sums, [0.0, 1.0])
            else:
                self.assertGreater(sums[0], 1.0)
                self.assertAlmostEqual(sum(sums), 1.0 + ring_on_wire.PROGRESS, delta=0.1)
            env.close()
        with self.assertRaises(InvalidDescription):
            make(reward="dense")

    def test_the_goal_form_has_rewards_of_goals_alone(self):
        """Goals are on the wire; rewards of any shape are those of the steps."""
        env = make(goal_form=True)
        observation, _ = env.reset(seed=2)
        self.assertTrue(env.observation_space.contains(observation))
        self.assertLess(wire.nearest(observation["desired_goal"]).distance, 1e-6)
        observation, reward, _, _, info = env.step(rest(env))
        compute = env.get_wrapper_attr("compute_reward")
        goals = observation["achieved_goal"], observation["desired_goal"]
        self.assertEqual((reward, compute(*goals, info), info["is_success"]), (-1.0, -1.0, False))
        many = compute(np.stack([goals[1], goals[0]]), np.stack([goals[1], goals[1]]), None)
        np.testing.assert_array_equal(many, [0.0, -1.0])
        env.close()

    def test_pictures_can_be_observed(self):
        """Of both cameras."""
        eyes = [Pixels(camera=f"stereo/{side}", width=64, height=48, name=side) for side in ("left", "right")]
        env = make(pixels=eyes)
        try:
            observation, _ = env.reset(seed=3)
        except ambf.RenderError as error:
            self.skipTest(f"nothing can be drawn: {error}")
        self.assertTrue(env.observation_space.contains(observation))
        for side in ("left", "right"):
            self.assertEqual(observation[side].shape, (48, 64, 3))
            self.assertGreater(observation[side].std(), 5.0)
        env.close()


if __name__ == "__main__":
    unittest.main()
