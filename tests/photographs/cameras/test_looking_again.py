"""Masks found anew once cameras are known: only guessed ones, and only where the new one shows something."""

import numpy as np
import pytest
import torch
from PIL import Image

from arm_blender.photographs.cameras import looking_again
from arm_blender.photographs.cameras.looking_again import looked_at_again
from arm_blender.photographs.cameras.standing import upright
from arm_blender.photographs.cameras.working_copies import WorkingCopy
from arm_blender.photographs.masks.joint_hull import joint_hull
from arm_blender.photographs.masks.joint_look import TOGETHER
from arm_blender.photographs.pictures import Photograph
from arm_blender.progress import silent

from .solutions import box, masks_of, solution, w2c_ring

HALF = (0.9, 0.5, 0.3)


@pytest.fixture
def solved():
    cameras, points = w2c_ring(8), box(HALF)
    return solution(cameras, points), masks_of(cameras, points)


def copies_of(solved, masks, folder, told) -> list[WorkingCopy]:
    found = []
    for name, lens, mask in zip(solved.names, solved.lenses, masks, strict=True):
        Image.fromarray(np.full((lens.height, lens.width, 3), 90, np.uint8)).save(folder / name, format="PNG")
        photograph = Photograph(folder / name, lens.width, lens.height, None)
        found.append(WorkingCopy(name, photograph, lens.width, lens.height, mask, told))
    return found


def test_given_masks_stay_and_guessed_ones_go(solved, tmp_path, monkeypatch):
    own, masks = solved
    stand = upright(own, masks, joint_hull(own.w2c, own.lenses, masks), 0)
    copies = copies_of(own, masks, tmp_path, ("small network", "doubtful: torn"))
    copies[2] = WorkingCopy(*(getattr(copies[2], name) for name in ("name", "photograph", "width", "height", "mask")))
    copies[5] = copies_of(own, masks, tmp_path, ("mask file",))[5]
    better = [(mask > 0.5).float().roll(3, dims=1) for mask in masks]
    better[6] = torch.zeros_like(better[6])
    seen = {}

    def joint(picture, alphas, eyes, ground, progress):
        seen["centers"] = torch.stack([eye.center for eye in eyes])
        assert picture(0).shape == (3, copies[0].height, copies[0].width)
        return better

    monkeypatch.setattr(looking_again, "joint_masks", joint)
    found = looked_at_again(copies, tmp_path, own, stand, silent)
    torch.testing.assert_close(seen["centers"], stand.moved(own.centers), rtol=0.0, atol=1e-6)
    for view, (copy, before) in enumerate(zip(found, copies, strict=True)):
        if view in (5, 6):
            assert copy is before
        else:
            assert torch.equal(copy.mask, better[view]) and copy.told[0] == TOGETHER


def test_nothing_is_looked_for_where_every_mask_was_given(solved, tmp_path, monkeypatch):
    own, masks = solved
    monkeypatch.setattr(looking_again, "joint_masks", lambda *args: pytest.fail("asked"))
    copies = copies_of(own, masks, tmp_path, ("mask file",))
    assert looked_at_again(copies, tmp_path, own, upright(own, masks, None, 0), silent) == copies


def test_without_the_network_the_first_masks_stay(solved, tmp_path, monkeypatch):
    own, masks = solved
    monkeypatch.setattr(looking_again, "joint_masks", lambda *args: None)
    copies = copies_of(own, masks, tmp_path, ("small network",))
    assert looked_at_again(copies, tmp_path, own, upright(own, masks, None, 0), silent) == copies
