"""What a change can touch."""

import functools
import json
import pathlib
import re
import subprocess

from plan import ROOT

# Changes of these reach everything.
EVERYWHERE = ("Cargo.toml", "Cargo.lock", ".cargo/", "scripts/setup", "tests/suite/", "third_party/")
# Folders and files that sources may name.
NAMED = (
    *("docs", "resources", "python", "scripts", "tests/corpus", "tests/regressions", "tests/traces"),
    *("README.md", "CONTRIBUTING.md", "ARCHITECTURE.md", "CHANGELOG.md"),
)
# What tests of Python share.
SHARED = ("tests/ros/", "tests/waiting.py", "tests/domains.py")


def git(*words):
    """Lines that git prints."""
    return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True, text=True).stdout.splitlines()


def files(base):
    """Files that differ from the commit at which this branch left `base`, with those that git does not know yet."""
    left = git("merge-base", "HEAD", base)[0]
    return sorted({*git("diff", "--name-only", left), *git("ls-files", "--others", "--exclude-standard")})


@functools.cache
def packages():
    """Folder of each package of the workspace, and the folders of all packages of the workspace that it is made of, with itself."""
    found = json.loads(
        subprocess.run(
            ["cargo", "metadata", "--format-version", "1", "--no-deps"],
            cwd=ROOT,
            check=True,
            capture_output=True,
            text=True,
        ).stdout
    )["packages"]
    folder = {
        package["name"]: str(pathlib.Path(package["manifest_path"]).parent.relative_to(ROOT)) for package in found
    }
    uses = {package["name"]: {d["name"] for d in package["dependencies"] if d["name"] in folder} for package in found}

    def closure(name, seen):
        if name not in seen:
            seen.add(name)
            for used in uses[name]:
                closure(used, seen)
        return seen

    return {folder[name]: {folder[used] for used in closure(name, set())} for name in folder}


@functools.cache
def text_of(folder):
    """All sources below a folder."""
    paths = [path for kind in ("*.rs", "*.py") for path in sorted((ROOT / folder).rglob(kind))]
    return "\n".join(path.read_text(errors="replace") for path in paths)


def named(folders, file):
    """Whether sources in `folders` name the top folder of `file`, or the file in it."""
    top = next((name for name in NAMED if f"{file}/".startswith(f"{name}/")), None)
    if top is None:
        return False
    # A page is read by its own name, or with all pages of the folder.
    page = rf"/{re.escape(pathlib.Path(file).name)}\b|[\"/]docs\""
    pattern = page if top == "docs" else rf"[\"/]{re.escape(top)}\b"
    return any(re.search(pattern, text_of(folder)) for folder in folders)


def touches(file, job):
    """Whether a change of `file` can change what `job` finds."""
    if file.startswith(EVERYWHERE):
        return True
    python = file.endswith(".py") or file.startswith("python/")
    owner = max((folder for folder in packages() if file.startswith(f"{folder}/")), key=len, default=None)
    if job.name == "format" or job.name.startswith(("lints", "documentation", "examples in")):
        return owner is not None
    if job.name.startswith("Python "):
        return python
    parts = job.name.split()
    if file.endswith(".py") and pathlib.Path(file).name.startswith("test_"):
        return len(parts) > 1 and file == f"{parts[0]}/{parts[1]}.py"
    if parts[0] in packages():
        return owner in packages()[parts[0]] or named(packages()[parts[0]], file)
    # What remains starts the simulator, or the module, from Python.
    folder = "python/benchmarks" if parts[0] == "soak" else parts[0]
    # Tests of one package of Python use the others.
    if file.startswith((f"{folder}/", *SHARED, *(("python/",) if folder.startswith("python/") else ()))):
        return True
    own = "python/ambf" if parts[0] == "python/ambf/tests" else "ambf-app"
    if owner in packages()[own] | {"python/ambf"} and not python:
        return True
    return named((folder, *packages()["ambf-app"]), file)
