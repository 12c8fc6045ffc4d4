"""Planes and their upsampler give the published numbers: InstantMesh's sampling, ESRGAN's blocks."""

import pytest
import torch
from torch.nn import functional

from arm_blender.models.triplane import ResidualDenseBlock, Upsampler, UpsamplerConfig, sample_planes


def dense_blocks(theirs: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """ESRGAN's names as ours; both count, they from one."""
    ours = {}
    for key, tensor in theirs.items():
        for block in range(3):
            key = key.replace(f"RDB{block + 1}.", f"blocks.{block}.")
        for conv in range(5):
            key = key.replace(f".conv{conv + 1}.", f".convs.{conv}.")
        ours[key.replace("conv_first", "head").replace("RRDB_trunk", "trunk").replace("trunk_conv", "trunk.2")] = tensor
    return ours


@torch.no_grad()
def test_residual_dense_block_equals_the_published_one(parity):
    fixture = parity("esrgan_rrdb")
    block = ResidualDenseBlock(8, 4)
    block.load_state_dict(dense_blocks(fixture.weights))
    fixture.check(block.blocks[0](fixture.inputs["x"]), "after_first_dense_block")
    fixture.check(block(fixture.inputs["x"]), "y")


@torch.no_grad()
def test_trunk_equals_the_published_one(parity):
    """Up to the first doubling; the paper's three convolutions, a doubling each, are not ESRGAN's two and two."""
    fixture = parity("esrgan_rrdbnet")
    upsampler = Upsampler(UpsamplerConfig(filters=8, blocks=2, growth=4), width=3)
    missing, unexpected = upsampler.load_state_dict(dense_blocks(fixture.weights), strict=False)
    assert not unexpected and all(key.startswith("up.") for key in missing)
    first = upsampler.head(fixture.inputs["x"])
    fixture.check(first, "after_conv_first")
    fixture.check(upsampler.trunk[1](upsampler.trunk[0](first)), "after_blocks")
    fixture.check(upsampler.features(fixture.inputs["x"]), "after_trunk_skip")


@torch.no_grad()
def test_planes_are_sampled_as_published(parity):
    fixture = parity("instantmesh_triplane_points")
    points = fixture.inputs["points"]
    square = sample_planes(fixture.inputs["planes"], points).unflatten(-1, (3, -1)).movedim(2, 1)
    fixture.check(square, "plane_features")
    oblong = sample_planes(fixture.inputs["planes_rectangular"], points[:1]).unflatten(-1, (3, -1)).movedim(2, 1)
    fixture.check(oblong, "plane_features_rectangular")


@pytest.fixture
def warm():
    torch.manual_seed(0)
    return Upsampler(UpsamplerConfig(filters=8, blocks=1, growth=4, doublings=3, channels=5, deconvolution=True), 6)


def test_super_resolution_starts_as_the_enlarged_deconvolution_and_learns(warm):
    coarse = torch.randn(3, 6, 4, 4)
    planes = warm(coarse)
    expected = functional.interpolate(warm.deconv(coarse), size=(32, 32), mode="bilinear", align_corners=False)
    torch.testing.assert_close(planes, expected)
    planes.square().sum().backward()
    assert warm.up[-1].weight.grad.any() and warm.deconv.weight.grad.any()


@torch.no_grad()
@pytest.mark.parametrize("learnt", ["weight", "bias"])
def test_what_was_learnt_is_added_at_inference(warm, learnt):
    coarse = torch.randn(3, 6, 4, 4)
    start = warm(coarse)
    getattr(warm.up[-1], learnt)[0] = 0.3
    torch.testing.assert_close(warm(coarse), start + warm.detail(coarse))
    assert not torch.equal(warm(coarse), start)


def test_planes_are_xy_xz_zy_with_the_first_coordinate_along_the_width():
    ramp = torch.linspace(-1, 1, 64) * (64 - 1) / 64  # Texel centres of [-1, 1].
    planes = ramp.expand(64, 64).view(1, 1, 1, 64, 64).expand(1, 3, 1, -1, -1)
    found = sample_planes(planes, torch.tensor([[[0.1, 0.2, 0.3]]]))[0, 0]
    assert torch.allclose(found, torch.tensor([0.1, 0.1, 0.3]), atol=1e-5)
