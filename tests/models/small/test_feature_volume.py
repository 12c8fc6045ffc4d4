"""What cells of the coarse volume know of the views' colours."""

import pytest
import torch

from arm_blender.models.small.feature_volume import COLORS, compared_colors, object_colors


@torch.no_grad()
@pytest.mark.parametrize("background", [0.0, 0.5, 1.0])
def test_the_colour_of_the_object_has_nothing_of_the_background(background):
    """Half of every square shows the object."""
    coverage = torch.zeros(1, 1, 8, 8)
    coverage[..., ::2] = 1.0
    image = torch.tensor([0.2, 0.5, 0.9]).view(1, 3, 1, 1) * coverage + background * (1.0 - coverage)
    found = object_colors(torch.cat([image, coverage], dim=1), background, 2)
    assert found.shape == (1, 4, 2, 2)
    torch.testing.assert_close(found[0, :, 0, 0], torch.tensor([-0.3, 0.0, 0.4, 0.5]))
    nothing = object_colors(torch.cat([torch.full((1, 3, 8, 8), background), 0 * coverage], dim=1), background, 2)
    assert not nothing.any()


def test_views_that_agree_on_a_colour_have_no_spread_and_those_that_cannot_see_have_no_say():
    found = torch.tensor([0.1, -0.2, 0.3, 1.0]).expand(1, 3, 1, 4).clone()
    front, framed = torch.zeros(1, 3, 1), torch.ones(1, 3, 1)
    agreed = compared_colors(found, front, framed)
    assert agreed.shape == (1, 1, COLORS)
    assert float(agreed[..., 3:6].max()) < 0.05
    torch.testing.assert_close(agreed[0, 0, :3], torch.tensor([0.2, -0.4, 0.6]), atol=1e-3, rtol=0)
    found[0, 2, 0, :3] = 0.5
    assert float(compared_colors(found, front, framed)[..., 3:6].min()) > 0.5
    front[0, 2, 0] = -5.0  # Far behind what the view shows.
    torch.testing.assert_close(compared_colors(found, front, framed)[0, 0, :6], agreed[0, 0, :6], atol=1e-2, rtol=0)
