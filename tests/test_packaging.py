"""What the project's files say of its version and of what it needs agrees."""

import tomllib
from pathlib import Path

from arm_blender.commands import doctor
from arm_blender.version import VERSION

ROOT = Path(__file__).parents[1]


def test_every_place_that_states_the_version_agrees():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert manifest["version"] == VERSION


def test_every_dependency_is_pinned():
    """What `make` installs covers what the package declares, each at one exact version."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pins = {}
    for name in ("requirements.txt", "requirements-dev.txt"):
        for line in (ROOT / name).read_text(encoding="utf-8").splitlines():
            if line and line[0] not in "#-":
                package, _, version = line.partition("==")
                pins[package.lower()] = version
    assert all(pins.values())
    extras = project["optional-dependencies"].values()
    declared = [*project["dependencies"], *(entry for extra in extras for entry in extra)]
    assert {entry.partition(">=")[0].lower() for entry in declared} == set(pins)


def test_the_doctor_asks_for_every_dependency():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {entry.partition(">=")[0].lower() for entry in project["dependencies"]} == {
        package.lower() for package in doctor._REQUIRED
    }
