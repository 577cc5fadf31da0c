"""What all worked tasks have in common: the options with which their environments are made."""

from __future__ import annotations

import importlib.util
from typing import Any, Callable, Dict, Optional, Sequence, Tuple, Union

from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv

from ..backend import Backend, Pixels
from ..env import SimulatorEnv, Task
from ..errors import InvalidDescription
from ..scene import Scene

PROCESS, ROS = "process", "ros"

OPTIONS = """

`backend`: "process", in this process with the package `ambf`; "ros", over ROS in a simulator of its own; or a `Backend`. None: in this
process if the package `ambf` is installed, else over ROS. `in_process`: True is "process", False "ros". `render_mode`, `camera`, `width`,
`height`, `pixels`, `max_episode_steps`: as those of `SimulatorEnv`. Others are options of `RosBackend`.
"""


def makers(
    name: str, scene: Scene, task: Task
) -> Tuple[Callable[..., SimulatorEnv], Callable[..., VectorEnv[Any, Any, Any]]]:
    """The functions that make an environment of the task `ambf/NAME-v0`, and many of them at once; both have the same options."""

    def make(
        backend: Union[Backend, str, None] = None,
        render_mode: Optional[str] = None,
        *,
        in_process: Optional[bool] = None,
        camera: Optional[str] = None,
        width: Optional[int] = None,
        height: Optional[int] = None,
        pixels: Union[Pixels, Sequence[Pixels]] = (),
        max_episode_steps: Optional[int] = None,
        **ros: Any,
    ) -> SimulatorEnv:
        chosen = make_backend(scene, which(backend, in_process), ros)
        view: Dict[str, Any] = {"camera": camera, "width": width, "height": height}
        view["max_episode_steps"] = max_episode_steps
        return SimulatorEnv(chosen, task, render_mode, pixels=pixels, **view)

    def make_vec(
        num_envs: int = 1,
        backend: Union[Backend, str, None] = None,
        render_mode: Optional[str] = None,
        *,
        in_process: Optional[bool] = None,
        autoreset_mode: Union[str, AutoresetMode] = AutoresetMode.NEXT_STEP,
        **options: Any,
    ) -> VectorEnv[Any, Any, Any]:
        chosen = which(backend, in_process)
        if chosen == PROCESS:
            from ..vector import InProcessVectorEnv

            return InProcessVectorEnv(scene, task, num_envs, autoreset_mode, render_mode=render_mode, **options)
        if not isinstance(chosen, str):
            raise InvalidDescription('a backend is one world; for several give backend="process" or "ros"')
        return SyncVectorEnv(
            [lambda: make(ROS, render_mode, **options) for _ in range(num_envs)], autoreset_mode=autoreset_mode
        )

    make.__doc__ = f"The environment `ambf/{name}-v0`. {OPTIONS}"
    make_vec.__doc__ = (
        f"`num_envs` environments `ambf/{name}-v0`: in this process on threads, as `InProcessVectorEnv`; over ROS one after the other. "
        f"`autoreset_mode`: as of Gymnasium's vector environments. {OPTIONS}"
    )
    for function, ending in ((make, ""), (make_vec, "_vec")):
        function.__name__ = function.__qualname__ = f"make_{name.lower()}{ending}"
    return make, make_vec


def which(backend: Union[Backend, str, None], in_process: Optional[bool]) -> Union[Backend, str]:
    """What `backend` and `in_process` ask for: a backend, "process" or "ros". Raises InvalidDescription."""
    if in_process is not None:
        asked = PROCESS if in_process else ROS
        if backend not in (None, asked):
            raise InvalidDescription(f"in_process={in_process} and backend={backend!r} contradict each other")
        return asked
    if backend is None:
        return PROCESS if importlib.util.find_spec("ambf") else ROS
    if isinstance(backend, str) and backend not in (PROCESS, ROS):
        raise InvalidDescription(f'backend={backend!r}: expected "{PROCESS}", "{ROS}" or a backend')
    return backend


def make_backend(scene: Scene, chosen: Union[Backend, str], ros: Dict[str, Any]) -> Backend:
    """The backend for `scene`. What it needs, ROS or the package `ambf`, is imported here. Raises InvalidDescription."""
    if chosen == ROS:
        from ..ros_backend import RosBackend

        return RosBackend(scene, **ros)
    if ros:
        raise InvalidDescription(f'{", ".join(sorted(ros))}: these are options of the backend "ros" only')
    if not isinstance(chosen, str):
        return chosen
    from ..in_process import InProcessBackend

    return InProcessBackend(scene)
