"""The transformer gives DINO's numbers: stored outputs of the public code under random weights."""

from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from arm_blender.models.vit import VisionTransformer, VitConfig, resampled_position

FIXTURE = load_file(Path(__file__).parents[1] / "data/parity/dino_vit_patch8.safetensors")


@pytest.fixture(scope="module")
def vit():
    module = VisionTransformer(VitConfig(patch=8, dim=32, depth=2, heads=2, grid=4))
    prefix = "weights/"
    module.load_state_dict({k.removeprefix(prefix): v for k, v in FIXTURE.items() if k.startswith(prefix)})
    return module


@pytest.mark.parametrize("size", ["nonsquare_h48_w40", "smaller_24x24"])
def test_blocks_equal_the_published_network(vit, size):
    images = FIXTURE[f"input/{size}"]
    with torch.no_grad():
        blocks = vit(images, (0, 1))
    for index, tokens in enumerate(blocks):
        expected = FIXTURE[f"output/block_{index}/{size}"]
        assert (tokens - expected).abs().max() <= 1e-5 * expected.abs().max()


@pytest.mark.parametrize(("size", "grid"), [("nonsquare_h48_w40", (6, 5)), ("smaller_24x24", (3, 3))])
def test_position_embedding_is_interpolated_as_published(vit, size, grid):
    expected = FIXTURE[f"output/position_embedding/{size}"]
    assert (resampled_position(vit.pos_embed, *grid) - expected).abs().max() <= 1e-5 * expected.abs().max()


def test_blocks_behind_the_last_tap_do_not_matter(vit):
    images = FIXTURE["input/smaller_24x24"]
    shallow = VisionTransformer(VitConfig(patch=8, dim=32, depth=1, heads=2, grid=4))
    shallow.load_state_dict({k: v for k, v in vit.state_dict().items() if not k.startswith("blocks.1.")})
    assert torch.equal(vit(images, (0,))[0], shallow(images, (0,))[0])


def test_size_that_is_no_multiple_of_the_patch_is_refused(vit):
    with pytest.raises(ValueError, match="multiple of 8, got 30 x 32"):
        vit(torch.zeros(1, 3, 30, 32), (0,))
