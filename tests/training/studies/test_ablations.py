"""The paper's ablations: each is built, takes a step, and is told apart by its checkpoint."""

from dataclasses import replace

import pytest
import torch

from arm_blender import networks
from arm_blender.errors import CheckpointError
from arm_blender.models.atlas_cells import surface_cells
from arm_blender.models.atlas_network import AtlasNetwork
from arm_blender.models.ffc import FfcConfig, FfcGenerator
from arm_blender.models.material_encoder import MaterialEncoderConfig
from arm_blender.models.small.instant_albedo import InstantAlbedoConfig
from arm_blender.models.unet import Unet, UnetConfig
from arm_blender.models.vit import VitConfig
from arm_blender.structures import TexelMap, TexelViews
from arm_blender.weight_files import checkpoints
from training.__main__ import main
from training.datasets.atlas_lookup import AtlasLookup
from training.datasets.atlases import Atlas
from training.stages.instant_albedo import FitConfig, sample_loss
from training.studies.ablated_albedo import ABLATIONS, WHOLE, without

ALL = (WHOLE, *ABLATIONS)
TINY = InstantAlbedoConfig(
    MaterialEncoderConfig(VitConfig(8, 16, 4, 2, 2, 4), (0, 1, 2, 3), 32, 8, 4),
    UnetConfig((8, 8), 8, 2),
    FfcConfig(8, 2, 1),
    resolution=16,
)
SIDE, PIXELS, VIEWS = 32, 24, 3


@pytest.fixture
def sample() -> Atlas:
    """An atlas of one chart with a margin, of which the views show texels one to one, at random."""
    random = torch.Generator().manual_seed(0)

    def rand(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=random)

    mask = torch.zeros(SIDE, SIDE, dtype=torch.bool)
    mask[4:28, 4:28] = True
    seen = TexelViews(
        color=rand(VIEWS, 3, SIDE, SIDE) * mask,
        visibility=mask.expand(VIEWS, -1, -1),
        eyes=4.0 * torch.randn(VIEWS, 3, generator=random),
        cosine=rand(VIEWS, SIDE, SIDE) * mask,
        pixels=PIXELS * rand(VIEWS, SIDE, SIDE, 2),
    )
    rows, columns = torch.meshgrid(torch.arange(4, 28), torch.arange(4, 28), indexing="ij")
    texel = (rows * SIDE + columns)[None, ..., None].expand(VIEWS, -1, -1, 4)
    lookup = AtlasLookup(texel, torch.full(texel.shape, 0.25), torch.ones(texel.shape[:3], dtype=torch.bool))
    position, normal = rand(3, SIDE, SIDE) * mask, rand(3, SIDE, SIDE) * mask
    images, truth = rand(VIEWS, 4, PIXELS, PIXELS), (VIEWS, 3, PIXELS, PIXELS)
    return Atlas(
        images,
        TexelMap(position, normal, mask),
        seen,
        0.2 + 0.5 * rand(3, SIDE, SIDE),
        lookup,
        rand(*truth),
        rand(*truth),
    )


def built(ablation: str) -> AtlasNetwork:
    torch.manual_seed(0)
    model = networks.build("instant_albedo", without(TINY, ablation))
    torch.nn.init.normal_(model.ffc.last.weight, std=0.05)
    return model


@pytest.mark.parametrize("ablation", ALL)
def test_a_step_lowers_the_loss_and_the_checkpoint_says_which(sample, ablation, tmp_path):
    model = built(ablation)
    optimizer = torch.optim.Adam(model.parameters(), 2e-3)
    losses = []
    for _ in range(4):
        loss, _ = sample_loss(model, sample, FitConfig(), torch.Generator().manual_seed(0))
        optimizer.zero_grad()
        loss.backward()
        # Every weight that this ablation has takes part.
        assert all(p.grad is not None and p.grad.isfinite().all() for p in model.parameters())
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < losses[0]
    path = tmp_path / "x.safetensors"
    checkpoints.save(path, model.state_dict(), model.config, "instant_albedo")
    config, state = checkpoints.load(path, *networks.NETWORKS["instant_albedo"])
    assert config == model.config and config == without(TINY, ablation)
    checkpoints.restore(networks.build("instant_albedo", config), state, path)
    if ablation != WHOLE:
        assert config.ablation == ablation
        with pytest.raises(CheckpointError, match="AblatedConfig"):
            checkpoints.load(path, InstantAlbedoConfig)


def outputs(model: AtlasNetwork, sample: Atlas, **changed) -> torch.Tensor:
    sample = replace(sample, **changed)
    with torch.no_grad():
        return torch.cat(model(sample.images, sample.texels, sample.seen, sample.base))


@pytest.mark.parametrize("ablation", ALL)
def test_what_is_left_out_is_not_seen(sample, ablation):
    """Other colours on the atlas, other pictures, another blend: the output changes with what is not left out."""
    model = built(ablation)
    before = outputs(model, sample)
    recolored = outputs(model, sample, seen=replace(sample.seen, color=1.0 - sample.seen.color))
    repainted = outputs(model, sample, images=1.0 - sample.images)
    rebased = outputs(model, sample, base=0.5 * sample.base)
    assert torch.equal(before, recolored) == (ablation == "no-measurements")
    assert torch.equal(before, repainted) == (ablation == "no-material-encoder")
    assert torch.equal(before, rebased) == (ablation in ("no-measurements", "no-super-resolution"))


@pytest.mark.parametrize("ablation", ALL)
def test_views_are_fused_where_they_see(sample, ablation):
    model = built(ablation)
    hidden = torch.zeros_like(sample.texels.mask)
    hidden[:, ::2] = True
    seen = replace(sample.seen, visibility=sample.seen.visibility & ~hidden)
    surface = surface_cells(sample.texels, sample.texels.mask.shape[-1])
    with torch.no_grad():
        known = model._fuse_views(sample.images, sample.texels, seen, surface)[1]
    assert torch.equal(known[0] > 0.0, seen.visibility.any(dim=0))


def test_the_local_network_has_no_spectral_branch():
    assert isinstance(built(WHOLE).ffc, FfcGenerator)
    local = built("local-unet")
    assert isinstance(local.ffc, Unet)
    assert not any("Fourier" in type(part).__name__ for part in local.modules())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--rasterized", "1.5"], "--rasterized 1.5: give a share from 0 to 1"),
        (["--rasterized", "0.5"], "whose shapes? give --shards"),
    ],
)
def test_a_share_needs_shapes(words, message, tmp_path, capsys):
    command = ["fit", "instant-albedo", "--cache", str(tmp_path), "--output", str(tmp_path / "x.safetensors")]
    assert main([*command, *words]) == 1
    assert message in capsys.readouterr().err
