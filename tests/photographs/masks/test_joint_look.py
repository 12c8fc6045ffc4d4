"""The second look: what it hands to its network, and where the answer lands in the picture."""

from pathlib import Path

import pytest
import torch

from arm_blender.errors import Cancelled
from arm_blender.photographs.masks import joint_look
from arm_blender.photographs.masks.joint_look import is_guessed, joint_masks, logit_of
from arm_blender.weight_files import checkpoints

from .ball_on_ground import GROUND, eyes, photograph

installed = pytest.mark.skipif(not checkpoints.shipped(joint_look.WEIGHTS).is_file(), reason="its weights are missing")


class TellsSupport(torch.nn.Module):
    """Answers with what is clearly above the ground, as the evidence has it."""

    config = joint_look.CONFIG

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        assert inputs.shape[1:] == (3 + self.config.evidence, self.config.closer_side, self.config.closer_side)
        return 4.0 * inputs[:, 6:7]


@pytest.fixture(scope="module")
def taken():
    own = eyes()
    return own, [photograph(eye) for eye in own]


def look(taken, progress=lambda fraction, message: None):
    own, shots = taken
    alphas = [(ball | shadow).float() for _, ball, shadow in shots]
    alphas[3] = None
    return joint_masks(lambda view: shots[view][0], alphas, own, GROUND, progress)


def iou(found, truth) -> float:
    mask = found > 0.5
    return float((mask & truth).sum()) / float((mask | truth).sum())


def test_the_answer_lies_where_it_was_looked_for(taken, monkeypatch):
    monkeypatch.setattr(joint_look, "load_cutout", lambda path, changed: TellsSupport())
    monkeypatch.setattr(checkpoints, "shipped", lambda name: Path(__file__))
    found = look(taken)
    assert all(mask.shape == shot[1].shape for mask, shot in zip(found, taken[1], strict=True))
    scores = [iou(mask, shot[1]) for mask, shot in zip(found, taken[1], strict=True)]
    assert min(scores) > 0.6, scores


def test_without_its_network_nothing_is_said(taken, monkeypatch, tmp_path):
    monkeypatch.setattr(checkpoints, "shipped", lambda name: tmp_path / "missing.safetensors")
    assert look(taken) is None


def test_it_can_be_stopped(taken, monkeypatch):
    monkeypatch.setattr(joint_look, "load_cutout", lambda path, changed: TellsSupport())
    monkeypatch.setattr(checkpoints, "shipped", lambda name: Path(__file__))

    def stop(fraction, message):
        if fraction > 0.5:
            raise Cancelled

    with pytest.raises(Cancelled):
        look(taken, stop)


@installed
def test_a_shadow_that_all_masks_take_along_is_no_object(taken):
    found = look(taken)
    before = [iou((shot[1] | shot[2]).float(), shot[1]) for shot in taken[1]]
    after = [iou(mask, shot[1]) for mask, shot in zip(found, taken[1], strict=True)]
    assert sum(after) / len(after) > 0.9 > 0.85 > sum(before) / len(before)
    assert after[3] > 0.85  # Of this one no mask had been found at all.


def test_masks_that_somebody_gave_are_not_guessed():
    assert is_guessed("small network") and is_guessed(joint_look.TOGETHER)
    assert not any(is_guessed(way) for way in ("alpha", "mask file", "painted mask"))


def test_a_mask_is_never_infinitely_sure():
    assert float(logit_of(torch.tensor([0.0, 0.5, 1.0])).abs().max()) < 4.1
