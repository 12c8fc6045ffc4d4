"""The folder of six views: read back by the ordinary reader, drawn anew in parts, whole or as it was."""

import json
import os
from pathlib import Path

import pytest
import torch

from arm_blender.errors import InputImageError, OutputError
from arm_blender.graphics.color import srgb_from_linear
from arm_blender.views import load_views
from arm_blender.views.image_io import read_image, write_png
from arm_blender.views.rigs import zero123plus_rig
from arm_blender.views.zero123plus import view_folder
from arm_blender.views.zero123plus.view_folder import check_folder, read_seeds, write_views

SIDE = 32
CAMERAS = zero123plus_rig(3.5, 30.0, SIDE)
SEEDS = (4,) * 6


def disc(index: int) -> torch.Tensor:
    """(32, 32) bool: a disc, another one in each view."""
    rows, columns = torch.meshgrid(torch.arange(SIDE) + 0.5, torch.arange(SIDE) + 0.5, indexing="ij")
    return (rows - 16.0) ** 2 + (columns - 13.0 - index) ** 2 < 64.0


def drawn(index: int, background: float = 127.0 / 255.0, shade: float = 0.9) -> torch.Tensor:
    """(3, 32, 32) sRGB, as the network draws: an object on a plain ground that is not quite even."""
    noise = 0.02 * (torch.rand(3, SIDE, SIDE, generator=torch.Generator().manual_seed(index)) - 0.5)
    return (torch.where(disc(index), torch.tensor([shade, 0.2, 0.1])[:, None, None], background) + noise).clamp(0, 1)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "out" / "views"
    write_views(folder, {index: drawn(index) for index in range(6)}, CAMERAS, SEEDS, steps=28)
    return folder


@pytest.mark.parametrize("background", [127.0 / 255.0, 1.0], ids=["grey", "white"])
def test_the_folder_reads_back_through_the_ordinary_reader(tmp_path, background):
    folder = tmp_path / "views"
    write_views(folder, {index: drawn(index, background) for index in range(6)}, CAMERAS, SEEDS)
    assert sorted(contents(folder)) == [*(f"{index}.png" for index in range(6)), "transforms.json"]
    views = load_views(folder)
    for index, (camera, expected) in enumerate(zip(views.cameras, CAMERAS, strict=True)):
        assert torch.equal(views.images[index, 3] > 0.5, disc(index))
        color = srgb_from_linear(views.images[index, :3])[:, disc(index)]
        torch.testing.assert_close(color, drawn(index, background)[:, disc(index)], rtol=0.0, atol=0.51 / 255.0)
        torch.testing.assert_close(camera.c2w, expected.c2w)
        torch.testing.assert_close(camera.K, expected.K)


def test_the_folder_says_how_each_view_was_made(folder):
    assert read_seeds(folder) == SEEDS
    frames = json.loads((folder / "transforms.json").read_text())["frames"]
    assert [frame["zero123plus"] for frame in frames] == [{"seed": 4, "steps": 28}] * 6


def test_a_view_whose_background_is_not_plain_is_there_to_be_looked_at(tmp_path):
    busy = torch.rand(3, SIDE, SIDE, generator=torch.Generator().manual_seed(0))
    folder = tmp_path / "views"
    write_views(folder, {index: busy if index == 4 else drawn(index) for index in range(6)}, CAMERAS, SEEDS)
    torch.testing.assert_close(srgb_from_linear(read_image(folder / "4.png")[:3]), busy, rtol=0.0, atol=0.51 / 255.0)
    with pytest.raises(InputImageError, match="4.png: no foreground found"):
        load_views(folder)


def test_what_the_user_changed_stays_when_other_views_are_drawn_anew(folder):
    edited = torch.cat([torch.full((3, SIDE, SIDE), 0.5), disc(0)[None].float()])
    write_png(folder / "1.png", edited, srgb=True)
    (folder / "notes.txt").write_text("the handle")
    data = json.loads((folder / "transforms.json").read_text())
    data["frames"][1]["weight"] = 3.0
    (folder / "transforms.json").write_text(json.dumps(data))
    before = contents(folder)
    write_views(folder, {index: drawn(index, shade=0.4) for index in (0, 5)}, CAMERAS, (9, 4, 4, 4, 4, 9))
    after = contents(folder)
    assert {name for name in after if after[name] != before[name]} == {"0.png", "5.png", "transforms.json"}
    assert read_seeds(folder) == (9, 4, 4, 4, 4, 9)
    views = load_views(folder)
    assert views.weights.tolist() == [1.0, 3.0, 1.0, 1.0, 1.0, 1.0]
    assert torch.equal(views.images[1, 3] > 0.5, disc(0))
    for index, camera in enumerate(views.cameras):
        torch.testing.assert_close(camera.c2w, CAMERAS[index].c2w)
        torch.testing.assert_close(camera.K, CAMERAS[index].K)


@pytest.mark.parametrize("fails", ["write_png", "write_transforms", "replace_folder", "rename"])
@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_a_folder_that_cannot_be_finished_is_as_it_was(folder, monkeypatch, fails, error):
    before = contents(folder)
    real = os.rename

    def broken(source, target, *_, **__):
        if fails == "rename" and (target != folder or source.name == "older"):
            return real(source, target)  # The older folder goes aside and comes back; the new one finds no place.
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(os if fails == "rename" else view_folder, fails, broken)
        with pytest.raises((KeyboardInterrupt, OutputError)):
            write_views(folder, {index: drawn(0) for index in range(6)}, CAMERAS, SEEDS)
    assert contents(folder) == before
    assert [path.name for path in folder.parent.iterdir()] == ["views"]


def test_nothing_is_left_of_a_first_folder_that_cannot_be_finished(tmp_path, monkeypatch):
    monkeypatch.setattr(view_folder, "write_png", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_views(tmp_path / "out" / "views", {index: drawn(index) for index in range(6)}, CAMERAS, SEEDS)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_seeds_cannot_keep_views(folder, tmp_path):
    data = json.loads((folder / "transforms.json").read_text())
    del data["frames"][5]["zero123plus"]
    (folder / "transforms.json").write_text(json.dumps(data))
    for path in (folder, tmp_path / "nothing"):
        with pytest.raises(InputImageError, match=f"{path.name}: .*without --reseed"):
            read_seeds(path)


def test_a_file_in_the_folders_place_is_named(tmp_path):
    (tmp_path / "views").write_text("")
    with pytest.raises(OutputError, match="views: is a file"):
        check_folder(tmp_path / "views")
