"""The cut-out network: shapes, types, and an answer that does not depend on what else is in the batch."""

import pytest
import torch

from arm_blender.models.small.cutout import Cutout, CutoutConfig

TINY = CutoutConfig(widths=(4, 8, 8, 16), heads=2, attention_layers=1)


@pytest.fixture(scope="module")
def network() -> Cutout:
    torch.manual_seed(0)
    return Cutout(TINY).eval()


@pytest.mark.parametrize("size", [(64, 64), (48, 96), (16, 16)])
@pytest.mark.parametrize("kind", [torch.float32, torch.float64])
def test_every_pixel_has_a_logit_of_the_pictures_kind(network, size, kind):
    picture = torch.rand(2, 3, *size, generator=torch.Generator().manual_seed(1)).to(kind)
    logits = network.to(kind)(picture)
    network.float()
    assert logits.shape == (2, 1, *size) and logits.dtype == kind


def test_pictures_of_a_batch_do_not_know_each_other(network):
    pictures = torch.rand(3, 3, 32, 48, generator=torch.Generator().manual_seed(2))
    alone = torch.cat([network(picture[None]) for picture in pictures])
    assert torch.allclose(network(pictures), alone, atol=1e-5)


def test_what_is_far_away_counts(network):
    """Attention carries a change in one corner to the opposite one, beyond the reach of the convolutions."""
    picture = torch.rand(1, 3, 256, 256, generator=torch.Generator().manual_seed(3), requires_grad=True)
    network(picture)[0, 0, :8, :8].sum().backward()
    assert float(picture.grad[0, :, -8:, -8:].abs().max()) > 0.0


@pytest.mark.parametrize("shape", [(1, 3, 60, 64), (1, 4, 64, 64), (3, 64, 64)])
def test_a_wrong_shape_is_named(network, shape):
    with pytest.raises(ValueError, match="multiples of 16"):
        network(torch.zeros(shape))
