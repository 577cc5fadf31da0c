"""The environment of the peg transfer, and its scripted player."""

import unittest
import warnings

import ambf
import ambf_gym
import gymnasium
import numpy as np
from ambf_gym import InvalidDescription, Pixels
from ambf_gym.scene import resources
from ambf_gym.tasks import peg_transfer
from ambf_peg_transfer import SYMMETRIC, draw
from ambf_peg_transfer.player import OPEN, Failed, Place, Player, scene
from gymnasium.utils.env_checker import check_env

NAME = "ambf/PegTransfer-v0"


def setUpModule():
    """Bounds of positions are infinite."""
    warnings.filterwarnings("ignore", message=".*infinity.*")


def make(**options):
    """One environment, in this process."""
    return gymnasium.make(NAME, backend="process", **options)


class Environment(unittest.TestCase):
    """What Gymnasium asks for, and what the referee says."""

    def test_it_is_one_of_gymnasiums(self):
        """Spaces, seeds, types."""
        self.assertIn("PegTransfer", ambf_gym.__doc__)
        env = make(max_episode_steps=20)
        check_env(env.unwrapped, skip_render_check=True)
        env.close()

    def test_blocks_start_left_where_the_seed_puts_them(self):
        """At rest on pegs; the same seed, the same run."""
        env = make(max_episode_steps=20)
        seen = []
        for seed in (4, 5, 4):
            run = [env.reset(seed=seed)[0]]
            states = env.unwrapped.states
            for name in SYMMETRIC.blocks:
                body = states.bodies[peg_transfer.block(name)]
                x, y, z = body.position
                near = [peg for peg, at in SYMMETRIC.pegs.items() if np.hypot(x - at[0], y - at[1]) < 0.0028]
                self.assertEqual([SYMMETRIC.side(peg) for peg in near], [1])
                self.assertTrue(0.7240 < z < 0.7253)
            actions = np.random.default_rng(0)
            for _ in range(5):
                action = actions.uniform(env.action_space.low, env.action_space.high)
                run.append(env.step(action)[0])
            seen.append(np.concatenate(run).tobytes())
        self.assertEqual(seen[0], seen[2])
        self.assertNotEqual(seen[0], seen[1])
        env.close()

    def test_many_at_once_are_as_each_alone(self):
        """The same observations and rewards."""
        alone, many = make(), gymnasium.make_vec(NAME, num_envs=2, backend="process")
        observations, _ = many.reset(seed=7)
        for world in range(2):
            observation, _ = alone.reset(seed=7 + world)
            np.testing.assert_array_equal(observation, observations[world])
        action = np.random.default_rng(1).uniform(alone.action_space.low, alone.action_space.high)
        stepped, rewards, _, _, infos = many.step(np.stack([action, action]).astype(np.float32))
        observation, reward, _, _, info = alone.step(action.astype(np.float32))
        np.testing.assert_array_equal(observation, stepped[1])
        self.assertEqual(reward, rewards[1])
        self.assertEqual(info["score"]["points"], infos["score"]["points"][1])
        alone.close()
        many.close()

    def test_points_are_rewards(self):
        """A block that is put on a peg of the other side, by hand."""
        for reward in ("sparse", "shaped"):
            env = make(reward=reward)
            env.reset(seed=1)
            rest = np.zeros(env.action_space.shape)
            rest[[6, 13]] = 0.25
            still = [env.step(rest)[1] for _ in range(10)]
            np.testing.assert_allclose(still, 0.0, atol=1e-3)
            x, y = SYMMETRIC.pegs["peg18_s"]
            env.unwrapped._backend.simulation.set_state(
                poses={"block1": (x, y, peg_transfer.HEIGHT, 0, 0, 0, 1)}, twists={"block1": np.zeros(6)}
            )
            rewards, scores = zip(*((step[1], step[4]["score"]) for step in (env.step(rest) for _ in range(10))))
            self.assertEqual((scores[-1]["points"], scores[-1]["on_peg"]["block1"]), (1, "peg18_s"))
            if reward == "sparse":
                self.assertEqual(sum(rewards), 1.0)
            else:
                # Nearer to its side, in addition.
                self.assertGreater(sum(rewards), 2.0)
            env.close()
        with self.assertRaises(InvalidDescription):
            make(reward="dense")

    def test_the_goal_form_has_rewards_of_goals_alone(self):
        """Of any shape, and the same as those of the steps."""
        env = make(goal_form=True)
        observation, _ = env.reset(seed=2)
        self.assertTrue(env.observation_space.contains(observation))
        self.assertEqual(SYMMETRIC.side(self.peg_at(observation["desired_goal"])), -1)
        compute = env.get_wrapper_attr("compute_reward")
        observation, reward, terminated, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
        self.assertEqual((reward, terminated, info["is_success"]), (-1.0, False, False))
        goals = observation["achieved_goal"], observation["desired_goal"]
        self.assertEqual(compute(*goals, info), reward)
        many = compute(np.stack([goals[1], goals[0]]), np.stack([goals[1], goals[1]]), None)
        np.testing.assert_array_equal(many, [0.0, -1.0])
        env.unwrapped._backend.simulation.set_state(
            poses={"block1": (*goals[1], 0, 0, 0, 1)}, twists={"block1": np.zeros(6)}
        )
        _, reward, terminated, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
        self.assertEqual((reward, terminated, info["is_success"]), (0.0, True, True))
        env.close()

    def peg_at(self, place):
        """Its name."""
        return min(SYMMETRIC.pegs, key=lambda peg: np.hypot(*(np.array(SYMMETRIC.pegs[peg]) - place[:2])))

    def test_pictures_can_be_observed(self):
        """Of both cameras, in one environment and in many; red and blue are in them."""
        eyes = [Pixels(camera=f"stereo/{side}", width=160, height=120, name=side) for side in ("left", "right")]
        env = make(pixels=eyes)
        try:
            observation, _ = env.reset(seed=3)
        except ambf.RenderError as error:
            self.skipTest(f"nothing can be drawn: {error}")
        self.assertTrue(env.observation_space.contains(observation))
        for side in ("left", "right"):
            rgb = observation[side].astype(int)
            self.assertEqual(rgb.shape, (120, 160, 3))
            for own, other in ((0, 2), (2, 0)):
                coloured = (rgb[..., own] > 1.5 * rgb[..., other] + 20).sum()
                self.assertGreater(coloured, 20, (side, own))
        self.assertFalse(np.array_equal(observation["left"], observation["right"]))
        many = gymnasium.make_vec(NAME, num_envs=2, backend="process", pixels=eyes)
        observations, _ = many.reset(seed=3)
        np.testing.assert_array_equal(observations["left"][0], observation["left"])
        self.assertFalse(np.array_equal(observations["left"][0], observations["left"][1]))
        env.close()
        many.close()

    def test_three_minutes_are_an_episode(self):
        """By default."""
        env = make()
        self.assertEqual(env.unwrapped.max_episode_steps * 0.05, 180.0)
        env.close()


class Scripted(unittest.TestCase):
    """The player of `python -m ambf_peg_transfer.player`, through the arms' topics."""

    STEP = 0.005

    def player(self, seed, **options):
        """In a scene with that seed."""
        simulation = scene(resources(), seed, step=self.STEP, **options)
        self.addCleanup(simulation.close)
        return Player(simulation, self.STEP)

    def test_both_blocks_go_over_and_back(self):
        """Four points, by a hand-off each; in less time than the rules give, with and without errors of the joints."""
        for errors in (False, True):
            with self.subTest(errors=errors):
                score = self.player(40, errors=errors).play(2)
                self.assertEqual((score.points, score.hand_offs), (4, 4))
                self.assertLess(score.last_point, 120.0)

    def test_jaws_that_close_on_nothing_say_so(self):
        """A block is told to be higher than it is: the player looks before it lifts, opens the jaws again, and tries that grip last."""
        player = self.player(3)
        player.wait(0.5)
        arm, name, told = player.arms[1], "block1", player.block
        peg = next(peg for peg in player.free_pegs(-1) if player._plan(told(name), 1, peg, name))
        how = player._plan(told(name), 1, peg, name)[0]
        player.block = lambda name: Place(told(name).position + np.array([0.0, 0.0, 0.02]), told(name).axes)
        with self.assertRaisesRegex(Failed, "closed on nothing"):
            player._fetch(arm, name, how)
        self.assertEqual((player.refused, arm.jaw, player.holder), ({(name, how)}, OPEN, None))
        player.block = told
        # Another grip comes first now, and has it.
        other = player._plan(told(name), 1, peg, name)[0]
        self.assertNotEqual(other, how)
        player._fetch(arm, name, other)
        self.assertEqual(player.holder, (arm, name, other))
        self.assertGreater(told(name).position[2], SYMMETRIC.top + 0.03)

    def test_errors_of_joints_are_seen(self):
        """By the State of the tool: those that the seed draws."""
        player = self.player(7, errors=True)
        player.wait(1.0)
        for arm in player.arms.values():
            np.testing.assert_allclose(arm.errors[:3], draw(7).errors[arm.name], atol=1e-4)
            # Within limits, it goes to where it is to be.
            player.joints(arm, np.array([0.1, 0.1, 0.1, 0.0, 0.0, 0.0]))
            player.settle(arm)
            self.assertLess(arm.lag, 1e-3)


if __name__ == "__main__":
    unittest.main()
