"""The environment of the needle, and its scripted solution."""

import unittest
import warnings

import ambf_gym
import gymnasium
import numpy as np
from ambf_gym.tasks import needle_pick
from gymnasium.utils.env_checker import check_env

NAME = "ambf/NeedlePick-v0"
SEEDS = 100


def setUpModule():
    """Bounds of positions are infinite."""
    warnings.filterwarnings("ignore", message=".*infinity.*")


def play(env, seed):
    """The scripted solution: the last info, the rewards together, and the stages."""
    env.reset(seed=seed)
    player, total, stages, over = needle_pick.Player(), 0.0, [0], False
    while not over:
        _, reward, terminated, truncated, info = env.step(player.action(env.unwrapped.states).astype(np.float32))
        total, over = total + reward, terminated or truncated
        stages.append(info["stage"])
    return info, total, stages


class Environment(unittest.TestCase):
    """What Gymnasium asks for, and what the task is."""

    def test_it_is_one_of_gymnasiums(self):
        """Spaces, seeds, types."""
        self.assertIn("NeedlePick", ambf_gym.__doc__)
        env = gymnasium.make(NAME, backend="process", max_episode_steps=20)
        check_env(env.unwrapped, skip_render_check=True)
        env.close()

    def test_the_scripted_solution(self):
        """It does all stages in their order, with at least 95 of 100 seeds."""
        env = gymnasium.make(NAME, backend="process")
        successes = 0
        for seed in range(SEEDS):
            info, total, stages = play(env, seed)
            successes += info["is_success"]
            self.assertEqual(sorted(stages), stages)
            if info["is_success"]:
                self.assertEqual(set(stages), {0, 1, 2, 3})
                self.assertGreater(total, 14)
        env.close()
        self.assertGreaterEqual(successes, 0.95 * SEEDS)

    def test_what_is_no_solution(self):
        """Doing nothing, and lifting the needle without handing it over, are no success."""
        env = gymnasium.make(NAME, backend="process", max_episode_steps=150)
        env.reset(seed=1)
        for _ in range(150):
            *_, truncated, info = env.step(np.zeros(8, np.float32))
        self.assertTrue(truncated)
        self.assertEqual(info["stage"], 0)
        env.reset(seed=1)
        player = needle_pick.Player()
        for _ in range(150):
            action = player.action(env.unwrapped.states)
            # The second instrument never takes it.
            action[7] = -1.0
            *_, info = env.step(action.astype(np.float32))
        self.assertLess(info["stage"], 2)
        env.close()

    def test_many_at_once_are_as_each_alone(self):
        """The same observations and rewards."""
        alone, many = gymnasium.make(NAME, backend="process"), gymnasium.make_vec(NAME, num_envs=2, backend="process")
        observations, _ = many.reset(seed=7)
        for world in range(2):
            observation, _ = alone.reset(seed=7 + world)
            np.testing.assert_array_equal(observation, observations[world])
        alone.close()
        many.close()


if __name__ == "__main__":
    unittest.main()
