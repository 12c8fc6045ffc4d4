"""Relighting by the paper's count: which lights, and what the mean over them is."""

from pathlib import Path

import numpy as np
import pytest
import torch

from arm_blender.config import Settings
from arm_blender.errors import ArmError
from training.__main__ import main
from training.evaluation.scores.image_scores import PSNR_CAP
from training.evaluation.scores.relighting import relighting_scores, under_lights
from training.evaluation.tables.output import setting_text
from training.evaluation.trials.trial import Trial
from training.evaluation.truth.protocol import PAPER_COUNTS, QUICK, Protocol, relit_lights
from training.evaluation.truth.truth import Appearance, Relighting, Truth, relit_files, relit_pictures
from training.rendering.shards import save_arrays

OTHERS, OWN = [Path(f"eval-{k}.hdr") for k in range(3)], [Path(f"own-{k}.exr") for k in range(8)]
SMALL = Protocol(resolution=16, views=4, relit_views=3, environments=2)


def test_the_papers_counts_have_a_folder_of_their_own():
    paper = Protocol(**PAPER_COUNTS)
    assert (len(paper.tests()), len(paper.relit()), paper.environments) == (32, 24, 6)
    assert len({p.folder for p in (paper, Protocol(), QUICK, Protocol(views=32))}) == 4
    assert Protocol().folder == "320px-32spp-8views"  # What was rendered before is not rendered again.
    with pytest.raises(ValueError, match="relit_views"):
        Protocol(environments=6)


def test_a_table_says_how_many_views_and_environments_it_is_of(capsys):
    text = setting_text([], Trial(Settings(), Protocol(**PAPER_COUNTS)))
    assert "32 test views of 320²" in text and "relighting of 24 views under 6 environments" in text
    assert "8 test views" in setting_text([], Trial(Settings(), Protocol()))
    assert main(["evaluate", "--quick", "--paper-protocol"]) == 1
    assert "give one of them" in capsys.readouterr().err


@pytest.mark.parametrize("protocol", [Protocol(), Protocol(**PAPER_COUNTS)])
def test_views_surround_the_object_and_are_no_inputs(protocol):
    for cameras in (protocol.tests(), protocol.relit()):
        centers = torch.stack([camera.center for camera in cameras])
        step = 2.0 * torch.pi / len(cameras)
        azimuths = torch.atan2(centers[:, 1], centers[:, 0])
        gaps = (azimuths.roll(-1) - azimuths) % (2.0 * torch.pi)
        assert torch.allclose(gaps, torch.full_like(gaps, step), atol=1e-4)
        inputs = torch.stack([camera.center for camera in protocol.inputs()])
        assert float(torch.cdist(centers, inputs).min()) > 0.3


def test_the_environments_of_the_set_come_first_and_those_of_the_inputs_never():
    assert relit_lights(OTHERS, OWN, Path("train.hdr"), 6) == [*OTHERS, OWN[0], OWN[2], OWN[5]]
    for first in OWN:
        chosen = relit_lights(OWN[1::2], OWN, first, 6)
        assert len(set(chosen)) == 6 and first not in chosen
    assert relit_lights(OTHERS, OWN, OTHERS[0], 2) == OTHERS[1:]
    with pytest.raises(ArmError, match="11 environments, 12 are needed"):
        relit_lights(OTHERS, OWN, Path("train.hdr"), 12)


@pytest.fixture
def truth(tmp_path) -> Truth:
    """Three views under two lights: all of 100, and all of 150, of 255; opaque."""
    files, cameras = relit_files(tmp_path, 2), SMALL.relit()
    for path, level in zip(files, (100, 150), strict=True):
        pictures = np.full((3, 16, 16, 4), level, np.uint8)
        pictures[..., 3] = 255
        save_arrays(path, {"rgba": pictures})
    relighting = Relighting(cameras, tuple(files), (tmp_path / "day.hdr", tmp_path / "night.hdr"))
    shown = Appearance(SMALL.tests(), *(torch.ones(4, c, 16, 16) for c in (1, 3, 1, 1)))
    return Truth(shown, shown, tmp_path / "first.hdr", tmp_path / "day.hdr", relighting)


def test_what_is_written_is_read_again(truth):
    for path, level in zip(truth.relighting.files, (100, 150), strict=True):
        color, alpha = relit_pictures(path)
        assert color.shape == (3, 3, 16, 16) and alpha.shape == (3, 1, 16, 16)
        assert color.unique().tolist() == [pytest.approx(level / 255.0)] and alpha.unique().tolist() == [1.0]
    truth.relighting.files[0].write_bytes(b"")
    with pytest.raises(ArmError, match="relit-0.npz"):
        relit_pictures(truth.relighting.files[0])


def test_the_score_is_the_mean_over_the_lights(truth):
    """Right under one light, a tenth of the range off under the other: 50 and 20 dB."""

    def show(light: Path) -> tuple[torch.Tensor, torch.Tensor]:
        level = 100.0 / 255.0 if light.name == "day.hdr" else 150.0 / 255.0 + 0.1
        return torch.full((3, 3, 16, 16), level), torch.ones(3, 1, 16, 16)

    scores = relighting_scores(truth.relighting, show, lambda x, y: (x - y).abs().mean())
    assert scores.psnr_in == pytest.approx((PSNR_CAP + 20.0) / 2.0, abs=1e-3)
    assert scores.psnr_full == pytest.approx(scores.psnr_in)
    assert scores.lpips == pytest.approx(0.05, abs=1e-4) and scores.ssim < 1.0
    assert relighting_scores(truth.relighting, show, None).lpips is None


def test_a_system_is_asked_for_one_light_at_a_time(truth):
    asked = []

    def render(cameras, lights):
        asked.append((len(cameras), [light.name for light in lights]))
        return [torch.full((len(cameras), 3, 16, 16), 0.5) for _ in lights]

    def show(cameras):
        return Appearance(tuple(cameras), *(torch.ones(len(cameras), c, 16, 16) for c in (1, 3, 1, 1)))

    found, scores = under_lights(truth.tests, show, render, truth, None)
    assert asked == [(4, ["first.hdr"]), (3, ["day.hdr"]), (3, ["night.hdr"])]
    assert found.lit.shape == (4, 3, 16, 16) and found.relit is None and set(scores) == {"relit"}
    plain = Truth(truth.tests, truth.front, truth.input_light, truth.other_light)
    found, scores = under_lights(truth.tests, show, render, plain, None)
    assert asked[-1] == (4, ["first.hdr", "day.hdr"]) and scores == {} and found.relit is not None
