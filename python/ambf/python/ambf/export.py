"""Data sets of recordings: the program `ambf_export`.

A recording holds what entered a simulation; here it is replayed, and what a mapping asks for is written in a form that learning programs
read. Nothing has to be decided while it is recorded. The forms need `pyarrow` (lerobot), `h5py` (robomimic) or `rosbags` (rosbag1 and
rosbag2), mappings `PyYAML`, videos the program `ffmpeg`; PyTorch, ROS and LeRobot need not be there.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Callable, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple, Type

import numpy as np
from numpy.typing import NDArray

from . import bags
from .errors import AmbfError, ExportError
from .mapping import MappingOf, Note, Picture, shipped
from .recording import Recording
from .simulation import Array

FORMS = ("csv", "robomimic", "lerobot-v2.1", "lerobot-v3.0", "mp4", "rosbag1", "rosbag2")
"""What recordings can be exported to."""

_CHUNK = 1000
_CODECS = {"h264": ("libx264", ("-crf", "18")), "av1": ("libsvtav1", ("-crf", "30", "-preset", "12"))}


@dataclass
class Episode:
    """What was sampled of a recording."""

    file: str
    task: str
    split: str
    times: Array
    """(frames) simulated time since the beginning, s."""
    features: Dict[str, Array]
    """(frames x numbers) of each feature."""
    instructions: List[str]
    """(frames) the newest note that begins with `instruction:` or `stage:`; empty before the first."""
    videos: Dict[str, Path]
    picture_stats: Dict[str, Dict[str, List[Any]]]
    problem: Optional[str] = None
    """A sentence if the recording is not whole."""

    @property
    def length(self) -> int:
        """Frames."""
        return len(self.times)


class Video:
    """A video that `ffmpeg` makes of pictures."""

    def __init__(self, path: Path, picture: Picture, rate: float, codec: str) -> None:
        program = shutil.which("ffmpeg")
        if program is None:
            raise ExportError("videos need the program ffmpeg, which is not installed")
        encoder, quality = _CODECS[codec]
        path.parent.mkdir(parents=True, exist_ok=True)
        size = f"{picture.width}x{picture.height}"
        source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", repr(rate), "-i", "-"]
        # A key picture every second one: learning programs read single pictures.
        made = ["-c:v", encoder, *quality, "-g", "2", "-pix_fmt", "yuv420p", str(path)]
        self._path = path
        self._process = subprocess.Popen(
            [program, "-y", "-loglevel", "error", *source, *made], stdin=subprocess.PIPE, stderr=subprocess.PIPE
        )

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Adds (height x width x 3) red, green and blue."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(np.ascontiguousarray(picture).tobytes())
        except BrokenPipeError:
            self.finish()

    def finish(self) -> None:
        """Completes the file. Raises ExportError."""
        _, problem = self._process.communicate()
        if self._process.returncode != 0:
            raise ExportError(f"{self._path}: ffmpeg: {problem.decode(errors='replace').strip()}")

    def __enter__(self) -> Video:
        return self

    def __exit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        if kind is None:
            self.finish()
        else:
            self._process.kill()
            self._process.communicate()


def _notes(recording: Recording, more: Sequence[Note]) -> List[Note]:
    """Those of a recording and further ones, in order. The recording must be at its beginning. Raises ExportError."""
    begin = recording.simulation.sim_time
    for time, text in more:
        if not begin <= time <= recording.end:
            raise ExportError(f"note {text!r} at {time} s: {recording.path} goes from {begin} to {recording.end} s")
    # A simulation that is stepped from Python rests after its first update: what is noted there is of the beginning.
    first = begin + 1.5 * recording.interval
    noted = [(begin if time < first else time, text) for time, text in recording.notes]
    return sorted([*noted, *more], key=lambda note: note[0])


def sample(
    file: str, mapping: MappingOf, videos: Path, codec: str, *, changed_files: bool = False, notes: Sequence[Note] = ()
) -> Episode:
    """Replays a recording and samples it; videos are written into the folder. `notes`: beside those of the recording."""
    more = notes
    with Recording(file, changed_files=changed_files) as recording:
        # Of a note the numbers are there from the beginning on if it was noted there; frames begin when it was noted.
        notes = _notes(recording, more)
        start = _start(recording, [*recording.notes, *more], mapping.begin)
        columns = mapping.columns(recording.simulation, notes)
        viewpoints = {name: picture.viewpoint(name, recording.simulation) for name, picture in mapping.images.items()}
        begin = recording.simulation.sim_time if start is None else start
        times: List[float] = []
        rows: Dict[str, List[List[float]]] = {name: [] for name in columns}
        instructions: List[str] = []
        paths = {name: videos / f"{name}.mp4" for name in mapping.images}
        opened: Dict[str, Video] = {}
        sums: Dict[str, List[NDArray[np.float64]]] = {name: [] for name in mapping.images}
        try:
            for simulation in recording.sample(mapping.rate, start):
                times.append(simulation.sim_time - begin)
                for name, parts in columns.items():
                    rows[name].append([number for part in parts for number in part.read(recording)])
                instructions.append(_instruction(notes, simulation.sim_time))
                for name, picture in mapping.images.items():
                    viewpoint = viewpoints[name]
                    rgb = simulation.render(
                        picture.camera,
                        picture.width,
                        picture.height,
                        pose=None if viewpoint is None else viewpoint(recording),
                        field_view_angle=picture.field_view_angle,
                    )
                    if name not in opened:
                        opened[name] = Video(paths[name], picture, mapping.rate, codec)
                    opened[name].add(rgb)
                    sums[name].append(_picture_numbers(rgb))
            for video in opened.values():
                video.finish()
        except BaseException:
            for video in opened.values():
                video._process.kill()
            raise
        split = next((text.split(":", 1)[1].strip() for _, text in notes if text.startswith("split:")), "")
        task = next((text.split(":", 1)[1].strip() for _, text in notes if text.startswith("task:")), mapping.task)
    return Episode(
        file=file,
        task=task,
        split=split,
        times=np.array(times),
        features={name: np.array(values, dtype=np.float64).reshape(len(times), -1) for name, values in rows.items()},
        instructions=instructions,
        videos=paths,
        problem=recording.problem,
        picture_stats={name: _picture_stats(numbers) for name, numbers in sums.items()},
    )


def _start(recording: Recording, notes: Sequence[Note], note: str) -> Optional[float]:
    """Simulated time of the first note of that name, s; None if there is no name. Raises ExportError."""
    if not note:
        return None
    times = [time for time, text in notes if text.split(":", 1)[0].strip() == note]
    if times:
        return min(times)
    raise ExportError(f"{recording.path}: mapping, `begin: {note}`: no note of this name is in it")


def _instruction(notes: Sequence[Tuple[float, str]], time: float) -> str:
    texts = [text for at, text in notes if at <= time and text.startswith(("instruction:", "stage:"))]
    return texts[-1].split(":", 1)[1].strip() if texts else ""


def _picture_numbers(rgb: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(4 x 3) smallest, largest, mean value and mean square of each colour, 0 to 1."""
    pixels = rgb.reshape(-1, 3).astype(np.float64) / 255.0
    return np.array([pixels.min(0), pixels.max(0), pixels.mean(0), (pixels**2).mean(0)])


def _picture_stats(numbers: List[NDArray[np.float64]]) -> Dict[str, List[Any]]:
    table = np.array(numbers)
    mean, square = table[:, 2].mean(0), table[:, 3].mean(0)
    stats = {"min": table[:, 0].min(0), "max": table[:, 1].max(0), "mean": mean}
    stats["std"] = np.sqrt(np.maximum(square - mean**2, 0.0))
    shaped: Dict[str, List[Any]] = {name: value.reshape(3, 1, 1).tolist() for name, value in stats.items()}
    shaped["count"] = [len(numbers)]
    return shaped


def _stats(values: Array) -> Dict[str, List[float]]:
    table = values.reshape(len(values), -1)
    found = {"min": table.min(0), "max": table.max(0), "mean": table.mean(0), "std": table.std(0)}
    return {**{name: value.tolist() for name, value in found.items()}, "count": [len(table)]}


def _quantiles(values: Array) -> Dict[str, List[float]]:
    table = values.reshape(len(values), -1)
    return {f"q{share:02d}": np.quantile(table, share / 100.0, axis=0).tolist() for share in (1, 10, 50, 90, 99)}


def assign_splits(episodes: List[Episode], shares: Mapping[str, float]) -> List[Episode]:
    """Gives each episode that names no split one by its share, in order, and sorts the episodes so that each split is a range."""
    free = [episode for episode in episodes if not episode.split]
    total = sum(shares.values())
    names = list(shares)
    for number, episode in enumerate(free):
        reached, place = 0.0, (number + 0.5) / len(free)
        for name in names:
            reached += shares[name] / total
            if place <= reached + 1e-12:
                episode.split = name
                break
        else:
            episode.split = names[-1]
    order = names + sorted({episode.split for episode in episodes} - set(names))
    return sorted(episodes, key=lambda episode: order.index(episode.split))


def _ranges(episodes: Sequence[Episode]) -> Dict[str, str]:
    """First and end of each split's episodes."""
    ranges: Dict[str, List[int]] = {}
    for index, episode in enumerate(episodes):
        ranges.setdefault(episode.split, [index, index])[1] = index + 1
    return {name: f"{first}:{end}" for name, (first, end) in ranges.items()}


def _write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def _write_lines(path: Path, rows: Sequence[Any]) -> None:
    _write_text(path, "".join(json.dumps(row) + "\n" for row in rows))


def write_csv(out: Path, episodes: Sequence[Episode], names: Dict[str, List[str]]) -> None:
    """A file a recording: time, s, and all numbers, with 17 digits."""
    for index, episode in enumerate(episodes):
        path = out / f"episode_{index:06d}.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            heading = [f"{feature}/{name}" for feature in episode.features for name in names[feature]]
            writer.writerow(["time", *heading, "instruction"])
            for row, time in enumerate(episode.times):
                numbers = [repr(float(number)) for values in episode.features.values() for number in values[row]]
                writer.writerow([repr(float(time)), *numbers, episode.instructions[row]])
    _write_lines(out / "episodes.jsonl", [_about(index, episode) for index, episode in enumerate(episodes)])


def _about(index: int, episode: Episode) -> Dict[str, Any]:
    return {
        "episode_index": index,
        "tasks": [episode.task],
        "length": episode.length,
        "split": episode.split,
        "recording": os.path.basename(episode.file),
    }


def write_robomimic(out: Path, episodes: Sequence[Episode], names: Dict[str, List[str]], mapping: MappingOf) -> None:
    """One HDF5 file `data.hdf5` as robomimic reads it."""
    try:
        import h5py
    except ImportError as error:
        raise ExportError("robomimic needs the package h5py: pip install h5py") from error
    out.mkdir(parents=True, exist_ok=True)
    with h5py.File(out / "data.hdf5", "w") as file:
        data = file.create_group("data")
        arguments = {"env_name": mapping.robot_type, "type": 3, "env_kwargs": {}}
        data.attrs["env_args"] = json.dumps(arguments)
        total = 0
        masks: Dict[str, List[str]] = {}
        for index, episode in enumerate(episodes):
            # The last frame has no next one.
            length = episode.length - 1
            if length < 1:
                continue
            group = data.create_group(f"demo_{index}")
            group.attrs["num_samples"] = length
            group.attrs["recording"] = os.path.basename(episode.file)
            actions = episode.features.get("action", np.zeros((episode.length, 0)))
            group.create_dataset("actions", data=actions[:length])
            done = np.zeros(length, dtype=np.int64)
            done[-1] = 1
            group.create_dataset("dones", data=done)
            group.create_dataset("rewards", data=done.astype(np.float64))
            for name, values in episode.features.items():
                if name == "action":
                    continue
                key = name.removeprefix("observation.")
                group.create_dataset(f"obs/{key}", data=values[:length])
                group.create_dataset(f"next_obs/{key}", data=values[1:])
            states = episode.features.get("observation.state", np.zeros((episode.length, 0)))
            group.create_dataset("states", data=states[:length])
            total += length
            masks.setdefault(episode.split, []).append(f"demo_{index}")
        data.attrs["total"] = total
        data.attrs["names"] = json.dumps(names)
        for split, demos in masks.items():
            file.create_dataset(f"mask/{split}", data=np.array(demos, dtype="S"))


def _features(
    episodes: Sequence[Episode], names: Dict[str, List[str]], mapping: MappingOf, codec: str
) -> Dict[str, Any]:
    """The features of a LeRobot data set."""
    found: Dict[str, Any] = {}
    for name, columns in names.items():
        found[name] = {"dtype": "float32", "shape": [len(columns)], "names": columns}
    for name, picture in mapping.images.items():
        found[f"observation.images.{name}"] = {
            "dtype": "video",
            "shape": [picture.height, picture.width, 3],
            "names": ["height", "width", "channels"],
            "info": {
                "video.height": picture.height,
                "video.width": picture.width,
                "video.codec": codec,
                "video.pix_fmt": "yuv420p",
                "video.fps": mapping.rate,
                "video.channels": 3,
                "video.is_depth_map": False,
                "has_audio": False,
            },
        }
    texts = [*mapping.texts, *(["instruction.text"] if _has_instructions(episodes) else [])]
    for name in texts:
        found[name] = {"dtype": "string", "shape": [1], "names": None}
    found["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    for name in ("frame_index", "episode_index", "index", "task_index"):
        found[name] = {"dtype": "int64", "shape": [1], "names": None}
    return found


def _has_instructions(episodes: Sequence[Episode]) -> bool:
    return any(any(episode.instructions) for episode in episodes)


def _frames(episodes: Sequence[Episode], mapping: MappingOf, tasks: Sequence[str]) -> Iterator[Dict[str, Any]]:
    """The columns of each episode."""
    first, has_instructions = 0, _has_instructions(episodes)
    for index, episode in enumerate(episodes):
        count = np.arange(episode.length)
        columns: Dict[str, Any] = {name: values.astype(np.float32) for name, values in episode.features.items()}
        columns.update({name: [text] * episode.length for name, text in mapping.texts.items()})
        if has_instructions:
            columns["instruction.text"] = episode.instructions
        columns["timestamp"] = (count / mapping.rate).astype(np.float32)
        columns["frame_index"] = count
        columns["episode_index"] = np.full(episode.length, index)
        columns["index"] = first + count
        columns["task_index"] = np.full(episode.length, tasks.index(episode.task))
        first += episode.length
        yield columns


def _table(columns: Mapping[str, Any]) -> Any:
    pyarrow = _pyarrow()

    def array(values: Any) -> Any:
        if isinstance(values, list):
            return pyarrow.array(values, type=pyarrow.string())
        if values.ndim == 1:
            return pyarrow.array(values)
        return pyarrow.FixedSizeListArray.from_arrays(pyarrow.array(values.reshape(-1)), values.shape[1])

    return pyarrow.table({name: array(values) for name, values in columns.items()})


def _pyarrow() -> Any:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise ExportError("lerobot needs the package pyarrow: pip install pyarrow") from error
    return pyarrow


def _write_parquet(path: Path, table: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    _pyarrow().parquet.write_table(table, path, compression="snappy", use_dictionary=True)


def _readme(episodes: Sequence[Episode], mapping: MappingOf, version: str) -> str:
    return (
        f"# {mapping.robot_type}\n\n"
        f"{len(episodes)} episodes at {mapping.rate:g} Hz, LeRobot {version}. Type: Digital Simulation (AMBF).\n\n"
        "All numbers and pictures of a frame are of one simulated moment, so that they are synchronized exactly; `timestamp` is "
        "simulated time since the beginning of the episode, in s. Recordings that it was exported from:\n\n"
        + "".join(f"* {os.path.basename(episode.file)}: {episode.task} ({episode.split})\n" for episode in episodes)
    )


def _all_stats(episode: Episode, columns: Mapping[str, Any]) -> Dict[str, Any]:
    stats: Dict[str, Any] = {}
    for name, values in columns.items():
        if not isinstance(values, list):
            stats[name] = _stats(np.asarray(values, dtype=np.float64))
    stats.update({f"observation.images.{name}": of for name, of in episode.picture_stats.items()})
    return stats


def write_lerobot21(
    out: Path, episodes: Sequence[Episode], names: Dict[str, List[str]], mapping: MappingOf, codec: str
) -> None:
    """LeRobot v2.1, as Open-H-Embodiment asks for it."""
    tasks = sorted({episode.task for episode in episodes})
    rows, stats = [], []
    for index, (episode, columns) in enumerate(zip(episodes, _frames(episodes, mapping, tasks))):
        chunk = f"chunk-{index // _CHUNK:03d}"
        _write_parquet(out / "data" / chunk / f"episode_{index:06d}.parquet", _table(columns))
        for name, path in episode.videos.items():
            to = out / "videos" / chunk / f"observation.images.{name}" / f"episode_{index:06d}.mp4"
            to.parent.mkdir(parents=True, exist_ok=True)
            shutil.move(str(path), to)
        rows.append(_about(index, episode))
        stats.append({"episode_index": index, "stats": _all_stats(episode, columns)})
    (out / "videos").mkdir(parents=True, exist_ok=True)
    info = {
        "codebase_version": "v2.1",
        "robot_type": mapping.robot_type,
        "total_episodes": len(episodes),
        "total_frames": sum(episode.length for episode in episodes),
        "total_tasks": len(tasks),
        "total_videos": len(episodes) * len(mapping.images),
        "total_chunks": -(-len(episodes) // _CHUNK),
        "chunks_size": _CHUNK,
        "fps": int(mapping.rate) if mapping.rate == int(mapping.rate) else mapping.rate,
        "splits": _ranges(episodes),
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "video_path": "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
        "features": _features(episodes, names, mapping, codec),
    }
    _write_text(out / "meta/info.json", json.dumps(info, indent=4))
    _write_lines(out / "meta/episodes.jsonl", rows)
    _write_lines(out / "meta/episodes_stats.jsonl", stats)
    _write_lines(out / "meta/tasks.jsonl", [{"task_index": index, "task": task} for index, task in enumerate(tasks)])
    _write_text(out / "meta/README.md", _readme(episodes, mapping, "v2.1"))


def write_lerobot30(
    out: Path, episodes: Sequence[Episode], names: Dict[str, List[str]], mapping: MappingOf, codec: str
) -> None:
    """LeRobot v3.0: all frames in one file; a video an episode, so that none is encoded twice."""
    pyarrow = _pyarrow()
    tasks = sorted({episode.task for episode in episodes})
    frames = list(_frames(episodes, mapping, tasks))
    _write_parquet(
        out / "data/chunk-000/file-000.parquet", pyarrow.concat_tables([_table(columns) for columns in frames])
    )
    rows: List[Dict[str, Any]] = []
    first = 0
    for index, (episode, columns) in enumerate(zip(episodes, frames)):
        row: Dict[str, Any] = {
            "episode_index": index,
            "tasks": [episode.task],
            "length": episode.length,
            "data/chunk_index": 0,
            "data/file_index": 0,
            "dataset_from_index": first,
            "dataset_to_index": first + episode.length,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        first += episode.length
        for name, path in episode.videos.items():
            key = f"observation.images.{name}"
            chunk, file = divmod(index, _CHUNK)
            to = out / "videos" / key / f"chunk-{chunk:03d}" / f"file-{file:03d}.mp4"
            to.parent.mkdir(parents=True, exist_ok=True)
            shutil.move(str(path), to)
            row[f"videos/{key}/chunk_index"] = chunk
            row[f"videos/{key}/file_index"] = file
            row[f"videos/{key}/from_timestamp"] = 0.0
            row[f"videos/{key}/to_timestamp"] = episode.length / mapping.rate
        stats = _all_stats(episode, columns)
        for name, values in columns.items():
            if not isinstance(values, list):
                stats[name].update(_quantiles(np.asarray(values, dtype=np.float64)))
        row.update({f"stats/{name}/{kind}": value for name, of in stats.items() for kind, value in of.items()})
        rows.append(row)
    table = pyarrow.Table.from_pylist(rows)
    _write_parquet(out / "meta/episodes/chunk-000/file-000.parquet", table)
    whole: Dict[str, Any] = {}
    for name in frames[0]:
        if not isinstance(frames[0][name], list):
            values = np.concatenate([np.asarray(columns[name], dtype=np.float64) for columns in frames])
            whole[name] = {**_stats(values), **_quantiles(values)}
    for name in mapping.images:
        parts = [episode.picture_stats[name] for episode in episodes]
        whole[f"observation.images.{name}"] = _merged_picture_stats(parts)
    _write_text(out / "meta/stats.json", json.dumps(whole, indent=4))
    _write_parquet(out / "meta/tasks.parquet", _tasks_table(tasks))
    info = {
        "codebase_version": "v3.0",
        "robot_type": mapping.robot_type,
        "total_episodes": len(episodes),
        "total_frames": first,
        "total_tasks": len(tasks),
        "chunks_size": _CHUNK,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": int(mapping.rate) if mapping.rate == int(mapping.rate) else mapping.rate,
        "splits": _ranges(episodes),
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
        if mapping.images
        else None,
        "features": _features(episodes, names, mapping, codec),
    }
    _write_text(out / "meta/info.json", json.dumps(info, indent=4))
    _write_text(out / "README.md", _readme(episodes, mapping, "v3.0"))


def _merged_picture_stats(parts: Sequence[Dict[str, List[Any]]]) -> Dict[str, List[Any]]:
    counts = np.array([part["count"][0] for part in parts], dtype=np.float64)

    def numbers(kind: str) -> Array:
        return np.array([part[kind] for part in parts])

    weights = (counts / counts.sum()).reshape(-1, 1, 1, 1)
    mean = (numbers("mean") * weights).sum(0)
    square = ((numbers("std") ** 2 + numbers("mean") ** 2) * weights).sum(0)
    std = np.sqrt(np.maximum(square - mean**2, 0.0))
    merged = {"min": numbers("min").min(0), "max": numbers("max").max(0), "mean": mean, "std": std}
    return {**{name: value.tolist() for name, value in merged.items()}, "count": [int(counts.sum())]}


def _tasks_table(tasks: Sequence[str]) -> Any:
    """As pandas writes a frame whose index is named `task`."""
    pyarrow = _pyarrow()
    table = pyarrow.table({"task_index": pyarrow.array(range(len(tasks)), pyarrow.int64()), "task": list(tasks)})

    def column(name: str, kind: str, numpy: str) -> Dict[str, Any]:
        return {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}

    about = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
        "creator": {"library": "ambf", "version": "1"},
        "pandas_version": "2.0.0",
    }
    return table.replace_schema_metadata({b"pandas": json.dumps(about).encode()})


def _check_form(to: str, mapping: MappingOf) -> None:
    """Whether a form can be written. Raises ExportError, BagError."""
    if to not in FORMS:
        raise ExportError(f"form {to!r}: expected one of {', '.join(FORMS)}")
    if to == "mp4" and not mapping.images:
        raise ExportError("mp4 needs a mapping with `images`")
    if to.startswith("lerobot"):
        _pyarrow()
    if to.startswith("rosbag"):
        bags.check()


def _check_numbers(file: str, episodes: Sequence[Episode], names: Dict[str, List[str]]) -> None:
    """Whether all episodes have as many numbers as the first, of `file`. Raises ExportError."""
    for episode in episodes:
        for name, values in episode.features.items():
            if values.shape[1] != len(names[name]):
                raise ExportError(
                    f"{episode.file}: `{name}` has {values.shape[1]} numbers, in {file} {len(names[name])}"
                )


def export(
    files: Sequence[str],
    to: str,
    out: Path,
    *,
    mapping: Optional[MappingOf] = None,
    splits: Optional[Mapping[str, float]] = None,
    codec: str = "h264",
    changed_files: bool = False,
    notes: Sequence[Note] = (),
    tell: Callable[[str], None] = lambda _: None,
) -> List[Episode]:
    """Exports recordings, an episode each, into the folder `out`, which must not be there. `notes` are further ones of the only recording.

    Raises ExportError, RecordingError.
    """
    mapping = mapping or MappingOf()
    if notes and len(files) != 1:
        raise ExportError(f"notes are of one recording, and {len(files)} are exported: export them one by one")
    if out.exists():
        raise ExportError(f"{out} is there already; choose another folder or remove it")
    _check_form(to, mapping)
    unfinished = out.with_name(out.name + ".unfinished")
    if unfinished.exists():
        raise ExportError(f"{unfinished} is there: another export writes it, or was killed; remove it then")
    try:
        unfinished.mkdir(parents=True)
        episodes = []
        for index, file in enumerate(files):
            if to.startswith("rosbag"):
                episodes.append(_write_bag(file, unfinished, index, to, mapping.rate, changed_files, notes))
            else:
                videos = unfinished / ".videos" / f"{index:06d}"
                episodes.append(sample(file, mapping, videos, codec, changed_files=changed_files, notes=notes))
            tell(f"{file}: {episodes[-1].length} frames")
            if episodes[-1].problem is not None:
                tell(f"warning: {episodes[-1].problem}")
        if not to.startswith("rosbag"):
            names = _names(files[0], mapping, changed_files)
            _check_numbers(files[0], episodes, names)
            episodes = assign_splits(episodes, splits or {"train": 1.0})
            _write(unfinished, to, episodes, names, mapping, codec)
        shutil.rmtree(unfinished / ".videos", ignore_errors=True)
        unfinished.rename(out)
    except BaseException:
        shutil.rmtree(unfinished, ignore_errors=True)
        raise
    return episodes


def _write_bag(
    file: str, out: Path, index: int, to: str, rate: float, changed_files: bool, notes: Sequence[Note]
) -> Episode:
    """A recording as a bag of ROS."""
    version = 1 if to == "rosbag1" else 2
    path = out / (f"episode_{index:06d}.bag" if version == 1 else f"episode_{index:06d}")
    with Recording(file, changed_files=changed_files) as recording:
        times = bags.write(recording, path, version, rate, _notes(recording, notes))
        problem = recording.problem
    return Episode(
        file=file,
        task="",
        split="",
        times=np.array(times),
        features={},
        instructions=[],
        videos={},
        picture_stats={},
        problem=problem,
    )


def _write(
    out: Path, to: str, episodes: Sequence[Episode], names: Dict[str, List[str]], mapping: MappingOf, codec: str
) -> None:
    """Writes episodes in the form `to`."""
    if to == "csv":
        write_csv(out, episodes, names)
    elif to == "robomimic":
        write_robomimic(out, episodes, names, mapping)
    elif to == "lerobot-v2.1":
        write_lerobot21(out, episodes, names, mapping, codec)
    elif to == "lerobot-v3.0":
        write_lerobot30(out, episodes, names, mapping, codec)
    else:
        for index, episode in enumerate(episodes):
            for name, path in episode.videos.items():
                shutil.move(str(path), out / f"episode_{index:06d}_{name}.mp4")


def _names(file: str, mapping: MappingOf, changed_files: bool) -> Dict[str, List[str]]:
    with Recording(file, changed_files=changed_files) as recording:
        columns = mapping.columns(recording.simulation)
    return {name: [text for part in parts for text in part.names] for name, parts in columns.items()}


def _shares(text: str) -> Dict[str, float]:
    shares = {}
    for part in text.split(","):
        name, _, share = part.partition("=")
        try:
            shares[name.strip()] = float(share)
        except ValueError as error:
            raise argparse.ArgumentTypeError(f"{part!r}: expected NAME=SHARE,…") from error
        if not (math.isfinite(shares[name.strip()]) and shares[name.strip()] > 0 and name.strip()):
            raise argparse.ArgumentTypeError(f"{part!r}: expected a name and a share above 0")
    return shares


def _note(time: str, text: str) -> Note:
    try:
        return float(time), text
    except ValueError as error:
        raise ExportError(f"--note {time!r}: expected a simulated time, s, before the text") from error


def main(arguments: Optional[Sequence[str]] = None, out: Optional[IO[str]] = None) -> int:
    """The program `ambf_export`; its exit status: 0, or 1 with a sentence on the standard error output."""
    parser = argparse.ArgumentParser(
        prog="ambf_export", description="Replays recordings and writes what a mapping asks for as a data set."
    )
    parser.add_argument("files", nargs="+", metavar="FILE", help="recordings; each becomes an episode")
    parser.add_argument("--to", required=True, choices=FORMS, help="form of the data set")
    parser.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder to make")
    parser.add_argument(
        "--mapping",
        metavar="FILE",
        help="what is written: a file (YAML), or one by its name: "
        + ", ".join(shipped())
        + " [default: positions and targets of all joints]",
    )
    parser.add_argument(
        "--rate", type=float, metavar="HZ", help="frames a simulated second [default: the mapping's, else 30]"
    )
    parser.add_argument(
        "--splits", type=_shares, metavar="NAME=SHARE,…", help="such as train=0.8,val=0.1,test=0.1 [default: train=1]"
    )
    parser.add_argument("--codec", choices=tuple(_CODECS), default="h264", help="of videos [default: h264]")
    parser.add_argument(
        "--note",
        nargs=2,
        action="append",
        default=[],
        metavar=("SECONDS", "TEXT"),
        help="a further note at this simulated time, such as `instruction: grasp`; may be repeated; for a single recording",
    )
    parser.add_argument("--changed-files", action="store_true", help="also when files of the scene have changed since")
    options = parser.parse_args(arguments)
    try:
        notes = [_note(time, text) for time, text in options.note]
        mapping = MappingOf.load(options.mapping)
        if options.rate is not None:
            if not 0 < options.rate <= 10_000:
                raise ExportError(f"--rate {options.rate}: expected a frequency above 0, Hz")
            mapping.rate = options.rate
        export(
            options.files,
            options.to,
            options.out,
            mapping=mapping,
            splits=options.splits,
            codec=options.codec,
            changed_files=options.changed_files,
            notes=notes,
            tell=lambda line: print(line, file=out or sys.stdout),
        )
    except (AmbfError, OSError) as error:
        print(f"ambf_export: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
