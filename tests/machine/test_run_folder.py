"""A killed program leaves nothing in the folder of temporary files that the next one does not take away."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

BEGIN = """
import tempfile
from arm_blender.machine.run_folder import keep_temporary_files_together
keep_temporary_files_together()
made = tempfile.mkdtemp(prefix="work-")
"""
WAIT = """
print(made, flush=True)
input()
"""


def started(code: str, place: Path) -> tuple[subprocess.Popen, Path]:
    """A process, and the folder that it says it has made."""
    environment = os.environ | {"TMPDIR": str(place), "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [sys.executable, "-c", code], env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    return process, Path(process.stdout.readline().strip())


def ended(process: subprocess.Popen) -> None:
    process.communicate("\n", timeout=60)
    assert process.returncode == 0


@pytest.mark.skipif(sys.platform == "win32", reason="without locks it takes a day")
def test_what_a_kill_leaves_is_taken_away_by_the_next_and_nothing_of_a_live_one(tmp_path):
    (tmp_path / "blender_others").mkdir()
    killed, left = started(BEGIN + WAIT, tmp_path)
    live, kept = started(BEGIN + WAIT, tmp_path)
    killed.kill()
    killed.communicate()
    assert left.is_dir()
    third, own = started(BEGIN + WAIT, tmp_path)
    assert not left.exists() and not left.parent.exists() and kept.is_dir() and own.is_dir()
    ended(third)
    assert not own.exists() and kept.is_dir()
    ended(live)
    assert [path.name for path in tmp_path.iterdir()] == ["blender_others"], "of others nothing is touched"


@pytest.mark.blender
@pytest.mark.parametrize("kill", [True, False])
def test_the_folder_that_blender_makes_lies_in_ours(tmp_path, kill):
    code = "import bpy; bpy.ops.wm.read_factory_settings(use_empty=True); made = bpy.app.tempdir"
    process, made = started(BEGIN + code + WAIT, tmp_path)
    assert made.is_dir() and made.is_relative_to(tmp_path) and made.parent != tmp_path
    if kill:
        process.kill()
        process.communicate()
        process, _ = started(BEGIN + WAIT, tmp_path)
    ended(process)
    assert list(tmp_path.iterdir()) == []


def test_without_a_place_nothing_changes(tmp_path):
    place = tmp_path / "full"
    place.mkdir()
    (place / "arm-somebody").write_text("a file")
    code = "import getpass; getpass.getuser = lambda: 'somebody'" + BEGIN + WAIT
    process, made = started(code, place)
    assert made.parent == place
    ended(process)
