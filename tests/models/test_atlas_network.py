"""Laws of both InstantAlbedos: untrained, ours returns the blend; views have no order, gaps reach no chart."""

from dataclasses import replace

import pytest
import torch

from arm_blender.models.atlas_network import AtlasNetwork, AtlasNetworkConfig
from arm_blender.models.ffc import FfcConfig
from arm_blender.models.material_encoder import MaterialEncoderConfig
from arm_blender.models.paper.instant_albedo import PAPER
from arm_blender.models.small.instant_albedo import SMALL, InstantAlbedo, InstantAlbedoConfig
from arm_blender.models.unet import UnetConfig
from arm_blender.models.vit import VitConfig
from arm_blender.networks import build
from arm_blender.structures import TexelMap, TexelViews

TINY = AtlasNetworkConfig(
    encoder=MaterialEncoderConfig(VitConfig(8, 16, 4, 2, 2, 4), (0, 1, 2, 3), 32, 8, 4),
    unet=UnetConfig((8, 8), 8),
    ffc=FfcConfig(8, 2, 1),
)
RESIDUAL = InstantAlbedoConfig(TINY.encoder, UnetConfig((8, 8), 8, stem_stride=2), TINY.ffc, resolution=16)


def atlas(side: int, views: int = 3, seed: int = 0):
    """images, texels, seen, base of random content; the left third of the atlas is a gap, one row is seen by none."""
    random = torch.Generator().manual_seed(seed)

    def rand(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=random)

    mask = torch.ones(side, side, dtype=torch.bool)
    mask[:, : side // 3] = False
    visible = (rand(views, side, side) > 0.3) & mask
    visible[:, side // 2 : side // 2 + side // 4] = False
    position, normal = (torch.randn(3, side, side, generator=random) * mask for _ in range(2))
    seen = TexelViews(
        color=rand(views, 3, side, side) * visible[:, None],
        visibility=visible,
        eyes=4.0 * torch.randn(views, 3, generator=random),
        cosine=rand(views, side, side) * visible,
        pixels=torch.where(visible[..., None], 40.0 * rand(views, side, side, 2), torch.tensor(float("nan"))),
    )
    return rand(views, 4, 40, 40), TexelMap(position, normal, mask), seen, rand(3, side, side)


def randomised(config: AtlasNetworkConfig) -> AtlasNetwork:
    torch.manual_seed(0)
    model = build("instant_albedo", config)
    torch.nn.init.normal_(model.ffc.last.weight, std=0.05)
    return model


@pytest.mark.parametrize("side", [16, 40, 64])
def test_untrained_residual_network_returns_the_blend(side):
    torch.manual_seed(0)
    images, texels, seen, base = atlas(side)
    with torch.no_grad():
        albedo, baked = InstantAlbedo(RESIDUAL)(images, texels, seen, base)
    assert torch.equal(albedo, base)
    assert torch.equal(baked, base)


@pytest.mark.parametrize("side", [16, 48])
def test_the_baked_colour_of_what_a_view_sees_is_what_it_sees(side):
    images, texels, seen, base = atlas(side)
    # Whole cells of the network, and far enough from others that none is mixed in.
    visible = texels.mask.clone()
    visible[side // 2 :] = False
    seen = replace(seen, visibility=visible.expand_as(seen.visibility), color=seen.color.nan_to_num())
    with torch.no_grad():
        albedo, baked = randomised(RESIDUAL)(images, texels, replace(seen, pixels=seen.pixels.nan_to_num()), base)
    here = visible.clone()
    here[side // 2 - side // 16 :] = False
    torch.testing.assert_close(baked[:, here], base[:, here], rtol=0.0, atol=1e-6)
    assert not torch.allclose(albedo[:, here], base[:, here], atol=1e-3)
    assert not torch.allclose(baked[:, texels.mask & ~visible], base[:, texels.mask & ~visible], atol=1e-3)


@pytest.mark.parametrize("config", [TINY, RESIDUAL])
def test_views_have_no_order(config):
    model = randomised(config)
    images, texels, seen, base = atlas(16)
    order = [2, 0, 1]
    with torch.no_grad():
        expected = model(images, texels, seen, base)
        found = model(images[order], texels, seen.only(torch.tensor(order)), base)
    assert all(torch.allclose(a, b, atol=1e-5) for a, b in zip(found, expected, strict=True))


@pytest.mark.parametrize("config", [TINY, RESIDUAL])
@pytest.mark.parametrize("views", [1, 4])
def test_colours_stay_in_range_for_any_number_of_views(config, views):
    with torch.no_grad():
        for color in randomised(config)(*atlas(16, views)):
            assert color.shape == (3, 16, 16)
            assert color.isfinite().all()
            assert color.min() >= 0.0
            assert color.max() <= 1.0


def test_a_view_that_sees_nothing_changes_nothing_but_is_allowed():
    model = randomised(TINY)
    images, texels, seen, base = atlas(16)
    blind = TexelViews(*(torch.zeros_like(getattr(seen, name)[:1]) for name in TexelViews.__dataclass_fields__))
    both = TexelViews(
        *(torch.cat([getattr(seen, name), getattr(blind, name)]) for name in TexelViews.__dataclass_fields__)
    )
    with torch.no_grad():
        expected = model(images, texels, seen, base)
        found = model(torch.cat([images, images[:1]]), texels, both, base)
        alone = model(images[:1], texels, blind, base)
    assert all(torch.allclose(a, b, atol=1e-6) for a, b in zip(found, expected, strict=True))
    assert all(color.isfinite().all() for color in alone)


def test_gap_values_of_the_network_never_reach_a_chart(monkeypatch):
    """At full resolution a covered texel takes its correction from covered cells alone."""
    images, texels, seen, base = atlas(64)
    model = InstantAlbedo(RESIDUAL)
    covered = torch.nn.functional.avg_pool2d(texels.mask[None].float(), 4) > 0
    for inside, outside in ((0.5, 100.0), (0.5, -100.0)):
        prediction = torch.where(covered, inside, outside).expand(1, 6, 16, 16)
        monkeypatch.setattr(model.ffc, "forward", lambda x, p=prediction: p)
        with torch.no_grad():
            baked = model(images, texels, seen, base)[1]
        if outside > 0:
            first = baked[:, texels.mask]
    assert torch.allclose(first, baked[:, texels.mask], atol=1e-5)


def test_detail_finer_than_the_network_comes_through(monkeypatch):
    """A constant correction scales all of the albedo alike, so that a checkerboard of single texels stays one."""
    images, texels, seen, _ = atlas(64)
    checker = (torch.arange(64)[:, None] + torch.arange(64)) % 2
    base = 0.1 + 0.4 * checker.float().expand(3, 64, 64)
    model = InstantAlbedo(RESIDUAL)
    monkeypatch.setattr(model.ffc, "forward", lambda x: torch.full((1, 6, 16, 16), -0.3))
    with torch.no_grad():
        albedo = model(images, texels, seen, base)[0]
    dark, bright = (albedo[0][texels.mask & (checker == k)] for k in (0, 1))
    assert dark.max() - dark.min() < 1e-6
    # (0.5 + d) / (0.1 + d) is what scaling by one factor keeps, d = 0.02.
    assert ((bright.mean() + 0.02) / (dark.mean() + 0.02)).item() == pytest.approx(0.52 / 0.12, rel=1e-4)


def test_every_part_learns():
    model = randomised(RESIDUAL)
    albedo, baked = model(*atlas(16))
    (albedo.square().sum() + baked.square().sum()).backward()
    assert [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []


def test_wrong_shapes_are_named():
    images, texels, seen, base = atlas(16)
    model = InstantAlbedo(RESIDUAL)
    with pytest.raises(ValueError, match="2 images, 3 views"):
        model(images[:2], texels, seen, base)
    with pytest.raises(ValueError, match=r"base \(3, 8, 8\)"):
        model(images, texels, seen, base[:, :8, :8])
    with pytest.raises(ValueError, match="15 is no multiple of 4"):
        model(*atlas(15))


def test_presets_construct_without_memory():
    with torch.device("meta"):
        sizes = [sum(p.numel() for p in build("instant_albedo", config).parameters()) for config in (PAPER, SMALL)]
    assert 100e6 < sizes[0] < 130e6  # ViT-B (86 million), its cascade, LaMa's generator (14 million), the U-Net.
    assert sizes[1] < 1.5e6
