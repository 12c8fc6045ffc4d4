"""Runs the extension's zips in every supported Blender, each as a Python module in an environment of its own.

`make test-blender`. Environments lie in .cache/, made once. Each gets Blender, pytest and nothing of ours: what the
extension runs on comes from its zip, and what our tests need besides lies apart. Standard library only.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from build_extension import ROOT, Target, this_platform

CACHE = ROOT / ".cache"
LIFE = ROOT / "tests" / "blender" / "installed_extension.py"
FOR_TESTS = ("scipy",)
"""What the training needs, which tests/blender try as well; the extension has to do without, so it lies in a folder of
its own."""
LIMIT = 1800
"""Seconds of one step; Blender 4.5 hangs at exit where something stays registered."""


@dataclass(frozen=True)
class Blender:
    """One version as a Python module. Its numpy is what that Blender ships: the module itself asks for any."""

    version: str
    python: str
    numpy: str


MATRIX = (
    Blender("4.2.23", "3.11", "1.26.4"),
    Blender("4.5.15", "3.11", "1.26.4"),
    Blender("5.0.1", "3.11", "1.26.4"),
    Blender("5.2.3", "3.13", "2.5.5"),
)


class Failed(Exception):
    """A step did not do; one line, and its log above it."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--packages", type=Path, default=ROOT / "out" / "extension", metavar="DIR")
    parser.add_argument("--views", type=Path, required=True, metavar="DIR", help="what is reconstructed")
    parser.add_argument("--only", nargs="+", metavar="VERSION", help="such as 4.2; all by default")
    parser.add_argument("--python-313", type=Path, metavar="FILE", help="a Python 3.13 for Blender 5.1 and newer")
    parser.add_argument("--torch-313", type=Path, metavar="DIR", help="what pip --target filled with PyTorch for it")
    args = parser.parse_args()
    chosen = [blender for blender in MATRIX if not args.only or blender.version.startswith(tuple(args.only))]
    failed = []
    for blender in chosen:
        started = time.monotonic()
        try:
            python = environment(blender, args.python_313)
            torch = args.torch_313 if blender.python == "3.13" else None
            said = live(blender, python, args.packages, args.views.resolve(), torch)
        except Failed as error:
            failed.append(blender.version)
            said = f"FAILED: {error}"
        print(f"Blender {blender.version}: {said} ({time.monotonic() - started:.0f} s)", flush=True)
    print(f"{len(chosen) - len(failed)} passed, {len(failed)} failed")
    return 1 if failed or not chosen else 0


def environment(blender: Blender, python_313: Path | None) -> Path:
    """The Python of a virtual environment with that Blender, made where there is none.

    Raises:
        Failed: there is no such Python, or pip failed.
    """
    folder = CACHE / f"bpy-{blender.version}"
    python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    pins = (ROOT / "requirements-dev.txt").read_text(encoding="utf-8").splitlines()
    pytest, *rest = (next(pin for pin in pins if pin.startswith(f"{name}==")) for name in ("pytest", *FOR_TESTS))
    installed = [f"bpy=={blender.version}", f"numpy=={blender.numpy}", pytest]
    mark, content = folder / ".installed", "\n".join([*installed, *rest])
    if mark.is_file() and mark.read_text(encoding="utf-8") == content:
        return python
    shutil.rmtree(folder, ignore_errors=True)
    run([_base_python(blender.python, python_313), "-m", "venv", folder])
    pip = [python, "-m", "pip", "install", "--quiet"]
    run([*pip, *installed])
    run([*pip, "--no-deps", "--target", for_tests(python), *rest])
    mark.write_text(content, encoding="utf-8")
    return python


def for_tests(python: Path) -> Path:
    """The folder of `FOR_TESTS` in the environment of that Python."""
    return python.parents[1] / "for-tests"


def live(blender: Blender, python: Path, packages: Path, views: Path, torch_folder: Path | None) -> str:
    """Install the zip, use it, remove it; then our own tests with the zip's libraries. Returns what was done.

    Args:
        torch_folder: holds PyTorch for a zip that has none.
    Raises:
        Failed: the zip is missing, or a step failed or did not end.
    """
    tag = Target(this_platform(), blender.python).tag
    package = next(packages.glob(f"arm_blender-*-{tag}.zip"), None)
    if package is None:
        raise Failed(f"{packages}: has no zip for {tag}; run make extension")
    torch = any("/torch-" in f"/{name}" for name in _wheels(package))
    with tempfile.TemporaryDirectory(prefix="arm-blender-") as folder:
        place = Path(folder)
        source = "bundled" if torch else torch_folder or "none"
        life = [python, LIFE, package, views, place / "made", "--torch", source]
        (place / "made").mkdir()
        run(life, place / "whole")
        # Whoever closes Blender does not disable what he uses.
        run([*life, "--leave-enabled"], place / "left")
        if not torch:
            return f"lives with {torch_folder}" if torch_folder else "lives up to the missing PyTorch"
        site = next((place / "left" / "extensions" / ".local").glob("**/site-packages"))
        tests = [python, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/blender"]
        run(tests, place / "tests", [site, for_tests(python)])
    return "lives, and passes the tests"


def run(command: list, resources: Path | None = None, libraries: Sequence[Path] = ()) -> None:
    """One step, in `resources` as the user's folder of Blender, with folders of `libraries`.

    Raises:
        Failed: it ended with another status than 0, or not in time.
    """
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
    if resources is not None:
        resources.mkdir()
        environment["BLENDER_USER_RESOURCES"] = str(resources)
    if libraries:
        environment["PYTHONPATH"] = os.pathsep.join(map(str, libraries))
    words = [str(word) for word in command]
    try:
        done = subprocess.run(
            words, cwd=ROOT, env=environment, capture_output=True, text=True, errors="replace", timeout=LIMIT
        )
    except subprocess.TimeoutExpired as error:
        raise Failed(f"{' '.join(words)}: did not end within {LIMIT} s") from error
    if done.returncode != 0:
        print(done.stdout, done.stderr, sep="\n", file=sys.stderr)
        raise Failed(f"{' '.join(words)}: status {done.returncode}")


def _wheels(package: Path) -> list[str]:
    """The names of a zip's wheels, by its manifest."""
    manifest = tomllib.loads(zipfile.ZipFile(package).read("blender_manifest.toml").decode())
    return [Path(wheel).name for wheel in manifest.get("wheels", [])]


def _base_python(version: str, named: Path | None) -> str:
    """A Python of that version.

    Raises:
        Failed: there is none.
    """
    if version == f"{sys.version_info.major}.{sys.version_info.minor}":
        return sys.executable
    root = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"), "versions")
    candidates = [named, shutil.which(f"python{version}"), *sorted(root.glob(f"{version}*/bin/python{version}"))]
    for candidate in candidates:
        if candidate is None:
            continue
        # pyenv puts a script in the place of every Python, which fails where that one is not chosen.
        done = subprocess.run([candidate, "-c", "import ensurepip, venv"], capture_output=True)
        if done.returncode == 0:
            return str(candidate)
    raise Failed(f"Python {version}: not found; name one: make test-blender PYTHON_313=...")


if __name__ == "__main__":
    sys.exit(main())
