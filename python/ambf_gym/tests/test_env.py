"""Environments without a simulator: spaces, actions, episodes."""

import math
import pathlib
import tempfile
import unittest

import gymnasium
import numpy as np
from ambf_gym import InvalidAction, InvalidDescription, NotObserved, Pixels, Scene, SimulatorEnv, Task
from ambf_gym.backend import FORCE, POSITION, VELOCITY, BodyCommand, BodyState, Commands, SensorState, States, array
from ambf_gym.parts import (
    DriveBody,
    DriveJoints,
    Hold,
    Holds,
    JointEfforts,
    JointPositions,
    JointVelocities,
    Measurements,
    Position,
    Rotation,
    Twist,
)
from ambf_gym.scene import limits_in


class Toy:
    """A backend in which joints go where they are told, at once."""

    def __init__(self):
        self.sim_step = 100
        self.joints = {"a": 0.0, "b": 0.0}
        self.log = []
        self.fail = False
        self.opened = 0

    interval = 0.001

    def joint_limits(self):
        """Of one joint only."""
        return {"a": (-1.0, 2.0)}

    def open(self, bodies, sensors, actuators):
        """Says what is there."""
        self.opened += 1
        self.names = (bodies, sensors, actuators)
        return {body: ["a", "b"] for body in bodies}

    def step(self, commands, steps, reset=False):
        """Obeys."""
        if self.fail:
            raise ConnectionError("gone")
        if reset:
            self.joints = {"a": 0.5, "b": 0.0}
        self.log.append((commands, steps, reset))
        self.sim_step += steps
        for command in commands.bodies.values():
            self.joints.update({joint: value for joint, (kind, value) in command.joints.items() if kind == POSITION})
        zeros = {"a": 0.0, "b": 0.0}
        body = BodyState(
            array((1, 2, 3)),
            array((0, 0, 1, -1e-9)),
            array((4, 5, 6)),
            array((7, 8, 9)),
            self.joints.copy(),
            zeros,
            zeros,
        )
        other = BodyState(array((0, 0, 1)), array((0, 0, 0, 1)), array((0, 0, 0)), array((0, 0, 0)), {}, {}, {})
        sensors = {"eye": SensorState(array((0.25,)), ("a",))}
        return States(self.sim_step, 0.0, {"arm": body, "other": other}, sensors, {"hand": True})

    def render(self, camera, width, height, rgb, depth):
        """All pixels hold the number of the step."""
        shape = (height or 48, width or 64)
        picture = {"rgb": np.full((*shape, 3), self.sim_step % 256, dtype=np.uint8)} if rgb else {}
        if depth:
            picture["depth"] = np.full(shape, self.sim_step, dtype=np.float32)
        return picture

    def show(self):
        """Remembers it."""
        self.log.append("shown")

    def close(self):
        """Nothing to let go of."""


def task(act, observe=(JointPositions("arm", ("a", "b")),), **more):
    """A task that rewards the position of joint a; actions are in units."""
    more = {"scaled_actions": False, **more}
    return Task(observe, act, lambda t: t.after.bodies["arm"].joint_positions["a"], **more)


class Spaces(unittest.TestCase):
    """What bounds become."""

    def test_bounds_are_the_limits_of_joints(self):
        """Given ones go before them; without either it is an error."""
        joints = DriveJoints("arm", ("a", "b"), low=(-0.5, -3), high=None)
        with self.assertRaisesRegex(InvalidDescription, "a, b: give low and high"):
            SimulatorEnv(Toy(), task((joints,)))
        env = SimulatorEnv(Toy(), task((DriveJoints("arm", ("a",)), DriveBody("other", low=-2, high=2))))
        np.testing.assert_allclose(env.action_space.low, [-1, -2, -2, -2])
        np.testing.assert_allclose(env.action_space.high, [2, 2, 2, 2])
        np.testing.assert_allclose(env.observation_space.high, [2.3, np.inf], rtol=1e-6)
        for wrong in (
            lambda: DriveJoints("arm", ("a",), mode="torque"),
            lambda: DriveJoints("arm", ("a",), mode="effort", increment=1),
            lambda: DriveBody("arm", mode="wrench"),
            lambda: DriveBody("arm", mode="position", size=6),
            lambda: SimulatorEnv(Toy(), task((DriveBody("arm"),))),
            lambda: SimulatorEnv(Toy(), task((), n_skip_steps=0)),
        ):
            self.assertRaises(InvalidDescription, wrong)

    def test_all_observations(self):
        """Each part reads what it says; quaternions have one sign; missing rays are nothing."""
        observe = (
            JointPositions("arm", ("a",)),
            JointVelocities("arm", ("a",)),
            JointEfforts("arm", ("b",)),
            Position("arm"),
            Position("arm", relative_to="other"),
            Rotation("arm"),
            Twist("arm"),
            Measurements("eye", rays=2),
            Holds("hand"),
        )
        backend = Toy()
        env = SimulatorEnv(backend, task((), observe))
        observation, _ = env.reset(seed=0)
        expected = [0.5, 0, 0, 1, 2, 3, 1, 2, 2, 0, 0, -1, 1e-9, 4, 5, 6, 7, 8, 9, 0.25, 0, 1]
        np.testing.assert_allclose(observation, expected)
        self.assertEqual(observation.dtype, np.float32)
        self.assertEqual(backend.names, (("arm", "other"), ("eye",), ("hand",)))
        self.assertTrue(env.observation_space.contains(observation))

    def test_limits_in_files(self):
        """Of ADF and URDF; springs beside a joint do not count."""
        with tempfile.TemporaryDirectory() as folder:
            model = pathlib.Path(folder) / "m.yaml"
            model.write_text(
                "joints: [J 1, S 1, J 2]\n"
                "J 1: {name: left slide, joint limits: {low: -1, high: 2}}\n"
                "S 1: {name: spring, passive: true, joint limits: {low: -9, high: 9}}\n"
                "J 2: {name: free}\n"
            )
            self.assertEqual(limits_in(model), {"leftslide": (-1.0, 2.0)})
            robot = pathlib.Path(folder) / "m.urdf"
            robot.write_text(
                '<robot><joint name="j" type="revolute"><limit lower="-1.5" upper="0.5"/></joint>'
                '<joint name="k" type="continuous"/></robot>'
            )
            self.assertEqual(limits_in(robot), {"j": (-1.5, 0.5)})
            model.write_text("joints: [")
            self.assertRaises(InvalidDescription, limits_in, model)
        self.assertRaises(InvalidDescription, Scene(("/nothing.yaml",)).model_files)


class Pictures(unittest.TestCase):
    """What is rendered and observed of a backend that draws."""

    def test_render_modes(self):
        """Pictures when asked for, windows before the start."""
        backend = Toy()
        env = SimulatorEnv(backend, task(()), "rgb_array", width=5, height=4)
        self.assertRaises(gymnasium.error.ResetNeeded, env.render)
        env.reset(seed=0)
        picture = env.render()
        self.assertEqual((picture.shape, int(picture[0, 0, 0])), ((4, 5, 3), backend.sim_step))
        self.assertEqual(env.metadata["render_fps"], 100)
        self.assertEqual(SimulatorEnv(backend, task((), n_skip_steps=40), "rgb_array").metadata["render_fps"], 25)
        self.assertNotIn("shown", backend.log)
        human = SimulatorEnv(backend, task((), n_skip_steps=1), "human")
        self.assertEqual((backend.log[-1], human.metadata["render_fps"]), ("shown", 1000))
        human.reset(seed=0)
        self.assertIsNone(human.render())
        self.assertRaises(ValueError, SimulatorEnv, backend, task(()), "ansi")

    def test_pixels(self):
        """Of the step that was made; depths end at their limit."""
        backend = Toy()
        env = SimulatorEnv(backend, task(()), pixels=Pixels(width=5, height=4, depth=True, depth_limit=111))
        observation, _ = env.reset(seed=0)
        self.assertEqual(set(observation), {"state", "pixels", "pixels_depth"})
        self.assertTrue(env.observation_space.contains(observation))
        self.assertEqual(int(observation["pixels"][3, 4, 2]), backend.sim_step)
        later = env.step([])[0]
        self.assertEqual(int(later["pixels"][0, 0, 0]), backend.sim_step)
        self.assertEqual(float(later["pixels_depth"].max()), 111.0)
        self.assertRaises(InvalidDescription, SimulatorEnv, backend, task(()), pixels=(Pixels(), Pixels()))


class Actions(unittest.TestCase):
    """What actions become."""

    def test_positions_and_what_is_refused(self):
        """Clipped to the bounds; wrong shapes and NaN move nothing."""
        backend = Toy()
        env = SimulatorEnv(backend, task((DriveJoints("arm", ("a",)),), n_skip_steps=7))
        self.assertRaises(gymnasium.error.ResetNeeded, env.step, [0.0])
        env.reset(seed=0)
        observation, reward, terminated, truncated, info = env.step([5.0])
        self.assertEqual((observation[0], reward, terminated, truncated), (2.0, 2.0, False, False))
        self.assertEqual(info, {"iterations": 7, "clipped": True})
        calls = len(backend.log)
        for wrong in ([math.nan], [math.inf], [0.0, 0.0], 0.0, [[0.0]]):
            self.assertRaises(InvalidAction, env.step, wrong)
        self.assertEqual(len(backend.log), calls)
        self.assertFalse(env.step([0.25])[-1]["clipped"])

    def test_actions_are_scaled(self):
        """Unless the task says otherwise, -1 and 1 stand for the bounds."""
        backend = Toy()
        env = SimulatorEnv(backend, task((DriveJoints("arm", ("a",)),), scaled_actions=True))
        self.assertEqual((env.action_space.low.tolist(), env.action_space.high.tolist()), ([-1.0], [1.0]))
        env.reset(seed=0)
        for action, position, is_clipped in ((-1, -1, False), (1, 2, False), (0, 0.5, False), (7, 2, True)):
            observation, *_, info = env.step([action])
            self.assertEqual((observation[0], info["clipped"]), (position, is_clipped))
        self.assertTrue(Task((), (), lambda t: 0.0).scaled_actions)

    def test_increments(self):
        """They move a set point, which stays within the limits and starts anew."""
        env = SimulatorEnv(Toy(), task((DriveJoints("arm", ("a",), increment=0.4),)))
        np.testing.assert_allclose(env.action_space.high, [0.4])
        for _ in range(2):
            env.reset(seed=0)
            positions = [float(env.step([0.4])[0][0]) for _ in range(5)]
            np.testing.assert_allclose(positions, [0.9, 1.3, 1.7, 2.0, 2.0], rtol=1e-6)

    def test_two_environments_of_one_task(self):
        """They do not share set points."""
        shared = task((DriveJoints("arm", ("a",), increment=0.4),))
        one, two = SimulatorEnv(Toy(), shared), SimulatorEnv(Toy(), shared)
        one.reset(seed=0)
        two.reset(seed=0)
        one.step([0.4])
        np.testing.assert_allclose(two.step([0.1])[0][0], 0.6, rtol=1e-6)

    def test_other_commands(self):
        """Bodies by force and velocity, actuators, and commands that are always the same."""
        backend = Toy()

        def also(commands):
            commands.bodies.setdefault("arm", BodyCommand()).joints["b"] = (POSITION, 0.75)

        act = (
            DriveBody("arm", mode="velocity", low=-1, high=1, size=6),
            DriveBody("other", low=-1, high=1),
            DriveJoints("arm", ("a",), mode="effort", low=-9, high=9),
            Hold("hand", sensor="eye"),
        )
        env = SimulatorEnv(backend, task(act, also=also))
        env.reset(seed=0)
        rest: Commands = backend.log[-1][0]
        self.assertEqual(rest.bodies["arm"].joints, {"a": (FORCE, 0.0), "b": (POSITION, 0.75)})
        self.assertFalse(rest.actuators["hand"].hold)
        env.step([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0, 0, 1, 5, 0.5])
        commands: Commands = backend.log[-1][0]
        arm, other = commands.bodies["arm"], commands.bodies["other"]
        self.assertEqual((arm.kind, arm.linear, arm.angular), (VELOCITY, (0.1, 0.2, 0.3), (0.4, 0.5, 0.6)))
        self.assertEqual((other.kind, other.linear), (FORCE, (0.0, 0.0, 1.0)))
        self.assertEqual(arm.joints, {"a": (FORCE, 5.0), "b": (POSITION, 0.75)})
        self.assertTrue(commands.actuators["hand"].hold)


class Episodes(unittest.TestCase):
    """From reset to end."""

    def test_goals_come_from_the_seed(self):
        """And are observed."""
        env = SimulatorEnv(Toy(), task((), goal=lambda rng: rng.uniform(size=2), goal_size=2))
        first, again, other = (env.reset(seed=seed)[0][-2:] for seed in (1, 1, 2))
        np.testing.assert_array_equal(first, again)
        self.assertFalse((first == other).any())
        wrong = SimulatorEnv(Toy(), task((), goal=lambda _: np.zeros(3), goal_size=2))
        self.assertRaises(InvalidDescription, wrong.reset)

    def test_ends(self):
        """Truncated after so many steps, unless terminated."""
        env = SimulatorEnv(Toy(), task((), max_steps=3))
        env.reset(seed=0)
        self.assertEqual([env.step([])[2:4] for _ in range(3)], [(False, False), (False, False), (False, True)])
        env = SimulatorEnv(Toy(), task((), max_steps=3, terminated=lambda t: t.steps == 3))
        env.reset(seed=0)
        self.assertEqual([env.step([])[2:4] for _ in range(3)][-1], (True, False))

    def test_length_of_episodes(self):
        """As given where the environment is made."""
        env = SimulatorEnv(Toy(), task((), max_steps=3), max_episode_steps=2)
        env.reset(seed=0)
        self.assertEqual([env.step([])[3] for _ in range(2)], [False, True])
        self.assertRaises(ValueError, SimulatorEnv, Toy(), task(()), max_episode_steps=0)

    def test_states_at_the_start(self):
        """Drawn from the seed; where the backend cannot set them it is said."""

        class Settable(Toy):
            sets_states = True

            def step(self, commands, steps, reset=False, state=None):
                states = super().step(commands, steps, reset)
                self.log[-1] = (*self.log[-1], state)
                return states

        def start(rng):
            return {"joint_positions": {"a": rng.uniform()}}

        drawn = []
        for seed in (1, 1, 2):
            backend = Settable()
            SimulatorEnv(backend, task((DriveJoints("arm", ("a",)),), start=start)).reset(seed=seed)
            self.assertEqual([entry[2] for entry in backend.log], [True, True, False])
            self.assertIsNone(backend.log[-1][3])
            drawn.append(backend.log[1][3]["joint_positions"]["a"])
        self.assertTrue(drawn[0] == drawn[1] != drawn[2])
        with self.assertRaisesRegex(InvalidDescription, "in this process only"):
            SimulatorEnv(Toy(), task((), start=start)).reset()

    def test_resets(self):
        """One reset, then the time to settle; the physics is opened once, and again after a failure."""
        backend = Toy()
        env = SimulatorEnv(backend, task((DriveJoints("arm", ("a",)),), settle_steps=5))
        env.reset(seed=0)
        self.assertEqual([(steps, reset) for _, steps, reset in backend.log], [(1, True), (1, True), (4, False)])
        env.reset(seed=0)
        self.assertEqual(backend.opened, 1)
        backend.fail = True
        self.assertRaises(ConnectionError, env.step, [0.0])
        self.assertRaises(gymnasium.error.ResetNeeded, env.step, [0.0])
        backend.fail = False
        env.reset(seed=0)
        self.assertEqual(backend.opened, 2)
        self.assertRaises(ValueError, env.reset, options={"speed": 1})

    def test_names_that_are_not_there(self):
        """Joints are looked for when the scene is known; what is not observed is named, with what is."""

        def reward(transition):
            return transition.after.bodies["amr"].position[0]

        wrong = SimulatorEnv(Toy(), Task((JointPositions("arm", ("a",)),), (DriveJoints("arm", ("a",)),), reward))
        wrong.reset()
        with self.assertRaisesRegex(NotObserved, '"amr" is no body that the task names .*: there are arm'):
            wrong.step([0.0])
        env = SimulatorEnv(Toy(), task((), (JointPositions("arm", ("c",)),)))
        with self.assertRaisesRegex(InvalidDescription, '"c" is no joint of arm: there are a, b'):
            env.reset()
