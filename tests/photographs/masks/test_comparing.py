"""What most masks contradict is mended in the files of the views; what somebody gave, and what is cut, is not."""

import pytest
import torch

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.photographs.masks.comparing import compare
from arm_blender.views.image_io import read_image, write_png

from .test_agreement import SIDE, balls

WHOLE = (0, 0, SIDE, SIDE)
CAMERAS = [orbit_camera(36.0 * k, 15.0, 4.0, 45.0, SIDE, SIDE) for k in range(10)]
SPOILT = 3


@pytest.fixture
def pictures(tmp_path):
    """Views of which one has clutter in its mask."""
    paths = []
    for index, camera in enumerate(CAMERAS):
        alpha = balls(camera)
        if index == SPOILT:
            alpha[0, 20:50, 15:40] = 1.0
        paths.append(tmp_path / f"{index}.png")
        write_png(paths[-1], torch.cat([torch.full((3, SIDE, SIDE), 0.5), alpha]), srgb=True)
    return paths


def clutter(path) -> float:
    return float(read_image(path)[3, 22:48, 17:38].mean())


def test_a_mask_that_was_found_is_mended_in_its_file(pictures):
    before = {path: path.read_bytes() for path in pictures}
    words, dropped = compare(pictures, CAMERAS, [WHOLE] * 10, ["small network"] * 10)
    assert set(words) == {SPOILT} and dropped == ()
    assert clutter(pictures[SPOILT]) < 0.05
    assert all(path.read_bytes() == before[path] for path in pictures if path != pictures[SPOILT])


@pytest.mark.parametrize("way", ["mask file", "alpha"])
def test_a_mask_that_somebody_gave_is_believed(pictures, way):
    ways = ["small network"] * 10
    ways[SPOILT] = way
    assert compare(pictures, CAMERAS, [WHOLE] * 10, ways) == ({}, ())
    assert clutter(pictures[SPOILT]) > 0.95


def test_a_view_that_cuts_its_object_is_compared_as_far_as_it_tells(pictures):
    image = read_image(pictures[SPOILT])
    image[3, 90:] = 0.0  # The object goes on below; nobody knows how.
    write_png(pictures[SPOILT], image, srgb=True)
    known = [WHOLE] * 10
    known[SPOILT] = (0, 0, SIDE, 90)
    words, dropped = compare(pictures, CAMERAS, known, ["small network"] * 10)
    assert set(words) == {SPOILT} and "taken away" in words[SPOILT] and dropped == ()
    assert clutter(pictures[SPOILT]) < 0.05, "what the others contradict is taken away"
    known[SPOILT] = WHOLE
    words, dropped = compare(pictures, CAMERAS, known, ["small network"] * 10)
    assert dropped == (SPOILT,), "as a whole picture the same mask lacks what the others show"
