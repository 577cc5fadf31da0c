"""The programs that a wheel brings: `ambf-batch` and `ambf-check`."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from .errors import NotFoundError


def _run(*arguments: str) -> None:
    program = Path(__file__).parent / "bin" / "ambf_batch"
    if not program.is_file():
        raise NotFoundError(
            f"there is no {program}: only wheels hold it; in the repository it is target/release/ambf_batch"
        )
    os.execv(program, [str(program), *arguments])


def batch() -> None:
    """Steps a scene as fast as it goes, and writes traces; `ambf-batch --help` says more."""
    _run(*sys.argv[1:])


def check() -> None:
    """Says what is wrong with scene files; does not return."""
    _run("--check", *sys.argv[1:])
