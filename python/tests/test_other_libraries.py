"""Tasks in the libraries of others: PettingZoo, Minari."""

import os
import tempfile
import unittest
import warnings

import gymnasium
import numpy as np
from ambf_gym import InvalidDescription
from ambf_gym.demonstrations import collect
from ambf_gym.pettingzoo import Arms
from ambf_gym.tasks import needle_pick

NAME = "ambf/NeedlePick-v0"
AGENTS = {"first": ("tool1", "holder1"), "second": ("tool2", "holder2")}


def setUpModule():
    """Bounds of positions are infinite."""
    warnings.filterwarnings("ignore", message=".*infinity.*")


class TestPettingZoo(unittest.TestCase):
    """An agent an arm."""

    def test_what_pettingzoo_asks_for(self):
        """Its own check."""
        from pettingzoo.test import parallel_api_test

        env = Arms(gymnasium.make(NAME, backend="process", max_episode_steps=10), AGENTS)
        parallel_api_test(env, num_cycles=25)
        env.close()

    def test_agents_together_are_the_environment(self):
        """The same numbers as one agent with both arms; wrong divisions are refused."""
        alone = gymnasium.make(NAME, backend="process", max_episode_steps=10)
        env = Arms(gymnasium.make(NAME, backend="process", max_episode_steps=10), AGENTS)
        observation, _ = alone.reset(seed=3)
        observations, _ = env.reset(seed=3)
        np.testing.assert_array_equal(observation, observations["second"])
        action = np.random.default_rng(1).uniform(-1, 1, 8).astype(np.float32)
        for _ in range(10):
            one = alone.step(action)
            many = env.step({"second": action[4:], "first": action[:4]})
            np.testing.assert_array_equal(one[0], many[0]["first"])
            self.assertEqual((one[1], one[3]), (many[1]["second"], many[3]["first"]))
        self.assertEqual(env.agents, [])
        with self.assertRaisesRegex(InvalidDescription, "second: an action of the shape"):
            env.reset()
            env.step({"first": action[:4], "second": action})
        for agents, message in (
            ({"first": ("tool1", "holder1")}, "belongs to no agent"),
            ({"first": ("needle/",), "second": ("tool2",)}, "belongs to"),
            ({"first": ("needle/",), "second": ("nobody",)}, "second: commands nothing"),
        ):
            with self.assertRaisesRegex(InvalidDescription, message):
                Arms(alone, agents)
        alone.close()
        env.close()


class TestMinari(unittest.TestCase):
    """Data sets."""

    def test_episodes_are_written_and_read_again(self):
        """Scripted episodes, and none where none succeeds."""
        with tempfile.TemporaryDirectory() as folder:
            os.environ["MINARI_DATASETS_PATH"] = folder
            env = gymnasium.make(NAME, backend="process")

            def scripted():
                player = needle_pick.Player()
                return lambda observation: player.action(env.unwrapped.states)

            written = collect(env, scripted, 2, "needle/scripted-v0", seed=4, only_successes=True, author="us")
            self.assertEqual(written.total_episodes, 2)
            import minari

            read = minari.load_dataset("needle/scripted-v0")
            episodes = list(read.iterate_episodes())
            self.assertTrue(all(episode.terminations[-1] for episode in episodes))
            first, _ = env.reset(seed=4)
            np.testing.assert_array_equal(episodes[0].observations[0], first)
            self.assertEqual(len(episodes[0].observations), len(episodes[0].actions) + 1)
            self.assertEqual(read.spec.env_spec.id, NAME)
            short = gymnasium.make(NAME, backend="process", max_episode_steps=5)
            with self.assertRaisesRegex(InvalidDescription, "none of 1 episodes"):
                collect(short, lambda: lambda observation: np.zeros(8), 1, "needle/none-v0", only_successes=True)
            self.assertRaises(ValueError, collect, env, scripted, 0, "needle/none-v0")
            env.close()
            short.close()


if __name__ == "__main__":
    unittest.main()
