"""What goes into the extension's zips: the right wheels for each platform and Python, and never a numpy."""

import sys
import tomllib
import types
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture
def tool(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import build_extension

    return build_extension


@pytest.fixture
def pip(monkeypatch, tool):
    """Stands in for pip: lays an empty wheel down for every requirement, but those that `absent` names."""
    state = types.SimpleNamespace(absent=(), words="", commands=[])

    def run(command, **options):
        state.commands.append(command)
        asked = [word for word in command if "==" in word]
        for requirement in asked:
            name, version = requirement.split("==")
            if name in state.absent:
                return types.SimpleNamespace(returncode=1, stdout="", stderr=state.words.format(requirement))
            Path(command[command.index("--dest") + 1], f"{name}-{version}-py3-none-any.whl").touch()
        return types.SimpleNamespace(returncode=0, stdout="", stderr="")

    monkeypatch.setattr(tool.subprocess, "run", run)
    return state


def targets(tool):
    return [tool.Target(platform, python) for platform in tool.PLATFORMS for python in tool.BLENDERS]


def test_a_zip_has_what_its_blender_lacks_and_no_numpy(tool):
    for target in targets(tool):
        libraries, torch = tool.requirements(target)
        assert {"xatlas", "trimesh", "fast-simplification", "safetensors", "pillow"} <= set(libraries)
        assert ("OpenImageIO" in libraries) == (target.python == "3.11")
        assert "numpy" not in libraries | torch and next(iter(torch)) == "torch"
        assert torch["torch"].endswith("+cpu") == (target.platform == "linux-x64")


def test_the_manifest_names_platform_wheels_and_the_blenders_of_that_python(tool):
    text = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    before = tomllib.loads(text)
    for target in targets(tool):
        made = tomllib.loads(tool.manifest_for(target, text, ["a-1-py3-none-any.whl", "b-2-py3-none-any.whl"]))
        assert made.pop("platforms") == [target.platform]
        assert made.pop("wheels") == ["./wheels/a-1-py3-none-any.whl", "./wheels/b-2-py3-none-any.whl"]
        first, last = made.pop("blender_version_min"), made.pop("blender_version_max", None)
        assert (first, last) == (("4.2.0", "5.1.0") if target.python == "3.11" else ("5.1.0", None))
        assert made == {name: value for name, value in before.items() if name != "blender_version_min"}


def test_wheels_are_asked_for_by_platform_and_python_and_nothing_else_comes_along(tool, pip, tmp_path):
    target = tool.Target("windows-x64", "3.13")
    wheels, torch = tool.collect(target, tmp_path / "wheels", None, with_torch=True)
    assert torch and {wheel.name.partition("-")[0] for wheel in wheels} >= {"xatlas", "torch", "sympy"}
    for command in pip.commands:
        assert {"--no-deps", "--only-binary=:all:"} <= set(command)
        assert command[command.index("--python-version") + 1] == "3.13"
        assert [command[i + 1] for i, word in enumerate(command) if word == "--platform"] == ["win_amd64"]


def test_without_a_pytorch_for_the_platform_the_zip_is_built_without_it_and_says_so(tool, pip, tmp_path, capsys):
    pip.absent, pip.words = ("torch",), "ERROR: No matching distribution found for {}"
    wheels, torch = tool.collect(tool.Target("linux-x64", "3.13"), tmp_path / "wheels", None, with_torch=True)
    assert not torch and wheels
    assert not {"torch", "sympy", "jinja2"} & {wheel.name.partition("-")[0] for wheel in wheels}
    assert "pip finds no torch==" in capsys.readouterr().err


@pytest.mark.parametrize(
    "absent, words",
    [("xatlas", "ERROR: No matching distribution found for {}"), ("torch", "ERROR: connection broken at {}")],
)
def test_any_other_failure_of_pip_ends_the_build(tool, pip, tmp_path, absent, words):
    pip.absent, pip.words = (absent,), words
    with pytest.raises(tool.BuildError, match=f"linux-x64-cp311: pip: .*{absent}==.*; check the network"):
        tool.collect(tool.Target("linux-x64", "3.11"), tmp_path / "wheels", None, with_torch=True)


def test_without_blenders_tool_the_remedy_is_named(tool, pip, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(tool.importlib.util, "find_spec", lambda name: None)
    assert tool.main(["--output", str(tmp_path / "out"), "--python", "3.11", "--without-torch"]) == 1
    assert "has no bpy, whose tool builds the zip; run make first" in capsys.readouterr().err


def test_a_python_of_another_version_is_looked_for_and_its_lack_is_said(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import blender_matrix

    monkeypatch.setattr(blender_matrix.shutil, "which", lambda name: None)
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path))
    assert blender_matrix._base_python("2.7", Path(sys.executable)) == sys.executable
    with pytest.raises(blender_matrix.Failed, match="Python 2.7: not found; name one"):
        blender_matrix._base_python("2.7", None)
