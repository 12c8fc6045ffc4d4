"""Files are whole or absent, and an output that cannot be is refused before any work."""

import json

import pytest

from arm_blender import files
from arm_blender.errors import OutputError


def test_a_write_that_fails_leaves_the_older_file(tmp_path):
    path = tmp_path / "report.json"
    files.write_json(path, {"old": True})
    with pytest.raises(ValueError):
        files.write_json(path, {"bad": float("nan")})
    with pytest.raises(RuntimeError), files.whole_file(path) as temporary:
        temporary.write_text("half of it")
        raise RuntimeError
    assert json.loads(path.read_text()) == {"old": True}
    assert list(tmp_path.iterdir()) == [path]


def test_an_output_that_cannot_be_is_refused_before_anything_is_made(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file: is a file"):
        files.check_output(tmp_path / "file" / "deeper" / "out")
    files.check_output(tmp_path / "a" / "b")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
