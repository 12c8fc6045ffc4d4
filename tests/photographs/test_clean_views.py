"""Photographs become views in which known points lie where the pinhole says, whole or not at all."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from scipy import ndimage

from arm_blender.errors import Cancelled, InputImageError
from arm_blender.graphics.cameras import project
from arm_blender.photographs.capture import Capture, Lens
from arm_blender.photographs.clean_views import CleaningOptions, clean_views
from arm_blender.photographs.framing import known_rectangle
from arm_blender.photographs.painted import UNUSED, older_views
from arm_blender.views import load_views
from arm_blender.views.image_io import read_image, write_png

from .ball import DOT, LENSES, RADIUS, dots, lens, orbit, write_capture


def misplaced(views) -> tuple[float, int]:
    """The greatest distance, in pixels, of a dot that faces a camera from where it should be; and how many dots."""
    worst, count = 0.0, 0
    for image, camera in zip(views.images, views.cameras, strict=True):
        points = torch.tensor(RADIUS * math.cos(DOT) * dots()).float()
        facing = ((camera.center - points) * points).sum(-1) / (camera.center - points).norm(dim=-1) / RADIUS > 0.75
        white = (image[1] * image[3]).numpy()
        for u, v in project(points[facing], camera)[0].tolist():
            left, top = round(u) - 8, round(v) - 8
            patch = white[max(top, 0) : top + 16, max(left, 0) : left + 16]
            if min(left, top) < 0 or patch.shape != (16, 16):
                continue
            labels, _ = ndimage.label(patch > 0.05)
            own = labels[8 - 3 : 8 + 3, 8 - 3 : 8 + 3]
            assert own.any(), "no dot where one should be"
            row, column = ndimage.center_of_mass(patch, labels, own[own > 0][0])
            worst = max(worst, float(np.hypot(column + 0.5 + left - u, row + 0.5 + top - v)))
            count += 1
    return worst, count


@pytest.mark.parametrize("model", LENSES)
def test_points_lie_where_the_pinhole_says(tmp_path, model):
    capture = write_capture(tmp_path / "in", orbit(3), lens(model))
    folder = clean_views(capture, tmp_path / "views", CleaningOptions(side=128))
    views = load_views(folder)
    assert views.images.shape == (3, 4, 128, 128)
    worst, count = misplaced(views)
    assert count > 12 and worst < 0.5, (worst, count)


TINY = Lens("PINHOLE", (75.0, 75.0, 40.0, 30.0), 80, 60)
"""Of photographs that are quickly made."""


def listened():
    """What is left out, by its name, and the function that is told it."""
    notes: dict[str, str] = {}
    return notes, lambda what, why: notes.update({what: why})


def azimuths(views) -> list[float]:
    return sorted(math.degrees(math.atan2(float(c.center[1]), float(c.center[0]))) % 360 for c in views.cameras)


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_sixteen_of_forty_see_it_from_all_around(tmp_path):
    capture = write_capture(tmp_path / "in", orbit(40), TINY)
    notes, left_out = listened()
    views = load_views(clean_views(capture, tmp_path / "views", left_out=left_out))
    assert len(views.cameras) == 16 and len(notes) == 24
    assert all("others see the object" in why for why in notes.values())
    around = azimuths(views)
    gaps = np.diff([*around, around[0] + 360])
    assert gaps.max() < 2 * 360 / 16
    kept = {frame["photograph"] for frame in json.loads((tmp_path / "views/transforms.json").read_text())["frames"]}
    assert kept | notes.keys() == {one.path.name for one in capture.photographs} and not kept & notes.keys()


def looking_aside(pose):
    """A camera turned so that the ball is half out of its picture."""
    aside = np.eye(4)
    aside[:3, :3] = [[math.cos(0.45), 0, math.sin(0.45)], [0, 1, 0], [-math.sin(0.45), 0, math.cos(0.45)]]
    return pose @ aside


def test_blurred_and_cut_photographs_are_left_out_by_name(tmp_path):
    poses = orbit(14)
    poses[5], poses[12] = looking_aside(poses[5]), looking_aside(poses[12])
    capture = write_capture(tmp_path / "in", poses, TINY, blurred=(2, 9), masks=True)
    notes, left_out = listened()
    clean_views(capture, tmp_path / "views", CleaningOptions(views=11), left_out=left_out)
    blurred = {name for name, why in notes.items() if "blurred" in why}
    cut = {name for name, why in notes.items() if "border" in why}
    assert blurred == {"IMG_0002.png", "IMG_0009.png"}  # Ten are sharp and whole: one that is cut fills up.
    assert len(cut) == 1 and cut < {"IMG_0005.png", "IMG_0012.png"} and len(notes) == 3


def test_a_picture_that_its_mask_made_no_view_becomes_one_by_a_better_mask(tmp_path):
    poses = orbit(12)
    poses[5], poses[10] = looking_aside(poses[5]), looking_aside(poses[10])
    capture = write_capture(tmp_path / "in", poses, TINY, masks=True)
    folder, options = tmp_path / "views", CleaningOptions(views=11, side=64)
    notes, left_out = listened()
    clean_views(capture, folder, options, left_out=left_out)
    assert list(notes.values()) == ["the border of the picture cuts the object"]
    (unused,) = older_views(folder / UNUSED)
    assert [unused.photograph] == list(notes) and (folder / unused.picture).is_file()
    assert len(load_views(folder).cameras) == 11, "it is no view"
    painted = torch.zeros(1, 64, 64)
    painted[:, 24:40, 24:40] = 1.0
    (folder / "masks").mkdir()
    write_png(folder / "masks" / unused.picture, painted, srgb=False)
    heard, hear = listened()
    clean_views(capture, folder, options, heard=hear)
    assert heard[unused.photograph] == "painted mask"
    (other,) = older_views(folder / UNUSED)
    assert {other.photograph, unused.photograph} == {"IMG_0005.png", "IMG_0010.png"}


def test_a_cut_photograph_serves_where_there_are_too_few_and_says_what_it_knows(tmp_path):
    poses = orbit(3)
    poses[1] = looking_aside(poses[1])
    capture = write_capture(tmp_path / "in", poses, TINY, masks=True)
    folder = clean_views(capture, tmp_path / "views", CleaningOptions(side=64))
    frames = json.loads((folder / "transforms.json").read_text())["frames"]
    known = [frame["known"] for frame in frames]
    assert known[0] == known[2] == [0, 0, 64, 64]
    image = read_image(folder / frames[1]["file_path"])
    left, top, right, bottom = known[1]
    assert 0 <= left < right <= 64 and 0 <= top < bottom <= 64
    # The mask reaches the end of what is known, and nothing lies beyond.
    inside = torch.zeros(64, 64, dtype=torch.bool)
    inside[top:bottom, left:right] = True
    assert not bool((image[3] > 0.5)[~inside].any())
    edge = image[3][:, left] if bool((image[3][:, left] > 0.5).any()) else image[3][:, right - 1]
    assert bool((edge > 0.5).any())


def test_a_bent_border_is_no_part_of_what_is_known():
    known = torch.ones(40, 60, dtype=torch.bool)
    rows, columns = torch.meshgrid(torch.arange(40.0), torch.arange(60.0), indexing="ij")
    known &= columns >= 5 - ((rows - 20) / 8) ** 2
    known &= rows < 38
    left, top, right, bottom = known_rectangle(known)
    assert (top, right, bottom) == (0, 60, 38) and left == 5
    assert bool(known[top:bottom, left:right].all())


def test_nothing_known_is_an_empty_rectangle():
    left, top, right, bottom = known_rectangle(torch.zeros(4, 6, dtype=torch.bool))
    assert left >= right or top >= bottom


def test_a_mask_file_goes_before_what_is_found(tmp_path):
    capture = write_capture(tmp_path / "in", orbit(2), TINY)
    one = capture.photographs[0]
    mask = np.zeros((60, 80), np.uint8)
    mask[20:40, 30:50] = 255
    Image.fromarray(mask).save(tmp_path / "mask.png")
    heard, hear = listened()
    masked = Capture((replace(one, mask=tmp_path / "mask.png"), capture.photographs[1]), capture.points)
    folder = clean_views(masked, tmp_path / "views", CleaningOptions(side=64), heard=hear)
    assert heard == {"IMG_0000.png": "mask file", "IMG_0001.png": "plain background"}
    # A square in the photograph is one in the view, with a tenth of margin.
    alpha = read_image(folder / "IMG_0000.png")[3]
    assert int((alpha > 0.5).any(0).sum()) == pytest.approx(64 / 1.2, abs=2.0)
    assert float(alpha[16:48, 16:48].min()) > 0.99


def test_a_painted_mask_wins_and_stays(tmp_path):
    capture = write_capture(tmp_path / "in", orbit(2), TINY)
    folder = clean_views(capture, tmp_path / "views", CleaningOptions(side=64))
    before = read_image(folder / "IMG_0000.png")
    painted = torch.zeros(1, 64, 64)
    painted[:, 20:44, 10:54] = 1.0
    (folder / "masks").mkdir()
    write_png(folder / "masks" / "IMG_0000.png", painted, srgb=False)
    heard, hear = listened()
    for side in (64, 128):  # Of the second, the mask was painted on a smaller view.
        clean_views(capture, folder, CleaningOptions(side=side), heard=hear)
        assert heard["IMG_0000.png"] == "painted mask"
        after = read_image(folder / "IMG_0000.png")
        expected = torch.nn.functional.interpolate(painted[None], size=(side, side), mode="nearest")[0, 0]
        assert float(((after[3] > 0.5).float() - expected).abs().mean()) < 0.01
        if side == 64:
            assert float((after[:3] - before[:3])[:, 20:44, 10:54].abs().mean()) < 0.01
    # Read without cleaning it goes before the alpha of the view as well.
    write_png(folder / "masks" / "IMG_0001.png", torch.ones(1, 128, 128), srgb=False)
    assert float(load_views(folder).images[1, 3].min()) > 0.999


def test_a_painted_mask_of_another_size_is_named(tmp_path):
    capture = write_capture(tmp_path / "in", orbit(1), TINY)
    folder = clean_views(capture, tmp_path / "views", CleaningOptions(side=64))
    (folder / "masks").mkdir()
    write_png(folder / "masks" / "IMG_0000.png", torch.ones(1, 32, 32), srgb=False)
    before = contents(folder)
    with pytest.raises(InputImageError, match="IMG_0000.png: 32x32 pixels, its view has 64x64"):
        clean_views(capture, folder, CleaningOptions(side=64))
    assert contents(folder) == before


@pytest.mark.parametrize("existed", [False, True])
def test_cancelled_at_any_word_it_leaves_what_was_there(tmp_path, existed):
    capture = write_capture(tmp_path / "in", orbit(2), TINY)
    folder = tmp_path / "out" / "views"
    if existed:
        folder.mkdir(parents=True)
        (folder / "notes.txt").write_text("mine")
    said: list[float] = []
    clean_views(capture, tmp_path / "whole", CleaningOptions(side=64), lambda fraction, _: said.append(fraction))
    assert said == sorted(said) and 0.0 <= said[0] and said[-1] <= 1.0

    for stop in range(len(said)):
        left = stop

        def cancel(*_):
            nonlocal left
            left -= 1
            if left < 0:
                raise Cancelled("stopped")

        with pytest.raises(Cancelled):
            clean_views(capture, folder, CleaningOptions(side=64), cancel)
        assert not existed or contents(folder) == {Path("notes.txt"): b"mine"}
        assert existed or not folder.parent.exists()


def test_a_photograph_that_cannot_be_read_spoils_nothing(tmp_path):
    capture = write_capture(tmp_path / "in", orbit(3), TINY)
    (tmp_path / "in" / "IMG_0001.png").write_bytes(b"no picture")
    notes, left_out = listened()
    views = load_views(clean_views(capture, tmp_path / "views", CleaningOptions(side=64), left_out=left_out))
    assert len(views.cameras) == 2 and list(notes) == ["IMG_0001.png"]
    for one in capture.photographs:
        one.path.write_bytes(b"no picture")
    with pytest.raises(InputImageError, match="IMG_0000.png: not a readable picture"):
        clean_views(capture, tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_views_hold_no_words_of_the_photograph(tmp_path):
    """Neither its EXIF nor where it was taken."""
    capture = write_capture(tmp_path / "in", orbit(1), TINY)
    path = tmp_path / "in" / "IMG_0000.jpg"
    exif = Image.Exif()
    exif[0x010F] = "Maker"
    exif.get_ifd(0x8825)[1] = "N"
    Image.open(capture.photographs[0].path).save(path, exif=exif, quality=95)
    posed = Capture((replace(capture.photographs[0], path=path),), capture.points)
    view = Image.open(clean_views(posed, tmp_path / "views") / "IMG_0000.png")
    assert view.mode == "RGBA" and not view.getexif() and "Maker" not in str(view.info)
