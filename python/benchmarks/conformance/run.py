"""Runs the cases with one simulator in this interpreter: run.py MODULE CLASS [CASE…]. Prints a line of JSON a case and step:
{"case", "step", "rows": [[what, got, right, tolerance, passes]…]} or, in place of rows, "unsupported": why."""

from __future__ import annotations

import importlib
import json
import os
import sys

from cases import CASES
from scene import Unsupported


def main() -> None:
    adapter = getattr(importlib.import_module(sys.argv[1]), sys.argv[2])
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    # Libraries print as they like.
    os.dup2(2, 1)
    for case in CASES:
        if sys.argv[3:] and case.name not in sys.argv[3:]:
            continue
        for step in case.steps:
            line: dict[str, object] = {"case": case.name, "step": step}
            try:
                line["rows"] = [
                    [r.what, float(r.got), r.right, r.tolerance, bool(r.passes)] for r in case.run(adapter, step)
                ]
            except Unsupported as reason:
                line["unsupported"] = str(reason)
            print(json.dumps(line), file=answers)


if __name__ == "__main__":
    main()
