"""What goes into the extension's zips: the right wheels for each platform and Python, and never a numpy."""

import sys
import tomllib
import types
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


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


@pytest.mark.parametrize("words", ["No matching distribution found for {}", "ResolutionImpossible: {}", ""])
def test_without_a_pytorch_for_the_platform_the_zip_is_built_without_it_and_says_so(tool, pip, tmp_path, capsys, words):
    pip.absent, pip.words = ("torch",), f"ERROR: {words}"
    wheels, torch = tool.collect(tool.Target("linux-x64", "3.13"), tmp_path / "wheels", None, with_torch=True)
    assert not torch and wheels
    assert not {"torch", "sympy", "jinja2"} & {wheel.name.partition("-")[0] for wheel in wheels}
    said = capsys.readouterr().err
    assert words.format("torch==2.13.0+cpu") in said and "--torch-index may name a place" in said


@pytest.mark.parametrize(
    "absent, index, words",
    [
        ("xatlas", None, "ERROR: No matching distribution found for {}"),
        ("sympy", None, "ERROR: No matching distribution found for {}"),
        ("torch", "https://example.org/whl", "ERROR: No matching distribution found for {}"),
        ("torch", "https://example.org/whl", "ERROR: connection broken at {}"),
    ],
)
def test_any_other_failure_of_pip_ends_the_build(tool, pip, tmp_path, absent, index, words):
    pip.absent, pip.words = (absent,), words
    with pytest.raises(tool.BuildError, match=f"linux-x64-cp311: pip: .*{absent}==.*; check the network"):
        tool.collect(tool.Target("linux-x64", "3.11"), tmp_path / "wheels", index, with_torch=True)


@pytest.mark.parametrize("by_variable", [True, False])
def test_pips_constraints_do_not_change_what_is_built(tool, tmp_path, monkeypatch, by_variable):
    """The real pip, a folder in the place of its index, and constraints that exclude what is asked for."""
    target = tool.Target("linux-x64", "3.13")
    libraries, torch = tool.requirements(target)
    for name, version in libraries.items():
        wheel(tmp_path, name.replace("-", "_"), version)
    (tmp_path / "constraints.txt").write_text("xatlas<=0.0.1\ntorch<=2.14.1\n", encoding="utf-8")
    config = tmp_path / "pip.conf"
    config.write_text("[global]\n" + f"constraint = {tmp_path / 'constraints.txt'}\n" * (not by_variable))
    monkeypatch.setenv("PIP_CONFIG_FILE", str(config))
    monkeypatch.setenv("PIP_CONSTRAINT", str(tmp_path / "constraints.txt") if by_variable else "")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    wheels, torch = tool.collect(target, tmp_path / "wheels", None, with_torch=True)
    assert not torch and len(wheels) == len(libraries)


def wheel(folder: Path, name: str, version: str) -> None:
    """One without content."""
    with zipfile.ZipFile(folder / f"{name}-{version}-py3-none-any.whl", "w") as archive:
        about = f"{name}-{version}.dist-info"
        archive.writestr(f"{about}/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
        archive.writestr(f"{about}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        archive.writestr(f"{about}/RECORD", "")


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


def test_an_environment_is_made_anew_when_its_pins_change_and_gets_what_the_tests_need_apart(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import blender_matrix

    commands = []

    def run(command, **options):
        commands.append([str(word) for word in command])
        if "venv" in command:
            command[-1].mkdir()

    monkeypatch.setattr(blender_matrix, "CACHE", tmp_path)
    monkeypatch.setattr(blender_matrix, "run", run)
    blender = blender_matrix.Blender("5.0.1", f"{sys.version_info.major}.{sys.version_info.minor}", "1.26.4")
    python = blender_matrix.environment(blender, None)
    (target,) = [command for command in commands if "--target" in command]
    assert target[-1].startswith("scipy==")
    assert target[target.index("--target") + 1] == str(blender_matrix.for_tests(python))
    assert not [word for command in commands if command is not target for word in command if word.startswith("scipy")]
    made = len(commands)
    assert blender_matrix.environment(blender, None) == python and len(commands) == made
    (tmp_path / "bpy-5.0.1" / ".installed").write_text("", encoding="utf-8")  # As those made before.
    assert blender_matrix.environment(blender, None) == python and len(commands) == 2 * made
