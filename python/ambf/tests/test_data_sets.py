"""Recordings exported as data sets, read again by the libraries of those who use them; the mappings that are shipped."""

import contextlib
import io
import json
import math
import pathlib
import subprocess
import tempfile
import types
import unittest

import ambf
import numpy as np
from ambf import export, mapping

RESOURCES = pathlib.Path(__file__).resolve().parents[3] / "resources"
STEP = 0.005
ARMS = ("PSM1", "PSM2")


def run(*words):
    """`ambf_export`; what it says on both outputs, and its status."""
    said, complaint = io.StringIO(), io.StringIO()
    with contextlib.redirect_stderr(complaint):
        status = export.main([str(word) for word in words], said)
    return status, said.getvalue() + complaint.getvalue()


def can_draw(simulation):
    """Whether pictures can be drawn here."""
    try:
        simulation.render(None, 16, 16)
    except ambf.RenderError:
        return False
    return True


def probe(file):
    """What `ffprobe` says about the stream of a video, every frame of which it decodes."""
    words = ["-v", "error", "-count_frames", "-select_streams", "v:0", "-show_streams", "-of", "json"]
    done = subprocess.run(["ffprobe", *words, str(file)], check=True, capture_output=True, text=True)
    (stream,) = json.loads(done.stdout)["streams"]
    return stream


class Session:
    """Three recordings of two arms that are driven by their topics, and what these topics said meanwhile."""

    @classmethod
    def start(cls):
        """Makes them."""
        folder = tempfile.TemporaryDirectory()
        unittest.addModuleCleanup(folder.cleanup)
        cls.folder = pathlib.Path(folder.name)
        cls.files, cls.said = [], []
        scene = RESOURCES / "peg_transfer"
        options = {
            "launch_file": scene / "launch.yaml",
            "indexes": [0, 1, 2, 4],
            "crtk": [scene / "crtk_announced.yaml"],
        }
        for episode in range(3):
            file = cls.folder / f"{episode}.mcap"
            with ambf.Simulation(profile="accurate", step=STEP, **options) as sim:
                cls.draws = can_draw(sim)
                sim.record(file)
                sim.note(f"instruction: reach {episode}")
                cls.said.append(cls.drive(sim, episode))
                sim.stop_recording()
            cls.files.append(file)

    @staticmethod
    def drive(sim, episode):
        """0.3 s; by simulated time, 16 numbers that the topics of both arms say of where they are, and 16 of where they are to be."""
        arms = [sim.arm(name) for name in ARMS]
        said = {}
        for i in range(60):
            for sign, arm in zip((1.0, -1.0), arms):
                way = 0.1 * math.sin(0.02 * math.pi * i + episode) * sign
                arm.send("servo_jp", [0.5 * way, 0.3 * way, 0.12 + 0.2 * way, 2.0 * way, way, -way])
                arm.send("jaw/servo_jp", [0.2 + abs(way)])
            sim.step()
            numbers = []
            for poses, jaw in (("measured_cp", "jaw/measured_js"), ("setpoint_cp", "jaw/setpoint_js")):
                for arm in arms:
                    numbers += [*arm.cartesian(poses).value, *arm.joints(jaw).position]
            said[round(sim.sim_time, 6)] = np.array(numbers)
        return said


setUpModule = Session.start


class OpenH(unittest.TestCase):
    """The mapping `dvrk-open-h`."""

    def mapping_without_pictures(self):
        """The numbers alone."""
        import yaml

        text = yaml.safe_load((RESOURCES / "mappings/dvrk-open-h.yaml").read_text())
        del text["images"]
        file = Session.folder / "numbers.yaml"
        file.write_text(yaml.safe_dump(text, sort_keys=False))
        return file

    def test_numbers_are_those_of_the_topics(self):
        """State and action are what measured_cp, setpoint_cp and those of the jaws said at that time."""
        out = Session.folder / "numbers"
        status, said = run(Session.files[0], "--to", "csv", "--out", out, "--mapping", self.mapping_without_pictures())
        self.assertEqual(status, 0, said)
        head, *rows = (out / "episode_000000.csv").read_text().splitlines()
        names = head.split(",")[1:-1]
        self.assertEqual(len(names), 32)
        state = "observation.state/psm1_pose"
        self.assertEqual(names[:3], [f"{state}.position.{axis}" for axis in "xyz"])
        self.assertEqual(names[3:7], [f"{state}.orientation.{axis}" for axis in "xyzw"])
        self.assertEqual(
            names[7::8], [f"observation.state/psm{i}_jaw" for i in (1, 2)] + [f"action/psm{i}_jaw_sp" for i in (1, 2)]
        )
        compared = 0
        for row in rows[1:]:
            time, *numbers = row.split(",")[:-1]
            told = Session.said[0][round(float(time), 6)]
            for begin in range(0, 32, 8):
                found, expected = np.array(numbers[begin : begin + 8], np.float64), told[begin : begin + 8]
                what = f"{names[begin]} at {time} s"
                np.testing.assert_allclose(found[:3], expected[:3], atol=1e-7, err_msg=what)
                # A quaternion and its negative are one orientation.
                np.testing.assert_allclose(
                    found[3:7] * np.sign(found[3:7] @ expected[3:7]), expected[3:7], atol=1e-6, err_msg=what
                )
                self.assertAlmostEqual(found[7], expected[7], delta=1e-7, msg=what)
            compared += 1
        self.assertEqual(compared, 9)
        moved = np.ptp(np.array([list(map(float, row.split(",")[1:-1])) for row in rows]), axis=0)
        self.assertGreater(moved[[0, 8, 16, 24]].min(), 1e-3, "all of it moves")

    def test_what_the_validator_of_open_h_asks_for(self):
        """Its errors and its warnings, of which there are to be none."""
        import pyarrow.parquet

        if not Session.draws:
            self.skipTest("nothing can be drawn")
        out = Session.folder / "open-h"
        shares = "train=1,val=1,test=1"
        status, said = run(
            *Session.files, "--to", "lerobot-v2.1", "--out", out, "--mapping", "dvrk-open-h", "--splits", shares
        )
        self.assertEqual(status, 0, said)
        for name in ("info.json", "episodes_stats.jsonl", "tasks.jsonl", "episodes.jsonl", "README.md"):
            self.assertGreater((out / "meta" / name).stat().st_size, 0, name)
        text = (out / "meta/README.md").read_text().lower()
        self.assertTrue("synchron" in text and "timestamp" in text and "digital simulation" in text)
        info = json.loads((out / "meta/info.json").read_text())
        self.assertEqual((info["codebase_version"], info["robot_type"], info["fps"]), ("v2.1", "dvrk", 30))
        self.assertEqual(info["splits"], {"train": "0:1", "val": "1:2", "test": "2:3"})
        features = info["features"]
        for name in ("observation.state", "action"):
            self.assertEqual((features[name]["dtype"], features[name]["shape"]), ("float32", [16]))
        sizes = {"endoscope.left": [540, 960, 3], "endoscope.right": [540, 960, 3]}
        sizes.update({f"wrist.{side}": [480, 640, 3] for side in ("left", "right")})
        for name, shape in sizes.items():
            feature = features[f"observation.images.{name}"]
            self.assertEqual((feature["dtype"], feature["shape"]), ("video", shape))
        texts = {"instruction.text", "observation.meta.tool.psm1", "observation.meta.tool.psm2"}
        self.assertEqual({name for name in features if features[name]["dtype"] == "string"}, texts)
        lines = (out / "meta/episodes.jsonl").read_text().splitlines()
        self.assertTrue(all(json.loads(line)["tasks"] for line in lines) and len(lines) == len(Session.files))
        for index, line in enumerate(lines):
            length = json.loads(line)["length"]
            columns = pyarrow.parquet.read_table(out / f"data/chunk-000/episode_{index:06d}.parquet").to_pydict()
            self.assertEqual(set(columns), {name for name in features if features[name]["dtype"] != "video"})
            times = np.array(columns["timestamp"])
            self.assertEqual((len(times), len(np.unique(times)), times[0]), (length, length, 0.0))
            np.testing.assert_allclose(np.diff(times), 1 / 30, atol=1e-4)
            self.assertEqual(np.array(columns["action"]).shape, (length, 16))
            self.assertEqual(set(columns["instruction.text"]), {f"reach {index}"})
            for name, (height, width, _) in sizes.items():
                stream = probe(out / f"videos/chunk-000/observation.images.{name}/episode_{index:06d}.mp4")
                self.assertEqual((stream["width"], stream["height"]), (width, height))
                self.assertEqual((stream["codec_name"], stream["pix_fmt"]), ("h264", "yuv420p"))
                self.assertEqual((int(stream["nb_read_frames"]), stream["avg_frame_rate"]), (length, "30/1"))

    def test_cameras_of_the_data_set_see_the_jaws(self):
        """From both wrists, which have no camera in the scene: fingers are seen, at the same place in the picture however the arm is."""
        made = mapping.MappingOf.load("dvrk-open-h")
        with ambf.Recording(Session.files[0]) as recording:
            sim = recording.simulation
            if not Session.draws:
                self.skipTest("nothing can be drawn")
            for name, arm in (("wrist.left", "psm2"), ("wrist.right", "psm1")):
                picture = made.images[name]
                viewpoint = picture.viewpoint(name, sim)
                seen = []
                for time in (0.1, 0.25):
                    recording.seek(time)
                    sim = recording.simulation
                    options = {"pose": viewpoint(recording), "field_view_angle": picture.field_view_angle}
                    ids = sim.render(picture.camera, 160, 120, rgb=False, ids=True, **options)
                    fingers = [i for i, label in enumerate(sim.id_names) if f"{arm}/toolgripper" in label]
                    self.assertEqual(len(fingers), 2)
                    rows, columns = np.nonzero(np.isin(ids, fingers))
                    self.assertGreater(len(rows), 5, f"{name} at {time} s")
                    seen.append((rows.mean(), columns.mean()))
                np.testing.assert_allclose(seen[0], seen[1], atol=20.0)


class Forms(unittest.TestCase):
    """What the libraries of others read."""

    def export(self, form, *more):
        """Of all recordings, at 50 Hz; the folder."""
        out = Session.folder / form
        status, said = run(*Session.files, "--to", form, "--out", out, "--rate", 50, *more)
        self.assertEqual(status, 0, said)
        return out

    def truth(self):
        """Joint positions at the same times."""
        made = []
        for file in Session.files:
            with ambf.Recording(file) as recording:
                made.append(recording.arrays(("joint_positions",), 50)["joint_positions"])
        return made

    def test_robomimic(self):
        """By h5py, as robomimic reads it."""
        import h5py

        with h5py.File(self.export("robomimic", "--splits", "train=2,valid=1") / "data.hdf5") as file:
            data = file["data"]
            json.loads(data.attrs["env_args"])
            self.assertEqual(data.attrs["total"], sum(data[demo].attrs["num_samples"] for demo in data))
            masks = {name: [demo.decode() for demo in file["mask"][name]] for name in file["mask"]}
            self.assertEqual(masks, {"train": ["demo_0", "demo_1"], "valid": ["demo_2"]})
            for index, truth in enumerate(self.truth()):
                demo = data[f"demo_{index}"]
                count = demo.attrs["num_samples"]
                self.assertEqual(count, len(truth) - 1)
                np.testing.assert_array_equal(demo["obs/state"], truth[:-1])
                np.testing.assert_array_equal(demo["next_obs/state"], truth[1:])
                self.assertEqual(demo["actions"].shape, (count, truth.shape[1]))
                self.assertEqual((demo["dones"][-1], demo["dones"][:-1].sum()), (1, 0))

    def test_the_mcap_of_a_bag_and_a_recording_are_read_by_the_library_of_mcap(self):
        """All messages, with their schemas."""
        from mcap.reader import make_reader

        bag = next(self.export("rosbag2").glob("episode_000000/*.mcap"))
        with bag.open("rb") as file:
            topics = [channel.topic for _, channel, _ in make_reader(file, validate_crcs=True).iter_messages()]
        self.assertGreater(topics.count("/ambf/env/World/State"), 10)
        with Session.files[0].open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            names = {record.name for record in reader.iter_metadata()}
            texts = [message.data for _, channel, message in reader.iter_messages(["/ambf/notes"])]
        self.assertEqual(names, {"ambf.recording", "ambf.end"})
        self.assertEqual([json.loads(text)["text"] for text in texts], ["instruction: reach 0"])

    def test_lerobot_3(self):
        """By pyarrow: frames, episodes and tasks agree."""
        import pyarrow.parquet

        out = self.export("lerobot-v3.0")
        frames = pyarrow.parquet.read_table(out / "data/chunk-000/file-000.parquet").to_pydict()
        np.testing.assert_allclose(frames["observation.state"], np.concatenate(self.truth()), atol=1e-6)
        episodes = pyarrow.parquet.read_table(out / "meta/episodes/chunk-000/file-000.parquet").to_pydict()
        self.assertEqual(episodes["dataset_to_index"][-1], len(frames["index"]))
        self.assertEqual(sum(episodes["length"]), json.loads((out / "meta/info.json").read_text())["total_frames"])
        tasks = pyarrow.parquet.read_table(out / "meta/tasks.parquet")
        self.assertEqual(json.loads(tasks.schema.metadata[b"pandas"])["index_columns"], ["task"])


class Mappings(unittest.TestCase):
    """What a mapping may say."""

    def rows(self, text, name, *more):
        """Numbers of a feature, by a mapping of its entries."""
        file, out = Session.folder / f"{name}.yaml", Session.folder / name
        file.write_text(text)
        status, said = run(Session.files[0], "--to", "csv", "--out", out, "--mapping", file, *more)
        self.assertEqual(status, 0, said)
        rows = (out / "episode_000000.csv").read_text().splitlines()[1:]
        return np.array([list(map(float, row.split(",")[1:-1])) for row in rows])

    def test_several_joints_and_passive_bodies(self):
        """The mean of joints; bodies that have no topics; frames that are fixed to bodies."""
        joints = [f"psm1/toolyawlink-toolgripper{side}link" for side in ("left", "right")]
        entries = [*(f"{{from: joint position, of: {joint}}}" for joint in joints)]
        entries.append(f"{{from: joint position, of: [{', '.join(joints)}], offset: 1}}")
        entries.append("{from: position, of: psm1/toolrolllink, in: psm1/toolrolllink, offset: {position: [1, 2, 3]}}")
        rows = self.rows("features:\n  a:\n" + "".join(f"    - {entry}\n" for entry in entries), "several")
        np.testing.assert_allclose(rows[:, 2], rows[:, :2].mean(1) + 1.0)
        np.testing.assert_allclose(rows[:, 3:], np.tile([1.0, 2.0, 3.0], (len(rows), 1)), atol=1e-12)

    def test_names_are_looked_for_in_all_kinds_at_once(self):
        """The whole name of a passive body or of a camera is not taken for a part of another's."""
        scene = types.SimpleNamespace(bodies=["/a/tip_sensor", "/a/b"], passive_bodies=["/a/tip"], cameras=["/a/b_eye"])
        self.assertEqual(mapping._body(scene, "tip", ""), ("/a/tip", None))
        self.assertEqual(mapping._body(scene, "tip_sensor", ""), ("/a/tip_sensor", 0))
        scene.cameras = ["/a/sensor"]
        scene.camera_pose = lambda index: np.array([1.0 + index, 0, 0, 0, 0, 0, 1])
        seen = mapping._frame(scene, "", "sensor")(
            types.SimpleNamespace(simulation=scene), np.array([0, 0, 0, 0, 0, 0, 1.0])
        )
        np.testing.assert_allclose(seen[:3], [-1.0, 0.0, 0.0])

    def test_twists_in_a_frame(self):
        """They are turned into its axes."""
        entries = [f"{{from: twist, of: psm1/toolyawlink{more}}}" for more in ("", ", in: psm1/toolpitchlink")]
        entries.append("{from: orientation, of: psm1/toolpitchlink}")
        rows = self.rows("features:\n  a:\n" + "".join(f"    - {entry}\n" for entry in entries), "twists")
        self.assertGreater(np.ptp(rows[:, :6]), 1e-3)
        for row in rows:
            for half in (0, 3):
                turned = mapping._rotate(row[12:], row[6 + half : 9 + half])
                np.testing.assert_allclose(turned, row[half : half + 3], atol=1e-12)

    def test_notes_that_are_added(self):
        """They are as good as those of the recording: for numbers, and as the beginning."""
        text = "begin: late\nfeatures:\n  a:\n    - {from: note, of: goal, count: 2}\n"
        added = [("0.1", "late"), ("0.2", "goal: 3 4"), ("0.0", "goal: 1 2")]
        rows = self.rows(text, "noted", *(word for note in added for word in ("--note", *note)))
        self.assertEqual((list(rows[0]), list(rows[-1]), len(rows)), ([1.0, 2.0], [3.0, 4.0], 7))

    def test_cameras_look_where_they_are_told(self):
        """Along -x, right is +y, up is +z."""
        text = "{parent: a, location: {x: 1, y: 2, z: 3}, look at: {x: 1, y: 5, z: 3}, up: {x: 0, y: 1, z: 1}}"
        file = Session.folder / "camera.yaml"
        file.write_text(f"images: {{eye: {text}}}\n")
        offset = mapping.MappingOf.load(str(file)).images["eye"].offset
        np.testing.assert_allclose(offset[:3], (1, 2, 3))
        for axis, expected in (((-1, 0, 0), (0, 1, 0)), ((0, 1, 0), (1, 0, 0)), ((0, 0, 1), (0, 0, 1))):
            turned = mapping.compose(offset, np.array([*axis, 0, 0, 0, 1.0]))[:3] - offset[:3]
            np.testing.assert_allclose(turned, expected, atol=1e-12)

    def test_mistakes_are_named(self):
        """With the key, and what was expected."""
        joint = "{from: joint position, of: nowhere}"
        for text, part in (
            ("rate: -1", "`rate`: -1"),
            ("tasks: a", "unknown key `tasks`"),
            ("texts: {a: 1}", "`texts`"),
            ("images: {a: {width: 640}}", "or a parent: NAME"),
            ("images: {a: {camera: b, size: 3}}", "unknown key `size`"),
            ("images: {a: {camera: b, up: {x: 0, y: 0, z: 1}}}", "of a camera with a parent"),
            ("images: {a: {parent: b, look at: {x: 0, y: 0, z: 1}}}", "`up` across that direction"),
            ("images: {a: {parent: b, up: {x: 0, y: 0}}}", "`up`"),
            ("images: {a: {camera: b, field view angle: 4}}", "`field view angle`: 4"),
            ("images: {a: {parent: nobody}}", "`images / a`"),
            (f"features: {{a: [{joint}]}}", "nowhere"),
            ("features: {a: [{from: joint position, of: []}]}", "empty list"),
            ("features: {a: [{from: position, of: psm1/baselink, offset: 1}]}", "`offset`: 1"),
            ("features: {a: [{from: position, of: psm1/baselink, offset: {rpy: [0, 0]}}]}", "three numbers"),
            ("features: {a: [{from: joint position, of: a, count: 2}]}", "`from: joint position`: unknown key `count`"),
            ("features: {a: [{from: note, of: goal, in: world}]}", "`from: note`: unknown key `in`"),
            ("features: {a: [{from: twist, of: psm1/baselink, offset: {}}]}", "unknown key `offset`"),
            ("features: {a: [{from: speed, of: psm1/baselink}]}", "`from: speed` is not known"),
        ):
            with self.subTest(text):
                file = Session.folder / "wrong.yaml"
                file.write_text(text + "\n")
                out = Session.folder / "wrong"
                status, said = run(Session.files[0], "--to", "csv", "--out", out, "--mapping", file)
                self.assertEqual(status, 1)
                self.assertIn(part, said)
                self.assertFalse(out.exists())
        status, said = run(
            Session.files[0], "--to", "csv", "--out", Session.folder / "none", "--mapping", "dvrk-open-x"
        )
        self.assertEqual(status, 1)
        self.assertIn("dvrk-open-h", said)


if __name__ == "__main__":
    unittest.main()
