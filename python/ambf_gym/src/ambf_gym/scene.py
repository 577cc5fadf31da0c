"""Which scene an environment simulates, and what its files say about joints."""

from __future__ import annotations

import argparse
import math
import os
import shutil
import xml.etree.ElementTree as xml
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Dict, Optional, Sequence, Tuple

import yaml

from .backend import plain
from .errors import InvalidDescription

Limits = Dict[str, Tuple[float, float]]

INTEGRATORS = ("euler", "ballistic", "rk4")
"""How bodies are moved; None stands for that of the profile, which in "accurate" is "rk4". "euler": semi-implicit Euler, of first order
in the interval, and the fastest; "rk4": of fourth order; "ballistic": between them, for free bodies.
"""


@dataclass(frozen=True)
class Scene:
    """A scene of the simulator."""

    models: Sequence[str]
    """Model files (ADF or URDF), absolute or below the simulator's `resources`."""
    launch_file: Optional[str] = None
    """Launch file with the world, absolute or below the simulator's `resources`; the simulator's own if none."""
    options: Sequence[str] = ()
    """Further options of `ambf_simulator`, such as `('--profile', 'accurate')`."""

    def integrated_by(self, integrator: Optional[str]) -> Scene:
        """The scene with one of `INTEGRATORS`; None: as it is. Raises InvalidDescription."""
        if integrator is None:
            return self
        if integrator not in INTEGRATORS:
            raise InvalidDescription(f"integrator={integrator!r}: expected one of {', '.join(INTEGRATORS)}")
        options, before = [], ""
        for option in self.options:
            if "--integrator" not in (before, option.split("=")[0]):
                options.append(option)
            before = option
        return replace(self, options=(*options, "--integrator", integrator))

    def model_files(self) -> Tuple[str, ...]:
        """The model files, found; raises InvalidDescription if one is missing."""
        return tuple(str(_find(model)) for model in self.models)

    def launch(self) -> Optional[str]:
        """The launch file, found; None if none is named. Raises InvalidDescription if it is missing."""
        return None if self.launch_file is None else str(_find(self.launch_file))

    def interval(self) -> float:
        """Simulated time of an iteration, s, as the options say."""
        parser = argparse.ArgumentParser(add_help=False, exit_on_error=False)
        parser.add_argument("-p", "--phx_frequency", type=float, default=1000.0)
        parser.add_argument("-s", "--sim_speed_factor", type=float, default=1.0)
        try:
            found, _ = parser.parse_known_args(list(self.options))
        except argparse.ArgumentError as error:
            raise InvalidDescription(f"options of the scene: {error}") from error
        if not (found.phx_frequency > 0.0 and found.sim_speed_factor > 0.0):
            raise InvalidDescription("options of the scene: frequency and speed factor are above 0")
        return float(found.sim_speed_factor / found.phx_frequency)

    def profile_options(self) -> Tuple[str, ...]:
        """Options with which the program has the profile that `ambf.Simulation` has: "accurate", unless the options or the world file
        name another one.
        """
        if any(option.split("=")[0] == "--profile" for option in self.options) or self._world_has_profile():
            return ()
        return ("--profile", "accurate")

    def _world_has_profile(self) -> bool:
        launch = Path(self.launch_file) if self.launch_file else resources() / "launch.yaml"
        try:
            world = (yaml.safe_load(launch.read_text()) or {}).get("world config")
            physics = (yaml.safe_load((launch.parent / str(world)).read_text()) or {}).get("physics") or {}
            return physics.get("profile") is not None
        except (OSError, AttributeError, yaml.YAMLError):
            # The simulator says what is wrong with them.
            return False

    def joint_limits(self) -> Limits:
        """Limits of all joints that have some, rad or m, by name without blanks."""
        limits: Limits = {}
        for model in self.model_files():
            limits.update(limits_in(Path(model)))
        return limits


def resources() -> Path:
    """The simulator's folder `resources`: `$AMBF_RESOURCES`, or that of the repository, wheel or Debian package
    in which this file lies.
    """
    chosen = os.environ.get("AMBF_RESOURCES")
    if chosen:
        return Path(chosen)
    for folder in Path(__file__).resolve().parents:
        for place in (folder / "resources", folder / "ambf/resources", folder / "share/ambf"):
            if (place / "launch.yaml").is_file():
                return place
    raise InvalidDescription("the simulator's folder of scenes is not known; set AMBF_RESOURCES to it")


def simulator() -> str:
    """The program: `$AMBF_SIMULATOR`, that on the PATH, or that built in the repository in which this file lies."""
    chosen = os.environ.get("AMBF_SIMULATOR") or shutil.which("ambf_simulator")
    if chosen:
        return chosen
    for folder in Path(__file__).resolve().parents:
        for kind in ("release", "debug"):
            built = folder / "target" / kind / "ambf_simulator"
            if built.is_file():
                return str(built)
    raise InvalidDescription("ambf_simulator is not on the PATH; set AMBF_SIMULATOR to it")


def _find(model: str) -> Path:
    path = Path(model)
    if not path.is_absolute() and not path.is_file():
        path = resources() / model
    if not path.is_file():
        raise InvalidDescription(f"there is no file {path}")
    return path.resolve()


def limits_in(model: Path) -> Limits:
    """Limits of the joints in a model file."""
    try:
        text = model.read_text()
        return (
            _urdf_limits(xml.fromstring(text))
            if model.suffix in (".urdf", ".xml")
            else _adf_limits(yaml.safe_load(text))
        )
    except (OSError, ValueError, yaml.YAMLError, xml.ParseError) as error:
        raise InvalidDescription(f"{model}: {error}; give low and high for its joints") from error


def _adf_limits(model: Any) -> Limits:
    limits: Limits = {}
    for key in (model or {}).get("joints") or ():
        joint = model.get(key) or {}
        bounds = joint.get("joint limits") or {}
        name = plain(str(joint.get("name", key)))
        # The first of a name is the one that is commanded: springs lie beside their joint and are passive.
        if {"low", "high"} <= set(bounds) and not joint.get("passive") and name not in limits:
            limits[name] = (float(bounds["low"]), float(bounds["high"]))
    return limits


def _urdf_limits(robot: xml.Element) -> Limits:
    limits: Limits = {}
    if robot.tag == "mujoco":
        # Ranges of MJCF depend on classes and included files: tasks in process ask the simulation, others give them.
        return limits
    for joint in robot.iter("joint"):
        bounds = joint.find("limit")
        if bounds is not None and joint.get("type") in ("revolute", "prismatic"):
            low, high = float(bounds.get("lower", 0.0)), float(bounds.get("upper", 0.0))
            if math.isfinite(low) and low < high:
                limits[plain(str(joint.get("name")))] = (low, high)
    return limits
