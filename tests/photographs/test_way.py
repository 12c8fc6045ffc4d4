"""Views of solved cameras are kept: a painted mask has them made anew, and solves nothing."""

import pytest
import torch

from arm_blender.photographs import way
from arm_blender.photographs.cameras.solving import SolvingOptions
from arm_blender.photographs.clean_views import CleaningOptions
from arm_blender.photographs.solved import SOLVED
from arm_blender.progress import silent
from arm_blender.report import Report
from arm_blender.views import load_views
from arm_blender.views.image_io import read_image, write_png

from .quick_solver import photographs, solve_quickly


@pytest.fixture
def shoe(tmp_path):
    return photographs(tmp_path / "shoe")


@pytest.fixture
def solutions(shoe, monkeypatch):
    """How often cameras were solved."""
    return solve_quickly(monkeypatch, shoe)


def made(shoe, folder, views: int = 16) -> Report:
    report = Report("small", "cpu", 0)
    report.photographs = way.solved_views(
        shoe, folder, SolvingOptions(), CleaningOptions(views=views), silent, report.leave_out, report.note_mask
    )
    return report


def test_what_was_said_of_pictures_is_said_again(tmp_path, shoe, solutions):
    first, second = made(shoe, tmp_path / "views"), made(shoe, tmp_path / "views")
    assert len(solutions) == 1 and second.photographs["reused"] is True and "reused" not in first.photographs
    assert first.masks == second.masks and first.left_out == second.left_out
    assert first.masks["small network"] == ["IMG_0000.png", "IMG_0001.png", "IMG_0002.png"]
    assert any("several parts" in why for why in second.all_doubts)


def test_a_painted_mask_has_views_made_anew_and_nothing_solved(tmp_path, shoe, solutions):
    folder = tmp_path / "views"
    made(shoe, folder)
    before = {name: (folder / f"{name}.png").read_bytes() for name in ("IMG_0000", "IMG_0001")}
    side = read_image(folder / "IMG_0001.png").shape[1]
    painted = torch.zeros(1, side, side)
    painted[:, side // 4 : side // 2, side // 4 : side // 2] = 1.0
    (folder / "masks").mkdir()
    write_png(folder / "masks" / "IMG_0001.png", painted, srgb=False)
    report = made(shoe, folder)
    assert len(solutions) == 1 and report.photographs["reused"] is True
    assert report.masks == {"small network": ["IMG_0000.png", "IMG_0002.png"], "painted mask": ["IMG_0001.png"]}
    assert not report.all_doubts, "the doubt was about the mask that was found"
    assert float((read_image(folder / "IMG_0001.png")[3] - painted[0]).abs().mean()) < 0.01
    assert (folder / "IMG_0000.png").read_bytes() == before["IMG_0000"], "the others are as they were"
    assert load_views(folder).ground == pytest.approx(-0.6)
    made(shoe, folder)
    (folder / "masks" / "IMG_0001.png").unlink()
    report = made(shoe, folder)
    assert len(solutions) == 1 and "painted mask" not in report.masks and report.all_doubts
    assert (folder / "IMG_0001.png").read_bytes() == before["IMG_0001"]


def test_another_number_of_views_solves_nothing(tmp_path, shoe, solutions):
    folder = tmp_path / "views"
    made(shoe, folder)
    whole = len(load_views(folder).cameras)
    made(shoe, folder, views=whole - 1)
    assert len(load_views(folder).cameras) == whole - 1
    assert made(shoe, folder).photographs["reused"] is True
    assert len(load_views(folder).cameras) == whole and len(solutions) == 1


def test_other_pictures_are_solved_anew(tmp_path, shoe, solutions):
    made(shoe, tmp_path / "views")
    (shoe / "IMG_0003.png").unlink()
    made(shoe, tmp_path / "views")
    assert len(solutions) == 2


def test_a_mask_beside_a_photograph_is_another_picture(tmp_path, shoe, solutions):
    made(shoe, tmp_path / "views")
    write_png(shoe / "IMG_0002.mask.png", torch.ones(1, 60, 80), srgb=False)
    made(shoe, tmp_path / "views")
    assert len(solutions) == 2


def test_views_of_an_earlier_version_are_taken_as_they_are(tmp_path, shoe, solutions):
    folder = tmp_path / "views"
    made(shoe, folder)
    (folder / SOLVED).write_text('{"cameras": {}}')
    side = read_image(folder / "IMG_0001.png").shape[1]
    (folder / "masks").mkdir()
    write_png(folder / "masks" / "IMG_0001.png", torch.ones(1, side, side), srgb=False)
    assert made(shoe, folder).photographs["reused"] is True and len(solutions) == 1
    assert float(load_views(folder).images[1, 3].min()) > 0.999, "the mask counts all the same"
