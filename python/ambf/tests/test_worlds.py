"""Many worlds in this process: stepped at once, and what they share."""

import gc
import os
import pathlib
import subprocess
import sys
import tempfile
import textwrap
import time
import unittest

import ambf
import numpy as np
from ambf import _ambf

RESOURCES = pathlib.Path(__file__).resolve().parents[3] / "resources"
LAUNCH = RESOURCES / "launch.yaml"
ARM = RESOURCES / "models/arm7.yaml"


def arms(count, **options):
    """Arms of seven joints that move, each in its own way."""
    made = []
    for i in range(count):
        sim = ambf.Simulation(ARM, launch_file=LAUNCH, **{"profile": "accurate", **options})
        base = sim.body("arm7/base")
        base.joint_kinds[:], base.joint_commands[:] = ambf.POSITION, 0.05 * (i + 1)
        made.append(sim)
    return made


def look(sim):
    """All states, as bytes."""
    arrays = (sim.poses, sim.twists, sim.joint_positions, sim.joint_velocities, sim.joint_efforts)
    return b"".join(array.tobytes() for array in arrays) + repr((sim.sim_step, sim.sim_time)).encode()


class Together(unittest.TestCase):
    """Stepping at once."""

    def test_more_worlds_than_cores(self):
        """Bit for bit what they are in turn, in many short calls: threads are tried, and left alone where they do not pay."""
        count = 3 * (os.cpu_count() or 1) + 1
        for steps, calls in ((1, 300), (7, 20)):
            together, in_turn = arms(count), arms(count)
            for _ in range(calls):
                ambf.step_all(together, steps)
                for sim in in_turn:
                    sim.step(steps)
            self.assertEqual([look(sim) for sim in together], [look(sim) for sim in in_turn])

    def test_while_others_hold_all_cores(self):
        """The calls come to their end, and nothing else comes out."""
        loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2 * (os.cpu_count() or 1))]
        try:
            together, in_turn = arms(4), arms(4)
            for _ in range(300):
                ambf.step_all(together)
            for sim in in_turn:
                for _ in range(300):
                    sim.step()
            self.assertEqual([look(sim) for sim in together], [look(sim) for sim in in_turn])
        finally:
            for loop in loops:
                loop.kill()
                loop.wait()

    def test_an_error_in_one_world(self):
        """The others are stepped, call after call; the index says which it is."""
        sims = arms(5)
        flange = sims[3].body("arm7/flange")
        flange.kind = ambf.FORCE
        flange.wrench[:3] = 1e300
        for _ in range(3):
            with self.assertRaises(ambf.NonFiniteError) as caught:
                ambf.step_all(sims, 50)
            self.assertEqual(caught.exception.index, 3)
        self.assertEqual([sim.sim_step for sim in sims if sim is not sims[3]], [150] * 4)
        flange.kind = ambf.NONE
        sims[3].reset()
        ambf.step_all(sims, 2)
        self.assertEqual(sims[0].sim_step, 152)

    def test_one_world(self):
        """Does what it does alone, tells its errors, and starts no thread."""
        (sim,), (alone,) = arms(1), arms(1)
        for steps in (1, 7, [3], 0):
            ambf.step_all([sim], steps)
            alone.step(steps[0] if isinstance(steps, list) else steps)
            self.assertEqual(look(sim), look(alone))
        flange = sim.body("arm7/flange")
        flange.kind = ambf.FORCE
        flange.wrench[:3] = 1e300
        with self.assertRaises(ambf.NonFiniteError) as caught:
            ambf.step_all([sim], 50)
        self.assertEqual(caught.exception.index, 0)
        sim.close()
        with self.assertRaises(ambf.ClosedError):
            ambf.step_all([sim])
        program = textwrap.dedent(f"""\
            import ambf, pathlib
            sim = ambf.Simulation({str(ARM)!r}, launch_file={str(LAUNCH)!r})
            ambf.step_all([sim], 5)
            names = [task.read_text() for task in pathlib.Path("/proc/self/task").glob("*/comm")]
            assert sim.sim_step == 5 and not any("ambf-step" in name for name in names), names
            """)
        subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


class Shared(unittest.TestCase):
    """What worlds of the same files have in common."""

    def setUp(self):
        gc.collect()
        self.before = _ambf.shared_shapes()
        self.descriptions = _ambf.shared_descriptions()
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.write("stone", 0.1)
        self.write("ground", 1.0)
        self.model = self.folder / "scene.yaml"
        self.model.write_text(
            textwrap.dedent("""\
                bodies: [BODY stone, BODY ground]
                high resolution path: ./
                low resolution path: ./
                BODY stone: {name: stone, mass: 1, mesh: stone.obj, collision mesh type: CONVEX_HULL,
                  inertial offset: {position: {x: 0, y: 0, z: 0}}, inertia: {ix: 0.01, iy: 0.01, iz: 0.01},
                  location: {position: {x: 0, y: 0, z: 1.5}}}
                BODY ground: {name: ground, mass: 0, mesh: ground.obj, collision mesh type: CONCAVE_MESH,
                  inertial offset: {position: {x: 0, y: 0, z: 0}}}
                """)
        )

    def write(self, name, half):
        """A cube."""
        corners = [(x, y, z) for x in (-half, half) for y in (-half, half) for z in (-half, half)]
        faces = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"]
        lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {face}" for face in faces]
        (self.folder / name).with_suffix(".obj").write_text("\n".join(lines) + "\n")

    def load(self):
        """A world."""
        return ambf.Simulation(self.model, profile="accurate")

    def first(self):
        """A world whose shapes are shared: that of files which were written just now are not."""
        end = time.monotonic() + 30.0
        while True:
            sim = self.load()
            if _ambf.shared_shapes() == self.before + 2:
                return sim
            self.assertLess(time.monotonic(), end, "the files stay too young")
            sim.close()
            time.sleep(0.02)

    @staticmethod
    def rest(sim):
        """Height of the stone on the ground, m."""
        sim.step(2000)
        return sim.body("stone").pose[2]

    def test_many_worlds_have_one_shape(self):
        """Until the last one is gone; they do what worlds of their own do, in all threads."""
        alone = self.load()
        worlds = [self.first(), *(self.load() for _ in range(5))]
        self.assertEqual(_ambf.shared_shapes(), self.before + 2)
        self.assertEqual(_ambf.shared_descriptions(), self.descriptions + 1)
        ambf.Simulation(self.model, profile="accurate", launch_file=LAUNCH).close()
        self.assertEqual(_ambf.shared_descriptions(), self.descriptions + 1)
        for _ in range(40):
            ambf.step_all(worlds, 25)
        alone.step(1000)
        self.assertEqual({look(world) for world in worlds}, {look(alone)})
        np.testing.assert_allclose(worlds[0].body("stone").pose[2], 1.1, atol=0.01)
        while worlds:
            self.assertEqual(_ambf.shared_shapes(), self.before + 2)
            worlds.pop().close()
        self.assertEqual(_ambf.shared_shapes(), self.before)
        self.assertEqual(_ambf.shared_descriptions(), self.descriptions)

    def test_a_model_that_has_changed(self):
        """Is read anew, by `Simulation` as by a learner that makes one world more."""
        old = self.first()
        self.model.write_text(self.model.read_text().replace("z: 1.5", "z: 1.7"))
        new = self.load()
        self.assertEqual([sim.body("stone").pose[2] > 1.6 for sim in (old, new)], [False, True])

    def test_a_mesh_that_has_changed(self):
        """Is read anew; the worlds that are there stay what they are."""
        old = self.first()
        self.write("stone", 0.2)
        new = self.load()
        np.testing.assert_allclose([self.rest(old), self.rest(new)], [1.1, 1.2], atol=0.01)

    def test_a_mesh_that_is_gone(self):
        """Is missing, though another world has it."""
        old = self.first()
        (self.folder / "stone.obj").unlink()
        new = self.load()
        self.assertTrue(any("stone" in warning for warning in new.warnings), new.warnings)
        self.assertEqual(len(new.bodies), 1)
        np.testing.assert_allclose(self.rest(old), 1.1, atol=0.01)


if __name__ == "__main__":
    unittest.main()
