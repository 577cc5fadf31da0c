"""What simulators make of cases with a known answer: conformance.py PAGE [--only CASE]… [--adapter MODULE:CLASS].

Each simulator runs the cases of `conformance/cases.py` in a process of its own. Writes what is between the markers of PAGE; with --only it
prints the cases and writes nothing. `scripts/bench conformance` starts it. With --adapter another simulator is tried, beside this one:
a module in PYTHONPATH with a class that does what `conformance/scene.py` says of `Simulator`.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, List, Sequence, Tuple

HERE = Path(__file__).parent / "conformance"
MARKS = ("<!-- measured: begin -->\n", "<!-- measured: end -->\n")
sys.path.insert(0, str(HERE))
from cases import CASES  # noqa: E402

Results = Dict[Tuple[str, float], Dict[str, Any]]


def measure(python: str, module: str, name: str, cases: Sequence[str], path: str = "") -> Results:
    """Results of one simulator; where its process ends early, so do they."""
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, (str(HERE), path, os.environ.get("PYTHONPATH")))),
    }
    command = [python, str(HERE / "run.py"), module, name, *cases]
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=False, text=True)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    if done.returncode:
        print(f"conformance: {module}:{name} ended with {done.returncode} after {len(lines)} results", file=sys.stderr)
    return {(line["case"], line["step"]): line for line in lines}


def number(value: float) -> str:
    if not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    return f"{value:.3g}" if 1e-3 <= abs(value) < 1e5 else f"{value:.1e}"


def table(case: Any, results: Dict[str, Results]) -> Tuple[str, Dict[str, List[bool]]]:
    """The table of a case, and which rows pass."""
    lines = [f"| h, ms | | right | {' | '.join(results)} |", "|---" * (3 + len(results)) + "|"]
    passes: Dict[str, List[bool]] = {name: [] for name in results}
    for step in case.steps:
        answers = {
            name: result.get((case.name, step), {"unsupported": "did not end"}) for name, result in results.items()
        }
        known = next((answer["rows"] for answer in answers.values() if "rows" in answer), [])
        for i, (what, _, right, tolerance, _) in enumerate(known):
            cells = []
            for name, answer in answers.items():
                if "rows" not in answer:
                    cells.append("not possible")
                    continue
                _, got, _, _, is_right = answer["rows"][i]
                passes[name].append(is_right)
                cells.append(number(got) if is_right else f"**{number(got)}**")
            lines.append(f"| {1e3 * step:.3g} | {what} | {number(right)} ± {number(tolerance)} | {' | '.join(cells)} |")
        for name, answer in answers.items():
            if "rows" not in answer:
                passes[name] += [False] * len(known)
    reasons = {
        f"{name}: {result[key]['unsupported']}."
        for name, result in results.items()
        for key in result
        if key[0] == case.name and "unsupported" in result[key]
    }
    return "\n".join([f"### {case.name}", "", case.text, "", *lines, "", *sorted(reasons)]).rstrip() + "\n", passes


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", type=Path)
    parser.add_argument("--only", action="append", default=[], metavar="CASE")
    parser.add_argument("--adapter", action="append", default=[], metavar="MODULE:CLASS")
    options = parser.parse_args()
    names = [case.name for case in CASES]
    for name in options.only:
        if name not in names:
            parser.error(f"no case {name!r}; there are: {', '.join(names)}")
    here, peers, older = sys.executable, os.environ.get("AMBF_PEERS_PYTHON"), os.environ.get("AMBF_PEERS_MUJOCO3")
    results = {
        "accurate": measure(here, "ambf_adapter", "Accurate", options.only),
        "legacy": measure(here, "ambf_adapter", "Legacy", options.only),
    }
    if peers:
        results["pybullet"] = measure(peers, "pybullet_adapter", "PyBullet", options.only)
        results["MuJoCo"] = measure(peers, "mujoco_adapter", "MuJoCo", options.only)
    if peers and older:
        results["MuJoCo 3"] = measure(peers, "mujoco_adapter", "MuJoCo3", options.only, older)
    for adapter in options.adapter:
        module, _, name = adapter.partition(":")
        results[name] = measure(here, module, name, options.only)

    tables: List[str] = []
    overview = [f"| case | {' | '.join(results)} |", "|---" * (1 + len(results)) + "|"]
    sums = dict.fromkeys(results, 0)
    total = 0
    for case in CASES:
        if options.only and case.name not in options.only:
            continue
        text, passes = table(case, results)
        tables.append(text)
        count = max(map(len, passes.values()))
        total += count
        for name, rows in passes.items():
            sums[name] += sum(rows)
        overview.append(f"| {case.name} | {' | '.join(f'{sum(rows)} of {count}' for rows in passes.values())} |")
    overview.append(f"| all | {' | '.join(f'{value} of {total}' for value in sums.values())} |")
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    text = "\n".join([f"Machine: {machine}. Rows that are right, of all:\n", *overview, "", *tables])
    if options.only:
        print(text)
        return
    page = options.page.read_text()
    before, _, rest = page.partition(MARKS[0])
    after = rest.partition(MARKS[1])[2]
    options.page.write_text(before + MARKS[0] + text + MARKS[1] + after)


if __name__ == "__main__":
    main()
