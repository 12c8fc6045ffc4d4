"""The training command line: it finds its modules, imports no more than it needs, and fails in one line."""

import argparse
import ast
import importlib
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import training.__main__ as command
from arm_blender.errors import InputImageError

ROOT = Path(command.__file__).parents[1]


def run_python(code: str) -> str:
    environment = dict(os.environ, PYTHONPATH=str(ROOT))
    return subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    ).stdout


@pytest.fixture
def fake_stage(monkeypatch):
    """A stage whose `run` does what the test says; records the arguments."""
    stage = SimpleNamespace(__doc__="A stage.\n\nMore.", seen=None, action=lambda args: 0)

    def add_arguments(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--data", type=Path)
        parser.add_argument("--steps", type=int, default=1)

    def run(args: argparse.Namespace) -> int:
        stage.seen = args
        return stage.action(args)

    stage.add_arguments, stage.run = add_arguments, run
    importing = importlib.import_module
    monkeypatch.setattr(
        importlib,
        "import_module",
        lambda name: stage if name == command.STAGES["georm-outlines"][0] else importing(name),
    )
    monkeypatch.delenv("ARM_DATA", raising=False)
    return stage


def test_a_stage_gets_its_arguments_and_its_status_is_returned(fake_stage, tmp_path):
    fake_stage.action = lambda args: 3
    assert command.main(["fit", "georm-outlines", "--data", str(tmp_path), "--steps", "7"]) == 3
    assert (fake_stage.seen.data, fake_stage.seen.steps) == (tmp_path, 7)


def test_the_data_folder_comes_from_the_environment_unless_it_is_given(fake_stage, monkeypatch, tmp_path):
    monkeypatch.setenv("ARM_DATA", str(tmp_path))
    command.main(["fit", "georm-outlines"])
    assert fake_stage.seen.data == tmp_path
    command.main(["fit", "georm-outlines", "--data", "elsewhere"])
    assert fake_stage.seen.data == Path("elsewhere")


def test_a_users_error_is_one_line_and_status_one(fake_stage, capsys):
    def fail(args: argparse.Namespace) -> int:
        raise InputImageError("mug.png: no foreground found")

    fake_stage.action = fail
    assert command.main(["fit", "georm-outlines"]) == 1
    assert capsys.readouterr().err.splitlines() == [
        "python -m training fit georm-outlines: mug.png: no foreground found"
    ]


def test_a_bug_keeps_its_traceback(fake_stage):
    def fail(args: argparse.Namespace) -> int:
        raise ValueError("shape")

    fake_stage.action = fail
    with pytest.raises(ValueError, match="shape"):
        command.main(["fit", "georm-outlines"])


@pytest.mark.parametrize(
    "words", [[], ["paint"], ["fit"], ["fit", "paint"], ["fit", "georm-outlines", "--steps", "many"]]
)
def test_bad_usage_is_status_two(fake_stage, words, capsys):
    assert command.main(words) == 2
    assert "usage: python -m training" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--help"], ["fit", "--help"], ["fit", "georm-outlines", "--help"]])
def test_help_is_status_zero(fake_stage, words, capsys):
    assert command.main(words) == 0
    assert "usage: python -m training" in capsys.readouterr().out


def test_listing_the_commands_imports_nothing_heavy():
    code = (
        "import sys, training.__main__ as m\n"
        "m.main(['--help'])\n"
        "print([name for name in ('torch', 'bpy', 'scipy', 'numpy') if name in sys.modules])"
    )
    assert run_python(code).splitlines()[-1] == "[]"


@pytest.mark.parametrize("module", [name for name, _ in (command.COMMANDS | command.STAGES).values()])
def test_every_command_keeps_the_contract(module):
    path = ROOT.joinpath(*module.split(".")).with_suffix(".py")
    tree = ast.parse(path.read_text(encoding="utf-8"))
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    for name in ("add_arguments", "run"):
        assert len(functions[name].args.args) == 1
    assert ast.unparse(functions["run"].returns) == "int"
