"""Where the shipped scenes are."""

from __future__ import annotations

import os
from pathlib import Path

from .errors import NotFoundError


def resources() -> Path:
    """The folder of shipped scenes, with `launch.yaml` and `models`: `$AMBF_RESOURCES`, that of a wheel, of the
    repository, or of the Debian package `ambf`.

    Raises `NotFoundError` where there is none.
    """
    chosen = os.environ.get("AMBF_RESOURCES")
    if chosen:
        return Path(chosen)
    for folder in Path(__file__).resolve().parents:
        for part in ("resources", "share/ambf"):
            if (folder / part / "launch.yaml").is_file():
                return folder / part
    raise NotFoundError("the folder of shipped scenes is not known; set AMBF_RESOURCES to it")
