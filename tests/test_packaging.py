"""What the project's files say of its version and of what it needs agrees."""

import fnmatch
import importlib.util
import tomllib
from pathlib import Path

from arm_blender.machine import libraries
from arm_blender.version import VERSION
from arm_blender.weight_files import checkpoints

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


def test_the_libraries_looked_for_are_the_dependencies():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {entry.partition(">=")[0].lower() for entry in project["dependencies"]} == {
        package.lower() for package in libraries.REQUIRED
    }


def test_weights_of_others_leave_in_no_package():
    """Who imports them keeps them: git, the extension's zip and the wheel pass them over, and only them."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    wheel = project["tool"]["setuptools"]["exclude-package-data"]["arm_blender"]
    passed_over = {
        ".gitignore": (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines(),
        "zip": manifest["build"]["paths_exclude_pattern"],
        "wheel": [f"/arm_blender/{pattern}" for pattern in wheel],
    }
    for weights in checkpoints.REGISTRY:
        path = f"/arm_blender/weights/{weights.file_name}"
        for place, patterns in passed_over.items():
            ours = weights.licence in ("GPL-3.0-or-later", "your own")
            assert any(fnmatch.fnmatch(path, pattern) for pattern in patterns) != ours, f"{place}: {weights.name}"
            recorded = any(fnmatch.fnmatch(path + checkpoints.SUM, pattern) for pattern in patterns)
            assert recorded or ours, f"{place}: the hash of {weights.name}"


def test_the_example_leaves_in_the_zip_and_in_the_wheel():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    patterns = project["tool"]["setuptools"]["package-data"]["arm_blender"]
    example = ROOT / "arm_blender" / "examples" / "barrel"
    files = sorted(example.iterdir())
    assert [path.name for path in files] == [*(f"{view:03}.png" for view in range(6)), "transforms.json"]
    for path in files:
        inside = path.relative_to(ROOT / "arm_blender")
        assert any(inside.match(pattern) for pattern in patterns), inside
        for pattern in manifest["build"]["paths_exclude_pattern"]:
            assert not fnmatch.fnmatch(f"/arm_blender/{inside.as_posix()}", pattern), pattern
            assert not f"/arm_blender/{inside.as_posix()}".startswith(pattern), pattern


def test_a_checkout_may_have_any_name():
    spec = importlib.util.spec_from_file_location("__init__", ROOT / "__init__.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert not hasattr(module, "register")  # As pytest imports it where the folder's name is no package's.
