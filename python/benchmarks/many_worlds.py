"""Memory and load time of many worlds of one scene: many_worlds.py SCENE [--worlds N]. in_process.py starts it, a process a scene.

SCENE is a model file, or one that is made here: `hulls`, the arm of arm7.yaml whose links collide as the hulls of what is drawn, and
`fine`, the same with concave meshes of 20 000 triangles each. Prints one object of JSON: seconds of the first world and of the last ones
(median of a sixteenth of all), of more that are made when all are gone, so that nothing is shared, and VmRSS before, after the first and
at the end, kB. The page cache has the files before.
"""

from __future__ import annotations

import argparse
import json
import re
import tempfile
import time
from pathlib import Path

import ambf
import numpy as np
from ambf_gym.scene import resources


def write_ball(path: Path, rows: int = 100) -> None:
    """A closed surface of 2 · rows² triangles, radius 4 cm with waves, as binary STL."""
    height, around = np.meshgrid(
        np.linspace(0.0, np.pi, rows + 1), np.linspace(0.0, 2.0 * np.pi, rows + 1), indexing="ij"
    )
    radius = 0.04 * (1.0 + 0.1 * np.sin(5.0 * height) * np.sin(6.0 * around))
    flat = radius * np.sin(height)
    points = np.stack([flat * np.cos(around), flat * np.sin(around), radius * np.cos(height)], axis=-1)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    corners = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3, 3)
    facets = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets["corners"] = corners
    path.write_bytes(bytes(80) + np.uint32(len(facets)).tobytes() + facets.tobytes())


def scene(name: str, folder: Path) -> Path:
    """The model file."""
    if name not in ("hulls", "fine"):
        return Path(name)
    text = (resources() / "models/arm7.yaml").read_text()
    text = re.sub(r"  collision shape: .*\n  collision geometry: .*\n", "", text)
    if name == "hulls":
        text = text.replace("../meshes/arm7/", f"{resources()}/meshes/arm7/")
    else:
        # Files of their own for the links, as an arm has.
        for link in set(re.findall(r"mesh: (\w+)\.obj", text)):
            write_ball(folder / f"{link}.stl")
        text = re.sub(r"  mesh: (\w+)\.obj\n", r"  mesh: \1.stl\n  collision mesh type: CONCAVE_MESH\n", text)
        text = text.replace("../meshes/arm7/", f"{folder}/")
    path = folder / f"{name}.yaml"
    path.write_text(text)
    return path


def resident() -> int:
    """VmRSS, kB."""
    return int(re.search(r"VmRSS:\s+(\d+)", Path("/proc/self/status").read_text())[1])  # type: ignore[index]


def load(model: Path, profile: str) -> tuple[ambf.Simulation, float]:
    """A world, and the seconds it took."""
    begin = time.perf_counter()
    return ambf.Simulation(model, profile=profile), time.perf_counter() - begin


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description="Memory and load time of many worlds of one scene.")
    parser.add_argument("scene")
    parser.add_argument("--worlds", type=int, default=256)
    parser.add_argument("--profile", default="accurate")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        model = scene(chosen.scene, Path(folder))
        # Files that have changed only just now are not shared.
        time.sleep(0.2)
        # What the library needs once, whatever the scene.
        load(resources() / "models/pendulum.yaml", chosen.profile)[0].close()
        sizes = [resident()]
        worlds, times = [], []
        for _ in range(chosen.worlds):
            world, took = load(model, chosen.profile)
            worlds.append(world)
            times.append(took)
            sizes.append(resident())
        last = max(chosen.worlds // 16, 1)
        for world in worlds:
            world.close()
        del world, worlds
        alone = []
        for _ in range(min(last, 5)):
            world, took = load(model, chosen.profile)
            world.close()
            alone.append(took)
    found = {
        "first_s": times[0],
        "last_s": float(np.median(times[-last:])),
        "alone_s": float(np.median(alone)),
        "before_kb": sizes[0],
        "first_kb": sizes[1],
        "all_kb": sizes[-1],
    }
    print(json.dumps(found))


if __name__ == "__main__":
    main()
