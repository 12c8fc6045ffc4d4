"""From files to a set of views: what is taken, what is skipped, what is refused."""

import math
import os
import shutil

import pytest
import torch

from arm_blender.errors import ArmError, InputImageError
from arm_blender.graphics.cameras import project
from arm_blender.views import ViewOptions, load_views
from arm_blender.views.image_io import write_png
from arm_blender.views.rigs import zero123plus_rig
from arm_blender.views.transforms_json import write_transforms

from ..pictures import SIZE, picture, six_pictures


@pytest.fixture
def six(tmp_path):
    return six_pictures(tmp_path / "cup")


def shades(views) -> list[float]:
    return views.images[:, 0, 32, 32].tolist()


def test_six_pictures_take_the_rig_in_the_order_of_their_names(six):
    views = load_views(six, ViewOptions(rig_distance=5.0))
    assert views.name == "cup" and views.weights.tolist() == [1.0] * 6
    assert shades(views) == pytest.approx([(index + 1) / 6.0 for index in range(6)], abs=0.01)
    for camera, expected in zip(views.cameras, zero123plus_rig(5.0, size=SIZE), strict=True):
        assert torch.equal(camera.c2w, expected.c2w) and torch.equal(camera.K, expected.K)


def test_transforms_go_before_the_rig(six):
    rig = zero123plus_rig(size=SIZE)
    write_transforms(six / "transforms.json", ["5.png", "0.png"], [rig[5], rig[0]], [2.0, 1.0])
    for path in (six, six / "transforms.json"):
        views = load_views(path)
        assert views.name == "cup" and views.weights.tolist() == [2.0, 1.0]
        assert shades(views) == pytest.approx([1.0, 1 / 6], abs=0.01)
        assert torch.equal(views.cameras[0].c2w, rig[5].c2w)


@pytest.mark.parametrize("alone", [True, False])
def test_one_picture_is_seen_from_the_front(six, alone):
    """Its longest side, 32 pixels before the crop, spans 2 at the origin."""
    if alone:
        for index in range(1, 6):
            (six / f"{index}.png").unlink()
    views = load_views(six if alone else six / "0.png", ViewOptions(elevation_deg=0.0, fovy_deg=40.0))
    assert len(views.cameras) == 1 and views.images.shape[2] == views.images.shape[3]
    pixels, _ = project(torch.tensor([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]), views.cameras[0])
    assert float(pixels[0, 1] - pixels[1, 1]) == pytest.approx(32.0, rel=1e-5)


@pytest.mark.parametrize("alone", [True, False])
def test_a_mask_beside_goes_before_the_alpha_of_one_picture_and_of_six(six, alone):
    (six / "masks").mkdir()
    painted = torch.zeros(1, SIZE, SIZE)
    painted[:, 20:40, 10:50] = 1.0
    write_png(six / "masks" / "0.png", painted, srgb=False)
    heard: dict[str, str] = {}
    views = load_views(six / "0.png" if alone else six, heard=heard.__setitem__)
    assert heard["0.png"] == "mask file" and set(heard.values()) == ({"mask file"} if alone else {"mask file", "alpha"})
    rows, columns = (torch.nonzero((views.images[0, 3] > 0.5).any(dim=dim)) for dim in (1, 0))
    assert (len(rows), len(columns)) == (20, 40), "the painted rectangle, and not that of the alpha"


def test_views_that_show_nothing_are_skipped_and_said(six):
    write_png(six / "3.png", picture(0.5, filled=False), srgb=True)
    notes = []
    options = ViewOptions(weights=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    views = load_views(six, options, left_out=lambda what, why: notes.append((what, why)))
    assert len(views.cameras) == 5 and views.weights.tolist() == [1.0, 2.0, 3.0, 5.0, 6.0]
    assert notes == [("view 3.png", "it shows nothing")]
    assert torch.equal(views.cameras[3].c2w, zero123plus_rig()[4].c2w)


def test_progress_hears_of_each_picture(six):
    heard = []
    load_views(six, progress=lambda fraction, message: heard.append((fraction, message)))
    assert [message for _, message in heard] == [f"reading {index}.png" for index in range(6)]
    assert heard == sorted(heard) and 0.0 <= heard[0][0] and heard[-1][0] <= 1.0


def test_what_does_not_do_is_refused_by_name(six, tmp_path):
    with pytest.raises(InputImageError, match="nothing: no such file"):
        load_views(tmp_path / "nothing")
    (tmp_path / "bare").mkdir()
    with pytest.raises(InputImageError, match="bare: holds no pictures; choose the folder"):
        load_views(tmp_path / "bare")
    with pytest.raises(InputImageError, match="6 views but 2 --view-weights"):
        load_views(six, ViewOptions(weights=(1.0, 2.0)))
    with pytest.raises(InputImageError, match="weight 0"):
        load_views(six, ViewOptions(weights=(0.0,) * 6))
    for extreme in (1e-300, 1e39, math.nan, -1.0):  # In float32 the first is 0 and the second infinite.
        with pytest.raises(InputImageError, match="0.png: its weight is"):
            load_views(six, ViewOptions(weights=(extreme, 1.0, 1.0, 1.0, 1.0, 1.0)))
    write_png(six / "4.png", picture(0.5)[:, :48], srgb=True)
    with pytest.raises(InputImageError, match="4.png: views of different sizes"):
        load_views(six)
    (six / "4.png").unlink()
    with pytest.raises(InputImageError, match="5 images"):
        load_views(six)


@pytest.mark.parametrize(
    "wrong",
    [
        {"rig": "x"},
        {"rig_distance": 0.0},
        {"rig_distance": math.inf},
        {"fovy_deg": 200.0},
        {"fovy_deg": 5e-324},
        {"fovy_deg": 1e-300},
        {"elevation_deg": 100.0},
    ],
    ids=str,
)
def test_options_out_of_range_are_refused(wrong):
    with pytest.raises(ArmError, match="--"):
        ViewOptions(**wrong)


def test_a_name_that_no_file_can_have_or_no_reader_takes_is_refused(six, tmp_path):
    with pytest.raises(InputImageError, match="too long"):
        load_views(tmp_path / ("x" * 5000))
    foreign = tmp_path / os.fsdecode(b"\xff.png")
    try:
        shutil.copy(six / "0.png", foreign)
    except OSError:
        pytest.skip("this file system takes UTF-8 only")
    with pytest.raises(InputImageError, match="no UTF-8"):
        load_views(foreign)


def test_a_provider_that_is_not_there_says_what_to_do(six):
    with pytest.raises(ArmError, match="zero123plus.*--multiview none"):
        load_views(six / "0.png", ViewOptions(multiview="zero123plus"))
