"""Whatever bytes a file has: a result, or one line that says what is wrong. `make fuzz` tries many more."""

import random
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from arm_blender.errors import ArmError

ROOT = Path(__file__).parents[1]
FORMATS = ["PNG", "JPEG", "WebP", "TIFF", "EXR", "HDR", "GLB", "OBJ", "PLY", "STL", "transforms.json", "safetensors"]
FORMATS += ["weights of others", "list.json", "list.csv"]

few = settings(
    max_examples=25,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@pytest.fixture
def tools(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import damaged_files
    import mutations

    return damaged_files.FORMATS, mutations.mutated


def ends_well(read, content: bytes, folder: Path) -> None:
    try:
        read(content, folder)
    except ArmError as error:
        assert len(str(error).splitlines()) == 1


def test_every_format_is_here(tools):
    assert sorted(tools[0]) == sorted(FORMATS)


@pytest.mark.parametrize("name", FORMATS)
def test_good_files_are_read(tools, tmp_path, name):
    for content in tools[0][name].make(tmp_path):
        assert tools[0][name].read(content, tmp_path) is not None


@pytest.mark.parametrize("name", FORMATS)
@few
@given(seed=st.integers(0, 2**32))
def test_a_damaged_file_is_read_or_refused_in_a_line(tools, tmp_path, name, seed):
    formats, mutated = tools
    generator = random.Random(seed)
    ends_well(formats[name].read, mutated(generator.choice(formats[name].make(tmp_path)), generator), tmp_path)


@pytest.mark.parametrize("name", FORMATS)
@few
@given(content=st.binary(max_size=200))
def test_any_bytes_are_read_or_refused_in_a_line(tools, tmp_path, name, content):
    tools[0][name].make(tmp_path)
    ends_well(tools[0][name].read, content, tmp_path)


LINES = """v 0 0 0, v 1 0 0, v nan 1 0, v 1e30 1 1, v, vt 0 0, vt 1, vn 0 0 1, f 1 2 3, f 1/1 2/2 3/3, f -1 -2 -3,
f 1 2 3 4 5, f 0 1 2, f 9 9 9, f 1//1 2//2 3//3, f, f 1/2/3/4 1 2, usemtl a, o b, g, l 1 2, p 1, #, s off,
mtllib ../../x"""


@few
@given(words=st.lists(st.sampled_from([line.strip() for line in LINES.split(",")]), max_size=20))
def test_any_lines_of_an_obj_are_read_or_refused(tools, tmp_path, words):
    ends_well(tools[0]["OBJ"].read, "\n".join(words).encode(), tmp_path)
