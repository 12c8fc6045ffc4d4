"""Views of other exposures agree again; what is no exposure is left alone."""

from dataclasses import replace

import pytest
import torch

from arm_blender import pipeline
from arm_blender.config import Settings
from arm_blender.structures import TexelViews, ViewSet
from arm_blender.uv.exposure import evened, gains

from ..models.balls import ball_views

VIEWS, SIDE = 6, 64


def matt(noise: float = 0.02) -> TexelViews:
    """Views of a matt surface of many colours; each sees about half of it."""
    draws = torch.Generator().manual_seed(5)
    albedo = 0.05 + 0.6 * torch.rand(3, SIDE, SIDE, generator=draws)
    visibility = torch.rand(VIEWS, SIDE, SIDE, generator=draws) < 0.5
    wrong = 1.0 + noise * torch.randn(VIEWS, 3, SIDE, SIDE, generator=draws)
    cosine = 0.2 + 0.8 * torch.rand(VIEWS, SIDE, SIDE, generator=draws)
    color = (albedo * wrong).clamp(0.0, 1.0) * visibility[:, None]
    return TexelViews(color, visibility, torch.zeros(VIEWS, 3), cosine, torch.zeros(VIEWS, SIDE, SIDE, 2))


def exposed(seen: TexelViews, factors: torch.Tensor) -> TexelViews:
    return replace(seen, color=(seen.color * factors[:, :, None, None]).clamp(max=1.0))


FACTORS = torch.tensor([1.3, 0.7, 1.0, 1.15, 0.8, 1.05])[:, None] * torch.tensor([1.0, 0.95, 1.1])
FACTORS = FACTORS / FACTORS.log().mean(dim=0).exp()
FACTORS[1, 2] *= 1.2  # The white balance of one alone.


def wanted() -> torch.Tensor:
    inverse = 1.0 / FACTORS
    return inverse / inverse.log().mean(dim=0).exp()


def test_the_gains_of_six_exposures_are_found():
    assert torch.allclose(gains(exposed(matt(), FACTORS)), wanted(), rtol=0.02)


def test_highlights_that_move_are_no_exposure():
    seen = exposed(matt(), FACTORS)
    shiny = torch.rand(VIEWS, 1, SIDE, SIDE, generator=torch.Generator().manual_seed(1)) < 0.15
    seen = replace(seen, color=torch.where(shiny & seen.visibility[:, None], 0.9, seen.color))
    assert torch.allclose(gains(seen), wanted(), rtol=0.04)


def test_views_of_one_exposure_are_left_exactly_as_they_are():
    assert torch.equal(gains(matt(0.02)), torch.ones(VIEWS, 3))


def test_a_view_that_shares_nothing_keeps_its_exposure():
    seen = exposed(matt(), FACTORS)
    visibility, color = seen.visibility.clone(), seen.color.clone()
    visibility[0, :, : SIDE // 2] = False
    visibility[1:, :, SIDE // 2 :] = False
    found = gains(replace(seen, visibility=visibility, color=color * visibility[:, None]))
    assert bool(found.isfinite().all())
    assert torch.allclose(found[0], torch.ones(3), atol=0.02)
    assert torch.allclose(found[1] / found[2], wanted()[1] / wanted()[2], rtol=0.03)


def test_a_single_view_has_nobody_to_agree_with():
    assert torch.equal(gains(matt().only(torch.tensor([0]))), torch.ones(1, 3))


def test_what_is_evened_stays_in_its_range():
    seen = matt()
    views = ViewSet(torch.rand(VIEWS, 4, 8, 8), (None,) * VIEWS, torch.ones(VIEWS), "matt")  # type: ignore[arg-type]
    factors = torch.full((VIEWS, 3), 2.0)
    brighter, told = evened(views, seen, factors)
    assert torch.equal(brighter.images[:, 3], views.images[:, 3])
    assert torch.equal(brighter.images[:, :3], (2.0 * views.images[:, :3]).clamp(max=1.0))
    assert float(told.color.max()) <= 1.0 < float((seen.color * 2.0).max())
    with pytest.raises(RuntimeError):
        evened(views, seen, torch.ones(VIEWS - 1, 3))


def exposed_ball(varying: bool) -> ViewSet:
    views = ball_views(0.7, size=96)
    images = views.images.clone()
    images[:, :3] *= torch.tensor([1.2, 0.8, 1.0, 1.1, 0.9, 1.0])[:, None, None, None]
    return replace(views, images=images, varying_exposure=varying)


def test_only_a_camera_that_exposes_by_itself_is_evened():
    """Views of one exposure differ by what shines and by what does not fit; nothing there is to be evened."""
    settings = Settings(quality="draft", grid=32, faces=500, texture_size=256)
    reports = [pipeline.generate(exposed_ball(varying), settings)[1] for varying in (True, False)]
    brightness = torch.tensor(reports[0].gains)[:, 0]
    assert brightness.argmin() == 0 and brightness.argmax() == 1
    assert float(brightness[1] / brightness[0]) == pytest.approx(1.5, rel=0.05)
    assert reports[1].gains is None
