"""The first stage of the peg transfer: the task, its scripted solution, and what it is worth."""

import unittest
import warnings

import ambf
import gymnasium
import numpy as np
from ambf_gym import InvalidDescription, Worlds
from ambf_gym.scene import resources
from ambf_gym.tasks import peg_lift
from ambf_peg_transfer import SYMMETRIC, Pose, Referee
from ambf_peg_transfer.arms import (
    BASES,
    LOWER,
    UPPER,
    about,
    base,
    forward,
    matrices_of,
    matrix_of,
    quaternion_of,
    unlimited,
    unlimited_all,
)
from gymnasium.utils.env_checker import check_env

NAME = "ambf/PegLift-v0"


def setUpModule():
    """Bounds of positions are infinite."""
    warnings.filterwarnings("ignore", message=".*infinity.*")


class Scene(unittest.TestCase):
    """What the task takes from the scene."""

    def test_arms_stand_where_the_kinematics_take_them_to_be(self):
        """Both of them, and the tool is where forward kinematics say."""
        folder = resources() / "peg_transfer"
        sim = ambf.Simulation(launch_file=folder / "launch.yaml", indexes=[2, 4])
        for arm in BASES:
            origin, axes = base(arm)
            pose = sim.body(f"{arm}/baselink").pose
            np.testing.assert_allclose(pose[:3], origin, atol=1e-9)
            np.testing.assert_allclose(matrix_of(pose[3:]), axes, atol=1e-9)

    def test_inverse_kinematics_of_many_are_those_of_each(self):
        """Of places all over the ranges of the joints."""
        rng = np.random.default_rng(0)
        joints = rng.uniform(np.maximum(LOWER, (-2, -2, 0.05, -3, -2, -2)), UPPER, (200, 6))
        positions, axes = map(np.array, zip(*(forward(q) for q in joints)))
        found = unlimited_all(positions, axes)
        np.testing.assert_allclose(found, [unlimited(*place) for place in zip(positions, axes)], atol=1e-12)
        quaternions = np.array([quaternion_of(one) for one in axes])
        np.testing.assert_allclose(matrices_of(quaternions), axes, atol=1e-12)


class Stage(unittest.TestCase):
    """The environment."""

    def test_it_is_one_of_gymnasiums(self):
        """Spaces, seeds, types; both rewards."""
        env = gymnasium.make(NAME, backend="process", max_episode_steps=20)
        check_env(env.unwrapped, skip_render_check=True)
        env.close()
        with self.assertRaises(InvalidDescription):
            gymnasium.make(NAME, backend="process", reward="dense")

    def test_the_scripted_solution_lifts_the_block(self):
        """In all worlds but few, and only where the referee says so; the sparse reward is 1 there."""
        count = 24
        worlds = Worlds(peg_lift.SCENE, peg_lift.task(shaped=False), count)
        worlds.reset(seeds=list(range(count)))
        players = [peg_lift.Player() for _ in range(count)]
        referees = [Referee() for _ in range(count)]
        rewards, lifted = np.zeros(count), np.zeros(count, bool)
        for _ in range(100):
            actions = [player.action(worlds.states[i]) for i, player in enumerate(players)]
            _, reward, terminated, _, infos = worlds.step(np.stack(actions))
            rewards += reward * ~lifted
            for i, referee in enumerate(referees):
                state = worlds.states[i]
                pose = {body: Pose(tuple(seen.position), tuple(seen.rotation)) for body, seen in state.bodies.items()}
                # The other block is not there.
                blocks = dict.fromkeys(SYMMETRIC.blocks, pose[peg_lift.BLOCK])
                score = referee.update(state.sim_time, blocks, {"psm1": pose[peg_lift.TOOL]})
                self.assertEqual(score.holders["block1"] == "psm1", bool(infos[i]["is_success"]), i)
            self.assertTrue(terminated[infos.columns["is_success"]].all())
            lifted |= infos.columns["is_success"]
            if lifted.all():
                break
        worlds.close()
        self.assertGreaterEqual(lifted.mean(), 0.95)
        np.testing.assert_array_equal(rewards, lifted)

    def test_worlds_do_what_one_does_alone(self):
        """Observations and rewards, to the bit."""
        worlds = Worlds(peg_lift.SCENE, peg_lift.TASK, 3)
        many = gymnasium.make_vec(NAME, num_envs=3, backend="process")
        alone = gymnasium.make(NAME, backend="process")
        seen = worlds.reset(seeds=[5, 6, 7])
        np.testing.assert_array_equal(many.reset(seed=5)[0], seen)
        np.testing.assert_array_equal(alone.reset(seed=6)[0], seen[1])
        rng = np.random.default_rng(0)
        for _ in range(10):
            actions = rng.uniform(-1, 1, (3, 7)).astype(np.float32)
            seen, rewards, *_ = worlds.step(actions)
            others, rewarded, *_ = many.step(actions)
            one, reward, *_ = alone.step(actions[1])
            np.testing.assert_array_equal(others, seen)
            np.testing.assert_array_equal(one, seen[1])
            np.testing.assert_array_equal(rewarded, rewards)
            self.assertEqual(reward, rewards[1])
        for env in (worlds, many, alone):
            env.close()

    def test_the_way_to_the_grip(self):
        """Nothing is left of it where the grip is; a step aside and a turn are told as they are."""
        env = gymnasium.make(NAME, backend="process")
        env.reset(seed=3)
        states = env.unwrapped.states
        grip = states.bodies[peg_lift.BLOCK]
        turn, aside = 0.1, np.array([0.002, -0.001, 0.004])
        to = peg_lift.to_grip(states)
        np.testing.assert_array_less(np.abs(to[:2]), peg_lift.ASIDE + 0.002)
        self.assertTrue(-0.022 < to[2] < -0.012, to)
        tool = states.bodies[peg_lift.TOOL]
        away = peg_lift.joints_to_grip(states)
        joints = states.bodies[peg_lift.BASE].joint_positions
        position, _ = forward([joints[name] + by for name, by in zip(peg_lift.JOINTS, away)])
        origin, axes = base("psm1")
        np.testing.assert_allclose(origin + axes @ position, tool.position + to[:3], atol=1e-5)
        wanted = matrix_of(tool.rotation) @ peg_lift._axes_of(to[3:])
        moved = Moved(grip, tool.position + to[:3] + aside, quaternion_of(wanted @ about(2, turn)))
        np.testing.assert_allclose(peg_lift.to_grip(moved), [*-aside, 0, 0, -turn], atol=1e-9)
        self.assertLess(peg_lift.worth(states), peg_lift.worth(moved))
        env.close()

    def test_the_tool_is_where_the_kinematics_say(self):
        """Errors of the joints are those of their drives."""
        env = gymnasium.make(NAME, backend="process")
        env.reset(seed=4)
        states = env.unwrapped.states
        joints = states.bodies[peg_lift.BASE].joint_positions
        origin, axes = base("psm1")
        position, turned = forward([joints[name] for name in peg_lift.JOINTS])
        np.testing.assert_allclose(states.bodies[peg_lift.TOOL].position, origin + axes @ position, atol=1e-5)
        np.testing.assert_allclose(matrix_of(states.bodies[peg_lift.TOOL].rotation), axes @ turned, atol=1e-4)
        env.close()


class Moved:
    """States in which the tool is elsewhere."""

    def __init__(self, held, position, rotation):
        joints = dict.fromkeys(peg_lift.FINGERS, peg_lift.READY)
        tool = type("Tool", (), {"position": position, "rotation": rotation})()
        base_state = type("Base", (), {"joint_positions": joints})()
        self.bodies = {peg_lift.BLOCK: held, peg_lift.TOOL: tool, peg_lift.BASE: base_state}


if __name__ == "__main__":
    unittest.main()
