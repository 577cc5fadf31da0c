"""Environments in this process: the same as over ROS, to the last bit."""

import os
import subprocess
import sys
import unittest
import warnings

import ambf
import gymnasium
import harness
import numpy as np
import support
from ambf_gym import InProcessBackend, InProcessVectorEnv, InvalidAction, InvalidDescription, Scene, SimulatorEnv, Task
from ambf_gym.backend import BodyCommand, Commands
from ambf_gym.errors import SimulatorFailed, StepMismatch
from ambf_gym.parts import DriveBody, DriveJoints, JointPositions, Position
from ambf_gym.tasks import lift, make_lift, make_reach, reach
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv
from lift_by_hand import Hand

MAKERS = (make_reach, make_lift)


def setUpModule():
    """Environments over ROS start this simulator."""
    os.environ["AMBF_SIMULATOR"] = str(harness.simulator_path())
    for name in ("ROS_MASTER_URI", "ROS_IP", "ROS_HOSTNAME"):
        os.environ.pop(name, None)
    warnings.filterwarnings("ignore", message=".*infinity.*")


def roll_out(env, seed, steps=75, episodes=3):
    """All that an environment returns, and all states behind it, one entry a call."""
    seen = []
    actions = np.random.default_rng(seed)
    for episode in range(episodes):
        observation, info = env.reset(seed=seed + episode)
        seen.append((observation.tobytes(), repr(info), repr(env.states)))
        for _ in range(steps):
            action = actions.uniform(env.action_space.low, env.action_space.high)
            observation, *outcome = env.step(action)
            seen.append((observation.tobytes(), repr(outcome), repr(env.states)))
    return seen


class Environments(support.TimedTest):
    """One world."""

    def make(self, maker, *arguments, **options):
        """An environment that is closed at the end."""
        env = maker(*arguments, **options)
        self.addCleanup(env.close)
        return env

    def assert_same(self, found, expected):
        """Says where two roll-outs part."""
        for i, (one, other) in enumerate(zip(found, expected)):
            self.assertEqual(one, other, f"call {i}")
        self.assertEqual(len(found), len(expected))

    def test_the_checker_of_gymnasium(self):
        """It finds nothing to complain of."""
        for name in ("Reach", "Lift"):
            with self.subTest(name):
                env = self.make(gymnasium.make, f"ambf/{name}-v0", in_process=True)
                check_env(env.unwrapped, skip_render_check=True)

    def test_trajectories_repeat_to_the_bit(self):
        """In worlds that were loaded afresh, and after a reset."""
        for maker in MAKERS:
            first, second = self.make(maker, in_process=True), self.make(maker, in_process=True)
            found = roll_out(first, 5)
            self.assert_same(found, roll_out(second, 5))
            self.assertNotEqual([seen[0] for seen in found], [seen[0] for seen in roll_out(second, 6)])
            observed = [seen[0] for seen in found]
            self.assertEqual(observed, [seen[0] for seen in roll_out(first, 5)], "a reset leaves nothing of before")

    def test_the_same_as_over_ros(self):
        """Observations, rewards, ends and all states of both tasks over 225 steps in 3 episodes."""
        for maker in MAKERS:
            with self.subTest(maker.__name__):
                here, there = self.make(maker, in_process=True), self.make(maker, "ros")
                self.assert_same(roll_out(here, 11), roll_out(there, 11))

    def test_the_same_as_over_ros_in_profile_legacy(self):
        """Bodies pushed and moved, joints by effort and velocity."""
        act = (
            DriveJoints(reach.BASE, ("roll", "wrist"), mode="effort", low=-2, high=2),
            DriveBody(reach.FLANGE, low=-3, high=3, size=6),
        )
        observe = (JointPositions(reach.BASE, reach.JOINTS), Position(reach.FLANGE))

        def also(commands):
            commands.bodies.setdefault(reach.BASE, BodyCommand()).joints["elbow"] = (2, 0.1)

        task = Task(observe, act, lambda step: step.after.bodies[reach.FLANGE].position[2], also=also)
        scene = Scene(reach.SCENE.models, options=("--profile=legacy", "--solver", "si", "-p", "500"))
        from ambf_gym import RosBackend

        here, there = (self.make(SimulatorEnv, backend(scene), task) for backend in (InProcessBackend, RosBackend))
        self.assert_same(roll_out(here, 2, episodes=1), roll_out(there, 2, episodes=1))

    def test_one_environment_and_several_take_the_same_options(self):
        """In this process unless ROS is asked for; the first world of several is the one alone."""
        for options in ({}, {"in_process": True}, {"backend": "process"}, {"in_process": False}):
            with self.subTest(options):
                one = self.make(gymnasium.make, "ambf/Reach-v0", **options)
                several = self.make(
                    gymnasium.make_vec, "ambf/Reach-v0", 2, vectorization_mode="vector_entry_point", **options
                )
                is_here = isinstance(one.unwrapped._backend, InProcessBackend)
                self.assertEqual(is_here, options.get("in_process", True))
                self.assertEqual(isinstance(several.unwrapped, InProcessVectorEnv), is_here)
                np.testing.assert_array_equal(one.reset(seed=3)[0], several.reset(seed=3)[0][0])

    def test_places_are_what_parts_read(self):
        """Observations, commands and all states, with the places that are found once and without, of both tasks."""
        for maker in MAKERS:
            found, expected = self.make(maker, in_process=True), self.make(maker, in_process=True)
            found.reset(seed=0)
            expected.reset(seed=0)
            self.assertIsNotNone(found._gather)
            self.assertIsNotNone(found._writers)
            expected._gather = expected._writers = None
            self.assert_same(roll_out(found, 4), roll_out(expected, 4))

    def test_states_at_the_start(self):
        """They are where the episode begins, and drives keep them."""

        def start(rng):
            return {"joint_positions": {"elbow": rng.uniform(0.2, 0.6)}}

        task = Task(**{**vars(reach.TASK), "start": start})
        env = self.make(SimulatorEnv, InProcessBackend(reach.SCENE), task)
        elbow = reach.JOINTS.index("elbow")
        drawn = [env.reset(seed=seed)[0][elbow] for seed in (1, 1, 2)]
        self.assertTrue(drawn[0] == drawn[1] != drawn[2])
        observation, *_ = env.step(np.zeros(7))
        self.assertTrue(min(drawn) > 0.19 and max(drawn) < 0.61)
        # The arm gives way to its weight.
        self.assertAlmostEqual(observation[elbow], drawn[2], delta=0.1)

    def test_integrators(self):
        """One argument, which means the option of the scene; what is made without is `rk4`."""

        def last(**options):
            env = self.make(gymnasium.make, "ambf/Reach-v0", **options)
            env.reset(seed=1)
            env.action_space.seed(2)
            for _ in range(10):
                observation, *_ = env.step(env.action_space.sample())
            return observation

        euler, rk4 = last(integrator="euler"), last(integrator="rk4")
        np.testing.assert_array_equal(rk4, last())
        np.testing.assert_array_equal(euler, last(backend="ros", integrator="euler"))
        self.assertTrue((euler != rk4).any())
        np.testing.assert_allclose(euler[:7], rk4[:7], atol=0.01)
        many = self.make(
            gymnasium.make_vec, "ambf/Reach-v0", 2, vectorization_mode="vector_entry_point", integrator="euler"
        )
        self.assertEqual([backend._options["integrator"] for backend in many.unwrapped._backends], ["euler"] * 2)
        scene = Scene(reach.SCENE.models, options=("--integrator", "rk4", "--profile", "accurate"))
        self.assertEqual(scene.integrated_by("euler").options, ("--profile", "accurate", "--integrator", "euler"))
        scene = Scene(reach.SCENE.models, options=("--integrator=ballistic",))
        self.assertEqual(scene.integrated_by("rk4").options, ("--integrator", "rk4"))
        self.assertIs(scene.integrated_by(None), scene)
        with self.assertRaisesRegex(InvalidDescription, "integrator='rk5': expected one of euler, ballistic, rk4"):
            make_reach(integrator="rk5")
        with self.assertRaisesRegex(InvalidDescription, "has one already"):
            make_reach(InProcessBackend(reach.SCENE), integrator="euler")

    def test_lifting_by_hand(self):
        """The policy of the task over ROS ends here too."""
        env = self.make(make_lift, in_process=True)
        hand = Hand()
        observation, _ = env.reset(seed=4)
        for _ in range(env._task.max_steps):
            observation, _, terminated, truncated, info = env.step(hand(observation))
            if terminated or truncated:
                break
        self.assertTrue(info["is_success"], info)

    def test_bad_input(self):
        """Everything is refused before anything moves, and the next reset starts afresh."""
        env = self.make(make_reach, in_process=True)
        self.assertRaises(gymnasium.error.ResetNeeded, env.step, np.zeros(7))
        env.reset(seed=0)
        before = env.states.sim_step
        for wrong in (np.zeros(6), np.full(7, np.nan), np.zeros((7, 1))):
            self.assertRaises(InvalidAction, env.step, wrong)
        env.step(np.zeros(7))
        self.assertEqual(env.states.sim_step, before + 40)
        env._backend.simulation.step(1)
        self.assertRaises(StepMismatch, env.step, np.zeros(7))
        self.assertRaises(gymnasium.error.ResetNeeded, env.step, np.zeros(7))
        env.reset(seed=0)
        env._backend.simulation.close()
        self.assertRaises(ambf.ClosedError, env.step, np.zeros(7))
        env.reset(seed=0)
        env.close()
        with self.assertRaises(SimulatorFailed):
            _ = env._backend.simulation
        for options in (
            ("--ns", "/a"),
            ("-n", "2"),
            ("-p", "0"),
            ("--phx_frequency", "fast"),
            ("--sleep=maybe",),
        ):
            with self.subTest(options), self.assertRaises(InvalidDescription):
                InProcessBackend(Scene(reach.SCENE.models, options=options))
        for options, message in (
            ({"in_process": True, "patience": 3}, 'patience: .* backend "ros" only'),
            ({"patience": 3}, 'backend "ros" only'),
            ({"in_process": True, "backend": "ros"}, "contradict"),
            ({"backend": "cloud"}, 'backend=.cloud.: expected "process", "ros" or a backend'),
        ):
            with self.subTest(options), self.assertRaisesRegex(InvalidDescription, message):
                make_reach(**options)
        slow = InProcessBackend(Scene(reach.SCENE.models, options=("-p", "0.1")))
        self.assertRaises(ambf.LoadError, slow.open, ("arm7/base",), (), ())
        backend = InProcessBackend(reach.SCENE)
        self.assertRaises(InvalidDescription, backend.open, ("nobody",), (), ())
        self.assertEqual(list(backend.open(("arm7/base",), (), ())["arm7/base"]), list(reach.JOINTS))
        for value in (1e39, float("nan")):
            with warnings.catch_warnings(), self.assertRaises(ambf.InvalidCommand):
                warnings.simplefilter("ignore")
                backend.step(Commands({"arm7/base": BodyCommand(joints={"yaw": (1, value)})}), 1)
        backend.close()
        backend.close()

    def test_no_ros_is_needed(self):
        """Neither rospy nor the client is imported."""
        text = (
            "import sys; sys.modules['rospy'] = sys.modules['ambf_client'] = None\n"
            "import gymnasium, ambf_gym\n"
            "env = gymnasium.make('ambf/Reach-v0', in_process=True); env.reset(seed=1); env.step(env.action_space.sample())\n"
            "many = gymnasium.make_vec('ambf/Lift-v0', 2); many.reset(seed=1); many.close(); print('done')\n"
        )
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", text], capture_output=True, text=True, timeout=60, check=False
        )
        self.assertEqual(done.stdout.strip(), "done", done.stderr)


class Vectors(unittest.TestCase):
    """Many worlds."""

    def pair(self, module, count, mode):
        """A vector environment, and one of Gymnasium whose environments take turns."""
        task = Task(**{**vars(module.TASK), "max_steps": 7})
        many = InProcessVectorEnv(module.SCENE, task, count, autoreset_mode=mode)
        turns = SyncVectorEnv([lambda: SimulatorEnv(InProcessBackend(module.SCENE), task)] * count, autoreset_mode=mode)
        self.addCleanup(many.close)
        self.addCleanup(turns.close)
        return many, turns

    def assert_equal(self, found, expected):
        """Arrays, and dictionaries of them."""
        self.assertEqual(len(found), len(expected))
        for one, other in zip(found, expected):
            if isinstance(one, dict):
                self.assertEqual(one.keys(), other.keys())
                self.assert_equal(list(one.values()), list(other.values()))
            elif isinstance(one, np.ndarray) and one.dtype == object:
                self.assert_equal(list(one), list(other))
            else:
                np.testing.assert_array_equal(one, other)

    def test_as_single_environments(self):
        """Number for number, in all modes of autoreset."""
        for module, mode in ((reach, "NextStep"), (lift, "NextStep"), (reach, "SameStep"), (lift, "SameStep")):
            with self.subTest(f"{module.__name__} {mode}"):
                many, turns = self.pair(module, 3, mode)
                self.assert_equal(many.reset(seed=5), turns.reset(seed=5))
                many.action_space.seed(1)
                for _ in range(20):
                    actions = many.action_space.sample()
                    self.assert_equal(many.step(actions), turns.step(actions))
                self.assert_equal(many.reset(seed=[1, None, 2][:1] * 3), turns.reset(seed=[1] * 3))

    def test_without_autoreset(self):
        """Those of the mask are reset."""
        many, turns = self.pair(reach, 3, "Disabled")
        self.assert_equal(many.reset(seed=5), turns.reset(seed=5))
        for _ in range(7):
            actions = many.action_space.sample()
            self.assert_equal(many.step(actions), turns.step(actions))
        mask = np.array([True, False, True])
        options = [{"reset_mask": mask.copy()} for _ in range(2)]
        self.assert_equal(many.reset(seed=3, options=options[0]), turns.reset(seed=3, options=options[1]))
        self.assertEqual(many.get_attr("states")[0].sim_step, turns.get_attr("states")[0].sim_step)
        for wrong in (np.ones(2, dtype=bool), np.zeros(3, dtype=bool), [True] * 3, np.ones(3)):
            with self.assertRaises((TypeError, ValueError)):
                many.reset(options={"reset_mask": wrong})

    def test_arrays_of_worlds_that_end_at_other_times(self):
        """Number for number, where some worlds begin again while others go on, and some are reset by hand."""

        def info(step):
            away = step.once(reach.distance)
            return {"distance": away, "is_near": away < 0.3, "way": step.after.bodies[reach.FLANGE].position}

        def ends(step):
            return step.once(reach.distance) < 0.25

        changed = {"max_steps": 7, "info": info, "terminated": ends, "settle_steps": 3}
        task = Task(**{**vars(reach.TASK), **changed})
        for mode in ("NextStep", "SameStep"):
            many = InProcessVectorEnv(reach.SCENE, task, 5, autoreset_mode=mode)
            turns = SyncVectorEnv([lambda: SimulatorEnv(InProcessBackend(reach.SCENE), task)] * 5, autoreset_mode=mode)
            self.addCleanup(many.close)
            self.addCleanup(turns.close)
            self.assert_equal(many.reset(seed=5), turns.reset(seed=5))
            many.action_space.seed(1)
            ended = set()
            for call in range(40):
                actions = 1.2 * many.action_space.sample()
                found, expected = many.step(actions), turns.step(actions)
                self.assert_equal(found, expected)
                self.assertEqual(list(found[4]), list(expected[4]))
                for key, column in expected[4].items():
                    self.assertEqual(
                        found[4][key].dtype if key != "final_info" else None, getattr(column, "dtype", None)
                    )
                ended.add(int((found[2] | found[3]).sum()))
                if call % 9 == 4:
                    # Looked at, and stepped past the vector.
                    states = [env.get_attr("states") for env in (many, turns)]
                    self.assertEqual(*(repr(each) for each in states))
                if call == 17:
                    self.assert_equal(many.envs[2].reset(seed=3), turns.envs[2].reset(seed=3))
                    self.assert_equal(many.envs[2].step(actions[2]), turns.envs[2].step(actions[2]))
            self.assertTrue(ended & {1, 2, 3, 4}, ended)
            self.assertIsNotNone(many._together)

    def test_which_tasks_are_stepped_as_arrays(self):
        """Those of arrays; not those with actuators, and not those with parts of their own."""

        class Own(Position):
            pass

        own = Task(**{**vars(reach.TASK), "observe": (Own(reach.FLANGE),)})
        for scene, task, expected in (
            (reach.SCENE, reach.TASK, True),
            (lift.SCENE, lift.TASK, False),
            (reach.SCENE, own, False),
        ):
            many = InProcessVectorEnv(scene, task, 2)
            self.addCleanup(many.close)
            many.reset(seed=1)
            many.step(many.action_space.sample())
            self.assertEqual(many._together is not None, expected)

    def test_bad_input(self):
        """A wrong action moves no world."""
        many = gymnasium.make_vec("ambf/Reach-v0", 2)
        self.addCleanup(many.close)
        self.assertRaises(gymnasium.error.ResetNeeded, many.step, np.zeros((2, 7)))
        many.reset(seed=1)
        wrong = np.zeros((2, 7))
        wrong[1, 3] = np.nan
        before = [states.sim_step for states in many.get_attr("states")]
        self.assertRaises(InvalidAction, many.step, wrong)
        self.assertEqual([states.sim_step for states in many.get_attr("states")], before)
        self.assertRaises(ValueError, many.reset, seed=[1])
        many.step(np.zeros((2, 7)))
        many._backends[1].simulation.close()
        self.assertRaises(ambf.ClosedError, many.step, np.zeros((2, 7)))
        many.reset(seed=1)
        many.step(np.zeros((2, 7)))
        self.assertRaises(ValueError, InProcessVectorEnv, reach.SCENE, reach.TASK, 0)


if __name__ == "__main__":
    unittest.main()
