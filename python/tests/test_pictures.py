"""Pictures of environments: rendering, observations of pixels, many worlds, over ROS the same."""

import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import textwrap
import unittest
import warnings

import ambf
import gymnasium
import harness
import numpy as np
import support
import yaml
from ambf_gym import (
    InProcessBackend,
    InProcessVectorEnv,
    InvalidDescription,
    Pixels,
    RosBackend,
    Scene,
    SimulatorEnv,
    SimulatorFailed,
)
from ambf_gym.tasks import lift, make_reach, reach
from display import Display
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

SMALL = Pixels(width=40, height=30, depth=True, depth_limit=20.0)
HERE = pathlib.Path(__file__).resolve().parent


def setUpModule():
    """Environments over ROS start this simulator."""
    os.environ["AMBF_SIMULATOR"] = str(harness.simulator_path())
    for name in ("ROS_MASTER_URI", "ROS_IP", "ROS_HOSTNAME"):
        os.environ.pop(name, None)
    warnings.filterwarnings("ignore", message=".*infinity.*")


def make_small(**options):
    """Reach with small pictures; a function, for processes that are spawned."""
    return make_reach(in_process=True, pixels=SMALL, **options)


def program(text, **environment):
    """Output of a program; its errors fail the test."""
    inside = {**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE), *sys.path]), **environment}
    command = [sys.executable, "-c", textwrap.dedent(text)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False, env=inside)
    if done.returncode:
        raise AssertionError(f"{done.stdout}\n{done.stderr}")
    return done.stdout


def act(env, count, seed=3):
    """Random actions; the last observation."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        observation, *_ = env.step(rng.uniform(env.action_space.low, env.action_space.high))
    return observation


def assert_equal(one, other):
    """Dicts of arrays that are equal to the last bit."""
    assert one.keys() == other.keys(), (one.keys(), other.keys())
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


class Environments(support.TimedTest):
    """One world."""

    def make(self, maker, *arguments, **options):
        """An environment that is closed at the end."""
        env = maker(*arguments, **options)
        self.addCleanup(env.close)
        return env

    def test_render(self):
        """What the camera sees now."""
        env = self.make(
            gymnasium.make, "ambf/Reach-v0", in_process=True, render_mode="rgb_array", width=160, height=120
        )
        self.assertEqual(env.metadata["render_fps"], 25, "40 iterations of 1 ms a step")
        self.assertRaises(gymnasium.error.ResetNeeded, env.unwrapped.render)
        env.reset(seed=0)
        first = env.render()
        self.assertEqual((first.shape, first.dtype), ((120, 160, 3), np.uint8))
        np.testing.assert_array_equal(env.render(), first)
        act(env, 10)
        self.assertFalse((env.render() == first).all())
        env.reset(seed=0)
        np.testing.assert_array_equal(env.render(), first)
        self.assertEqual(SimulatorEnv.metadata["render_fps"], 100, "that of the class stays")

    def test_cameras(self):
        """By name; others are told."""
        env = self.make(make_reach, in_process=True, render_mode="rgb_array", camera="main_camera")
        env.reset(seed=0)
        self.assertEqual(env.render().shape, (480, 640, 3))
        wrong = self.make(make_reach, in_process=True, render_mode="rgb_array", camera="side")
        wrong.reset(seed=0)
        with self.assertRaisesRegex(
            InvalidDescription, "no camera `side`; the scene has /ambf/env/cameras/main_camera"
        ):
            wrong.render()
        with self.assertRaisesRegex(ValueError, "ansi.*rgb_array"):
            make_reach(in_process=True, render_mode="ansi")
        silent = self.make(make_reach, in_process=True)
        silent.reset(seed=0)
        self.assertIsNone(silent.render())

    def test_pixels(self):
        """They are observed beside the state, which stays what it was."""
        env, plain = self.make(make_small), self.make(make_reach, in_process=True)
        spaces = env.observation_space
        self.assertEqual(set(spaces), {"state", "pixels", "pixels_depth"})
        self.assertEqual([spaces[name].shape for name in ("pixels", "pixels_depth")], [(30, 40, 3), (30, 40, 1)])
        observation, _ = env.reset(seed=5)
        state, _ = plain.reset(seed=5)
        self.assertTrue(spaces.contains(observation))
        np.testing.assert_array_equal(observation["state"], state)
        later, state = act(env, 8), act(plain, 8)
        np.testing.assert_array_equal(later["state"], state)
        self.assertFalse((later["pixels"] == observation["pixels"]).all())
        self.assertFalse((later["pixels_depth"] == observation["pixels_depth"]).all())
        self.assertLessEqual(float(later["pixels_depth"].max()), 20.0)
        sim = env._backend.simulation
        np.testing.assert_array_equal(later["pixels"], sim.render(width=40, height=30))
        again, _ = env.reset(seed=5)
        assert_equal(again, observation)

    def test_pixels_of_several_cameras(self):
        """Each under its name; a task without numbers has no state."""
        backend = InProcessBackend(reach.SCENE)
        views = (Pixels("main", 8, 6, name="a"), Pixels(None, 6, 4, rgb=False, depth=True, name="b"))
        env = self.make(SimulatorEnv, backend, reach.TASK, pixels=views)
        self.assertEqual(set(env.observation_space), {"state", "a", "b_depth"})
        observation, _ = env.reset(seed=0)
        self.assertEqual([observation[name].shape for name in ("a", "b_depth")], [(6, 8, 3), (4, 6, 1)])
        task = reach.Task((), reach.TASK.act, lambda step: 0.0)
        env = self.make(SimulatorEnv, InProcessBackend(reach.SCENE), task, pixels=Pixels(width=8, height=6))
        self.assertEqual(list(env.reset(seed=0)[0]), ["pixels"])
        for wrong in (
            (Pixels(), Pixels()),
            Pixels(rgb=False),
            Pixels(width=0),
            Pixels(name="state"),
            Pixels(depth=True, depth_limit=float("nan")),
        ):
            with self.subTest(wrong), self.assertRaises(InvalidDescription):
                SimulatorEnv(InProcessBackend(reach.SCENE), reach.TASK, pixels=wrong)

    def test_the_checker_of_gymnasium(self):
        """It finds nothing to complain of, with pictures in all ways."""
        for options in ({}, {"render_mode": "rgb_array"}, {"pixels": SMALL}):
            with self.subTest(options):
                env = self.make(gymnasium.make, "ambf/Reach-v0", in_process=True, **options)
                env.unwrapped.metadata = {**env.unwrapped.metadata, "render_modes": ["rgb_array"]}
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    warnings.filterwarnings("ignore", message=".*infinity.*")
                    check_env(env.unwrapped)

    def test_windows(self):
        """Mode "human" is checked on a display; without one it is told."""
        with self.assertRaisesRegex(ambf.RenderError, "no display"), unset("DISPLAY", "WAYLAND_DISPLAY"):
            self.make(make_reach, in_process=True, render_mode="human").reset(seed=0)
        text = """
            import gymnasium, time, ambf_gym
            env = gymnasium.make("ambf/Reach-v0", in_process=True, render_mode="human")
            env.reset(seed=0)
            sim = env.unwrapped._backend.simulation
            begin = time.monotonic()
            for _ in range(50):
                env.step(env.action_space.sample())
            # 50 steps of 40 ms are shown in real time.
            print(sim.view().is_open, 1.9 < time.monotonic() - begin < 20, env.render())
            env.close()
        """
        with Display() as name:
            self.assertEqual(program(text, DISPLAY=name).split(), ["True", "True", "None"])
            checked = """
                import gymnasium, ambf_gym, warnings
                from gymnasium.utils.env_checker import check_env
                env = gymnasium.make("ambf/Lift-v0", in_process=True)
                check_env(env.unwrapped)
                print("checked")
            """
            self.assertEqual(program(checked, DISPLAY=name).split(), ["checked"])


class Vectors(support.TimedTest):
    """Many worlds."""

    def test_in_this_process(self):
        """Observations and pictures of each world are what it would see alone."""
        view = {"pixels": SMALL, "render_mode": "rgb_array", "width": 64, "height": 48}
        env = InProcessVectorEnv(reach.SCENE, reach.TASK, 3, **view)
        self.addCleanup(env.close)
        singles = [make_reach(in_process=True, **view) for _ in range(3)]
        for single in singles:
            self.addCleanup(single.close)
        rng = np.random.default_rng(1)
        observations, _ = env.reset(seed=11)
        expected = [single.reset(seed=11 + i)[0] for i, single in enumerate(singles)]
        for _ in range(6):
            for i, one in enumerate(expected):
                assert_equal({name: values[i] for name, values in observations.items()}, one)
            for picture, single in zip(env.render(), singles):
                self.assertEqual(picture.shape, (48, 64, 3))
                np.testing.assert_array_equal(picture, single.render())
            actions = rng.uniform(env.action_space.low, env.action_space.high).astype(np.float32)
            observations = env.step(actions)[0]
            expected = [single.step(action)[0] for single, action in zip(singles, actions)]
        with self.assertRaisesRegex(ValueError, "human"):
            InProcessVectorEnv(reach.SCENE, reach.TASK, 2, render_mode="human")

    def test_episodes_that_end(self):
        """Autoreset observes the first picture of the next episode."""
        env = InProcessVectorEnv(lift.SCENE, lift.TASK, 2, pixels=Pixels(width=16, height=12))
        self.addCleanup(env.close)
        first, _ = env.reset(seed=0)
        down = np.zeros(env.action_space.shape, dtype=np.float32)
        down[:, 0] = env.action_space.high[:, 0]
        ended = np.zeros(2, dtype=bool)
        for _ in range(250):
            observation, _, terminated, truncated, _ = env.step(down)
            if ended.all():
                break
            ended = terminated | truncated
        self.assertTrue(ended.all())
        self.assertEqual(observation["pixels"].shape, first["pixels"].shape)
        np.testing.assert_array_equal(observation["pixels"], first["pixels"])

    def test_sync(self):
        """Gymnasium's own, by `make_vec`."""
        options = {"in_process": True, "render_mode": "rgb_array", "width": 32, "height": 24, "pixels": SMALL}
        env = gymnasium.make_vec("ambf/Reach-v0", 2, vectorization_mode="sync", **options)
        self.addCleanup(env.close)
        self.assertIsInstance(env, SyncVectorEnv)
        observation, _ = env.reset(seed=4)
        self.assertEqual(observation["pixels"].shape, (2, 30, 40, 3))
        self.assertEqual([picture.shape for picture in env.render()], [(24, 32, 3)] * 2)
        own = gymnasium.make_vec("ambf/Reach-v0", 2, pixels=SMALL)
        self.addCleanup(own.close)
        self.assertIsInstance(own, InProcessVectorEnv)
        assert_equal(own.reset(seed=4)[0], observation)

    def test_async(self):
        """Processes draw for themselves: forked ones if this one has not drawn, else spawned ones."""
        expected, _ = make_small().reset(seed=7)
        for way in ("spawn", "forkserver"):
            env = AsyncVectorEnv([make_small] * 2, context=way)
            try:
                found, _ = env.reset(seed=7)
                assert_equal({name: values[0] for name, values in found.items()}, expected)
            finally:
                env.close()
        text = """
            import warnings
            warnings.filterwarnings("ignore")
            from gymnasium.vector import AsyncVectorEnv
            from test_pictures import make_small
            env = AsyncVectorEnv([make_small] * 2, context="fork")
            print(env.reset(seed=7)[0]["pixels"].shape)
            env.close()
            one = make_small()
            one.reset(seed=7)
            env = AsyncVectorEnv([make_small] * 2, context="fork")
            try:
                env.reset(seed=7)
            except Exception as error:
                print("spawn" in str(error))
        """
        self.assertEqual(program(text).splitlines()[:2], ["(2, 30, 40, 3)", "True"])


class OverRos(support.TimedTest):
    """Cameras that publish."""

    def scene(self):
        """The arm, seen by a camera that publishes pictures and depths of 160 x 120 pixels."""
        folder = pathlib.Path(tempfile.mkdtemp())
        self.addCleanup(shutil.rmtree, folder)
        resources = support.RESOURCES
        world = yaml.safe_load((resources / "world/world.yaml").read_text())
        size = {"width": 160, "height": 120}
        world["main_camera"].update({"publish image": True, "publish image resolution": size})
        world["main_camera"].update(
            {"publish depth": True, "publish depth resolution": size, "publish depth interval": 1}
        )
        world["environment"] = str(resources / "world/ground.yaml")
        (folder / "world.yaml").write_text(yaml.safe_dump(world))
        launch = {"world config": "world.yaml", "multibody configs": [str(resources / "models/arm7.yaml")]}
        launch["color config"] = str(resources / "colors.yaml")
        launch["input devices config"] = str(resources / "input_devices.yaml")
        (folder / "launch.yaml").write_text(yaml.safe_dump(launch))
        return Scene(reach.SCENE.models, str(folder / "launch.yaml"), reach.SCENE.options)

    def test_the_same_as_in_the_process(self):
        """To the last bit: the picture of the very step that was made."""
        scene = self.scene()
        options = {"render_mode": "rgb_array", "pixels": Pixels(width=160, height=120, depth=True)}
        envs = [
            SimulatorEnv(backend, reach.TASK, **options) for backend in (RosBackend(scene), InProcessBackend(scene))
        ]
        for env in envs:
            self.addCleanup(env.close)
        observations = [env.reset(seed=2)[0] for env in envs]
        for count in range(4):
            assert_equal(*observations)
            np.testing.assert_array_equal(*[env.render() for env in envs])
            observations = [act(env, 3, seed=count) for env in envs]

    def test_what_is_not_published(self):
        """Is told, with what to do."""
        env = make_reach("ros", "rgb_array")
        self.addCleanup(env.close)
        env.reset(seed=0)
        with self.assertRaisesRegex(InvalidDescription, "publish image: true"):
            env.render()
        env = SimulatorEnv(RosBackend(self.scene()), reach.TASK, "rgb_array", width=320, height=240)
        self.addCleanup(env.close)
        env.reset(seed=0)
        with self.assertRaisesRegex(InvalidDescription, "160x120; 320x240 is asked for"):
            env.render()
        env = SimulatorEnv(RosBackend(self.scene()), reach.TASK, "rgb_array", camera="side")
        self.addCleanup(env.close)
        env.reset(seed=0)
        with self.assertRaisesRegex(InvalidDescription, '"side" names none.*main_camera'):
            env.render()
        with self.assertRaisesRegex(InvalidDescription, "attached"):
            make_reach(RosBackend(reach.SCENE, attach=""), "human")
        with unset("DISPLAY", "WAYLAND_DISPLAY"), self.assertRaisesRegex(SimulatorFailed, "display"):
            make_reach(RosBackend(reach.SCENE, timeout=10.0), "human").reset(seed=0)


class unset:
    """Without these variables of the environment."""

    def __init__(self, *names):
        self.names = names

    def __enter__(self):
        self.before = {name: os.environ.pop(name) for name in self.names if name in os.environ}

    def __exit__(self, *_):
        os.environ.update(self.before)


if __name__ == "__main__":
    unittest.main()
