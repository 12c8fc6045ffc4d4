"""The command finish, on a folder as a run leaves it; there is no Blender here but where a test asks for it."""

import json

import pytest
import torch

from arm_blender.export import write_asset
from arm_blender.knobs.finishes import PRESETS
from arm_blender.report import Report
from arm_blender.structures import MaterialMaps, Regions, RelightableAsset
from arm_blender.uv.finish import chosen_finishes

from ..blender.conftest import torus
from .command_line import only_line, run


@pytest.fixture
def folder(tmp_path):
    index = torch.ones(16, 16, dtype=torch.uint8)
    index[8:] = 2
    regions = Regions(index, (0.5, 0.5), ((0.2, 0.4, 0.6), (0.5, 0.5, 0.5)))
    report = Report("small", "cpu", 0, name="ring", charts=1)
    maps = MaterialMaps(torch.full((3, 16, 16), 0.5), torch.full((3, 16, 16), 0.6), 0.4, 0.0, None, regions)
    asset = RelightableAsset("ring", torus(12, 8), chosen_finishes(maps, None, report))
    write_asset(asset, report, tmp_path / "ring")
    return tmp_path / "ring"


def finishes_in(folder) -> list[str | None]:
    return [one["finish"] for one in json.loads((folder / "report.json").read_text())["regions"]]


def test_finishes_add_up_until_they_are_taken_back(folder, capsys):
    assert run("finish", folder, "--set", "2=chrome") == 0 and finishes_in(folder) == [None, "chrome"]
    assert run("finish", folder, "--set", "1=0.3/1") == 0 and finishes_in(folder) == ["0.3/1", "chrome"]
    assert run("finish", folder, "--reset", "--set", "1=wood") == 0 and finishes_in(folder) == ["wood", None]
    assert run("finish", folder / "ring.glb", "--reset") == 0 and finishes_in(folder) == [None, None]
    assert not (folder / "textures" / "predicted").exists()
    assert "as predicted" in capsys.readouterr().out


def test_without_a_finish_the_regions_are_listed_and_nothing_is_written(folder, capsys):
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    assert run("finish", folder, "--json") == 0
    assert [one["number"] for one in json.loads(capsys.readouterr().out)] == [1, 2]
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


@pytest.mark.parametrize(
    ("words", "status", "line"),
    [
        (["--set", "3=chrome"], 1, "has no region 3; regions.png shows 1 to 2"),
        (["--set", "2=chrom"], 2, "--set 'chrom': is no finish; give one of"),
        (["--set", "chrome"], 2, "give its number, 1 to 8, as in"),
    ],
    ids=["beyond", "unknown", "no number"],
)
def test_what_does_not_fit_is_one_line_and_changes_nothing(folder, capsys, words, status, line):
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    assert run("finish", folder, *words) == status
    assert line in only_line(capsys.readouterr().err)
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


def test_a_folder_that_holds_no_asset_is_one_line(tmp_path, capsys):
    assert run("finish", tmp_path, "--set", "1=gold") == 1
    assert "holds no whole asset" in only_line(capsys.readouterr().err)


@pytest.mark.blender
def test_the_blend_is_written_anew_with_what_it_was_made_of(folder, tmp_path):
    from arm_blender.blender.asset import blend_file
    from arm_blender.export.asset_folder import read_asset

    blend_file.save_blend(read_asset(folder).asset, folder / "ring.blend", {"preset": "small", "seed": 7})
    before = (folder / "ring.blend").read_bytes()
    assert run("finish", folder, "--set", "1=gold") == 0
    assert (folder / "ring.blend").read_bytes() != before
    assert (folder / "ring.blend1").read_bytes() == before
    assert blend_file.kept_settings(folder / "ring.blend") == {"preset": "small", "seed": 7, "finish": "1=gold"}
    assert PRESETS["gold"].metallic == 1.0
