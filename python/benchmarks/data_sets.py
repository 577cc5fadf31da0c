"""Data sets of recordings, loaded by LeRobot itself. `scripts/foreign-datasets` runs the parts of this with different interpreters:

data_sets.py make FOLDER             with `ambf`: records two arms in the peg-transfer scene and exports that; truth.npz has the numbers
data_sets.py read DATASET TRUTH      with `lerobot`: iterates over every frame, pictures too, and prints a line of JSON
data_sets.py page PAGE LINES…        writes the lines as a table between the markers of a page
"""

import json
import math
import platform
import sys
import time
from pathlib import Path

import numpy as np

EPISODES, SECONDS, RATE, STEP = 3, 2.0, 30.0, 0.005
MARKS = ("<!-- foreign: begin -->\n", "<!-- foreign: end -->\n")
FORMS = ("lerobot-v2.1", "lerobot-v3.0")


def record(file, episode):
    """Two arms that move by their topics."""
    import ambf

    scene = ambf.resources() / "peg_transfer"
    options = {"launch_file": scene / "launch.yaml", "indexes": [0, 1, 2, 4], "crtk": [scene / "crtk_announced.yaml"]}
    with ambf.Simulation(profile="accurate", step=STEP, **options) as sim:
        arms = [sim.arm(name) for name in ("PSM1", "PSM2")]
        sim.record(file)
        sim.note("instruction: reach")
        count = round(SECONDS / STEP)
        for i in range(count):
            for sign, arm in zip((1.0, -1.0), arms):
                way = 0.1 * math.sin(2.0 * math.pi * i / count + episode) * sign
                arm.send("servo_jp", [0.5 * way, 0.3 * way, 0.12 + 0.2 * way, 2.0 * way, way, -way])
                arm.send("jaw/servo_jp", [0.2 + abs(way)])
            if i == count // 2:
                sim.note("instruction: withdraw")
            sim.step()
        sim.stop_recording()


def make(folder):
    """Recordings, data sets of both versions of LeRobot, and the numbers that they are to hold."""
    from ambf import export
    from ambf.mapping import MappingOf

    folder.mkdir(parents=True)
    files = [folder / f"{episode}.mcap" for episode in range(EPISODES)]
    for episode, file in enumerate(files):
        record(file, episode)
    shares = {"train": 1.0, "val": 1.0, "test": 1.0}
    for form in FORMS:
        made = export.export(
            [str(file) for file in files], form, folder / form, mapping=MappingOf.load("dvrk-open-h"), splits=shares
        )
    features = {name: np.concatenate([episode.features[name] for episode in made]) for name in made[0].features}
    lengths = np.array([episode.length for episode in made])
    np.savez(folder / "truth.npz", lengths=lengths, **features)


def dataset_of(folder):
    """By the class of lerobot, from these files alone."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    return LeRobotDataset("ambf/peg_transfer", root=folder)


def read(folder, truth):
    """Every frame: numbers against the truth, pictures against the mean that the data set says they have."""
    import lerobot
    import torch

    known = np.load(truth)
    begin = time.perf_counter()
    dataset = dataset_of(folder)
    lengths = known["lengths"].tolist()
    assert (len(dataset), dataset.num_episodes) == (sum(lengths), len(lengths)), (len(dataset), lengths)
    texts, means, pictures = set(), {}, 0
    for index in range(len(dataset)):
        frame = dataset[index]
        for name in ("observation.state", "action"):
            np.testing.assert_allclose(frame[name].numpy(), known[name][index], atol=1e-6, err_msg=f"{name} of {index}")
        texts.add(frame["instruction.text"])
        for camera in dataset.meta.camera_keys:
            picture = frame[camera]
            height, width, _ = dataset.meta.features[camera]["shape"]
            assert tuple(picture.shape) == (3, height, width), (camera, picture.shape)
            assert picture.std() > 0.01, f"{camera} of {index} shows nothing"
            means.setdefault(camera, []).append(picture.mean(dim=(1, 2)).numpy())
            pictures += 1
    assert texts == {"reach", "withdraw"}, texts
    for camera, found in means.items():
        expected = np.asarray(dataset.meta.stats[camera]["mean"]).reshape(3)
        np.testing.assert_allclose(np.mean(found, axis=0), expected, atol=0.02, err_msg=camera)
    said = {
        "form": folder.name,
        "lerobot": lerobot.__version__,
        "torch": torch.__version__,
        "python": platform.python_version(),
        "episodes": dataset.num_episodes,
        "frames": len(dataset),
        "pictures": pictures,
        "seconds": round(time.perf_counter() - begin, 1),
    }
    print(json.dumps(said))


def page(file, lines):
    """A row a line, in place of those that were there."""
    rows = [json.loads(line) for line in lines]
    heading = list(rows[0])
    table = "".join(
        "| " + " | ".join(str(cell) for cell in cells) + " |\n"
        for cells in (
            heading,
            ["---" if name in ("form", "torch") else "--:" for name in heading],
            *map(dict.values, rows),
        )
    )
    text = file.read_text()
    before, rest = text.split(MARKS[0])
    file.write_text(before + MARKS[0] + table + MARKS[1] + rest.split(MARKS[1])[1])


if __name__ == "__main__":
    command, place, *more = sys.argv[1:]
    if command == "make":
        make(Path(place))
    elif command == "read":
        read(Path(place), Path(more[0]))
    else:
        page(Path(place), more)
