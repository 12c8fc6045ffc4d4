"""How views that see the same texels share them."""

import pytest
import torch

from arm_blender.structures import TexelViews
from arm_blender.uv.blend import BlendConfig, blend


def conflicting(colors: list[float], cosines: list[float]) -> TexelViews:
    """One texel that every view sees, in grey."""
    count = len(colors)
    return TexelViews(
        torch.tensor(colors).view(count, 1, 1, 1).expand(count, 3, 1, 1),
        torch.ones(count, 1, 1, dtype=torch.bool),
        torch.zeros(count, 3),
        torch.tensor(cosines).view(count, 1, 1),
        torch.zeros(count, 1, 1, 2),
    )


def test_the_blend_of_two_views_is_their_weighted_mean() -> None:
    seen = conflicting([0.2, 0.8], [1.0, 0.5])
    color, total = blend(seen, torch.tensor([1.0, 3.0]), BlendConfig(cosine_power=2.0))
    assert float(color[0]) == pytest.approx((0.2 * 1.0 + 0.8 * 3.0 * 0.25) / 1.75)
    assert float(total) == pytest.approx(1.75)
    assert float(blend(seen, torch.tensor([0.0, 3.0]))[0][0]) == pytest.approx(0.8)
    nothing, total = blend(seen, torch.zeros(2))
    assert not nothing.any() and not total.any()
    with pytest.raises(ValueError, match="weights"):
        blend(seen, torch.ones(3))


def test_of_three_views_the_one_that_disagrees_counts_for_little() -> None:
    for outlier in (0.0, 1.0):
        seen = conflicting([0.40, outlier, 0.44], [0.7, 1.0, 0.7])  # The outlier looks most squarely.
        assert float(blend(seen, torch.ones(3))[0][0]) == pytest.approx(0.42, abs=0.03)
    agreeing = conflicting([0.4, 0.4, 0.4], [0.7, 1.0, 0.7])
    assert float(blend(agreeing, torch.ones(3))[0][0]) == pytest.approx(0.4)


def test_blends_differ_in_what_an_outlier_may_do() -> None:
    unvoted, squarest = BlendConfig(rounds=0), BlendConfig(cosine_power=32.0)
    seen = conflicting([0.40, 1.0, 0.44], [0.7, 1.0, 0.7])  # The outlier looks most squarely.
    robust, weighted = (float(blend(seen, torch.ones(3), config)[0][0]) for config in (BlendConfig(), unvoted))
    share = 0.7**4
    assert weighted == pytest.approx((0.84 * share + 1.0) / (1.0 + 2.0 * share))
    assert robust < 0.45 < 0.6 < weighted
    # However grazing all views are, what they agree on stays.
    grazing = conflicting([0.5, 0.5], [0.1, 0.12])
    for config in (BlendConfig(), unvoted, squarest):
        assert float(blend(grazing, torch.ones(2), config)[0][0]) == pytest.approx(0.5)
    # Two views never outvote each other: then the squarer one is nearly all that a high power shows.
    seen = conflicting([0.2, 0.8], [1.0, 0.8])
    assert float(blend(seen, torch.ones(2), squarest)[0][0]) == pytest.approx(0.2, abs=1e-3)
    assert float(blend(seen, torch.ones(2))[0][0]) > 0.3


def test_views_take_turns_without_an_edge() -> None:
    size = 128
    sees = torch.ones(2, size, size, dtype=torch.bool)
    sees[0, :, 96:], sees[1, :, :32] = False, False  # Both see the middle, each one side alone.
    shown = torch.tensor([0.2, 0.8]).view(2, 1, 1, 1).expand(2, 3, size, size)
    seen = TexelViews(shown * sees[:, None], sees, torch.zeros(2, 3), sees.float(), torch.zeros(2, size, size, 2))
    edges = {}
    for reach in (0.0, 1.0 / 16.0):
        color, total = blend(seen, torch.ones(2), BlendConfig(reach=reach))
        assert (total > 0.0).all()
        assert float(color[0, :, 0].mean()) == pytest.approx(0.2) and float(color[0, :, -1].mean()) == pytest.approx(
            0.8
        )
        edges[reach] = float(color[0].diff(dim=1).abs().max())
    assert edges[0.0] == pytest.approx(0.3, abs=1e-3) and edges[1.0 / 16.0] < 0.07
