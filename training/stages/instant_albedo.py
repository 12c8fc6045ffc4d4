"""Fit InstantAlbedo: predicted atlases, rendered into the truth views, against what the views show (ARM, section 5.4).

The loss is the paper's, in image space over all views of a rig; a render is a look-up, as each pixel's place in the
atlas is known beforehand (`training.datasets.atlases`).
"""

import argparse
import logging
import math
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from arm_blender import checkpoints
from arm_blender.graphics.color import srgb_from_linear
from arm_blender.models.instant_albedo import SMALL, InstantAlbedo, InstantAlbedoConfig
from arm_blender.structures import TexelMap

from .. import distributed, options
from ..datasets import atlases
from ..datasets.atlases import Atlas
from ..losses import ImageLossConfig, Perceptual, image_loss
from ..lpips import Lpips
from ..trainer import Trainer, TrainerConfig

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class FitConfig:
    """What one step compares, and what is kept for validation."""

    views: int = 10
    """Truth views compared in a step, drawn anew each time; fewer are faster and noisier."""
    held_out: int = 20
    """One object in so many is kept for validation."""
    validate: int = 16
    """Held-out samples at most in a validation."""
    loss: ImageLossConfig = ImageLossConfig()
    """Balance of the image loss."""
    perceptual: Perceptual | None = None
    """LPIPS where its weights are at hand; without it the loss has no perceptual term."""


def fit(
    cache: Path,
    config: InstantAlbedoConfig,
    output: Path,
    trainer_config: TrainerConfig,
    seed: int = 0,
    settings: FitConfig = FitConfig(),
) -> InstantAlbedo:
    """Fit until the time is up and write the averaged weights; goes on from `<output>.resume` where there is one.

    Args:
        cache: samples made by `atlases.prepare`.
        output: of the checkpoint.
    Raises:
        ArmError: there are no samples.
    """
    torch.manual_seed(seed)
    training, held_out = split(atlases.files(cache), settings.held_out)
    logger.info("%d samples, %d held out", len(training), len(held_out))
    output.parent.mkdir(parents=True, exist_ok=True)
    loop = Trainer(InstantAlbedo(config), trainer_config, output.with_suffix(".resume"))

    def step(index: int) -> tuple[Tensor, dict[str, float]]:
        random = distributed.generator(seed, index)
        return sample_loss(loop.model, draw(training, random), settings, random)

    averaged = loop.run(step, lambda model: validate(model, held_out, settings))
    metadata = {"steps": str(loop.step), "samples": str(len(training))}
    if distributed.rank() == 0:
        checkpoints.save(output, averaged.state_dict(), config, "small.instant_albedo", metadata, half=True)
    return averaged


def sample_loss(
    model: InstantAlbedo, atlas: Atlas, settings: FitConfig, random: torch.Generator
) -> tuple[Tensor, dict[str, float]]:
    """Loss of the prediction, with gradient, and that of the blend of the views, which is what it must beat."""
    views = torch.randperm(len(atlas.uv), generator=random)[: settings.views]
    albedo, baked = model(atlas.images, atlas.texels, atlas.seen, atlas.base)
    loss = atlas_loss(albedo, baked, atlas, views, settings)
    with torch.no_grad():
        blend = atlas_loss(atlas.base, atlas.base, atlas, views, settings)
    return loss, {"blend": float(blend)}


def atlas_loss(albedo: Tensor, baked: Tensor, atlas: Atlas, views: Tensor, settings: FitConfig) -> Tensor:
    """The paper's L_albedo of two predicted textures (3, T, T), linear, over the truth views with these indices."""
    rows, columns = _window(atlas.mask[views])
    uv, mask = atlas.uv[views, rows, columns], atlas.mask[views, rows, columns]
    truth = (image[views, :, rows, columns] for image in (atlas.baked, atlas.albedo))
    return sum(
        image_loss(render(x, uv), y, mask, settings.loss, settings.perceptual)
        for x, y in zip((baked, albedo), truth, strict=True)
    )


def _window(mask: Tensor) -> tuple[slice, slice]:
    """Rows and columns around what any of the masks (V, S, S) shows; at least 11 of each, as SSIM needs.

    Nothing outside counts, and looking it up would take half of a step.
    """
    size, found = mask.shape[-1], []
    for axis in (2, 1):
        shown = mask.any(dim=axis).any(dim=0).nonzero()[:, 0]
        low, high = (int(shown[0]), int(shown[-1]) + 1) if len(shown) else (0, 0)
        # Half a window of SSIM on each side.
        found.append(slice(max(0, min(low - 5, size - 11)), min(size, max(high + 5, 11))))
    return found[0], found[1]


def render(texture: Tensor, uv: Tensor) -> Tensor:
    """(V, 3, S, S) sRGB: a linear texture (3, T, T) looked up at uv (V, S, S, 2), v up."""
    grid = torch.stack([2.0 * uv[..., 0] - 1.0, 1.0 - 2.0 * uv[..., 1]], dim=-1)
    looked_up = functional.grid_sample(
        texture.expand(len(uv), -1, -1, -1), grid, padding_mode="border", align_corners=False
    )
    return srgb_from_linear(looked_up)


def augment(atlas: Atlas, channels: Tensor, angle: float) -> Atlas:
    """The same object in other colours and turned about the vertical: its colours' channels permuted, its surface
    positions and directions rotated by `angle` radians. Truth and input change alike.

    Args:
        channels: permutation of (0, 1, 2).
    """
    c, s = math.cos(angle), math.sin(angle)
    turn = torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def turned(x: Tensor) -> Tensor:
        return torch.einsum("ij,...jhw->...ihw", turn, x)

    seen, texels = atlas.seen, atlas.texels
    return Atlas(
        images=atlas.images[:, [*channels.tolist(), 3]],
        texels=TexelMap(turned(texels.position), turned(texels.normal), texels.mask),
        seen=replace(seen, color=seen.color[:, channels], eyes=seen.eyes @ turn.T),
        base=atlas.base[channels],
        uv=atlas.uv,
        mask=atlas.mask,
        baked=atlas.baked[:, channels],
        albedo=atlas.albedo[:, channels],
    )


def split(files: list[Path], held_out: int) -> tuple[list[Path], list[Path]]:
    """Training and validation samples; all rigs of an object (the name up to the first dot) fall on one side."""
    owners = sorted({path.name.split(".")[0] for path in files})
    chosen = set(owners[held_out - 1 :: held_out])
    training = [path for path in files if path.name.split(".")[0] not in chosen]
    return training, [path for path in files if path.name.split(".")[0] in chosen]


@torch.no_grad()
def validate(model: InstantAlbedo, files: list[Path], settings: FitConfig) -> dict[str, float]:
    """Mean PSNR in dB of albedo and baked colour over the truth views, all input views given; of the blend as well."""
    found = {"albedo": [], "baked": [], "blend as albedo": [], "blend as baked": []}
    for path in files[: settings.validate]:
        atlas = atlases.load(path, 0)
        albedo, baked = model(atlas.images, atlas.texels, atlas.seen, atlas.base)
        inside = atlas.mask[:, None].expand(-1, 3, -1, -1)
        if not inside.any():
            continue
        pairs = ((albedo, atlas.albedo), (baked, atlas.baked), (atlas.base, atlas.albedo), (atlas.base, atlas.baked))
        for values, (texture, truth) in zip(found.values(), pairs, strict=True):
            error = (render(texture, atlas.uv) - truth)[inside].square().mean()
            values.append(float(-10.0 * torch.log10(error.clamp(min=1e-10))))
    return {name: sum(values) / len(values) for name, values in found.items() if values}


def draw(files: list[Path], random: torch.Generator) -> Atlas:
    """A random sample with a random choice of input views, augmented."""
    path = files[int(torch.randint(len(files), (), generator=random))]
    atlas = atlases.load(path, int(torch.randint(1 << 16, (), generator=random)))
    angle = 2.0 * math.pi * float(torch.rand((), generator=random))
    return augment(atlas, torch.randperm(3, generator=random), angle)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What `python -m training fit instant-albedo` takes."""
    parser.add_argument("--shards", type=Path, help="rendered objects; prepared into --cache where they are not yet")
    parser.add_argument("--cache", type=Path, required=True, help="folder of prepared samples")
    parser.add_argument("--output", type=Path, required=True, help="checkpoint to write")
    parser.add_argument("--size", type=int, default=192, help="texels a side of the prepared atlases")
    parser.add_argument("--views", type=int, default=FitConfig.views, help="truth views compared in a step")
    parser.add_argument("--lpips", type=Path, help="weights of LPIPS (VGG); without them its term is left out")
    options.add_loop_arguments(parser, minutes=25.0, learning_rate=4e-4)  # The paper's rate. No minutes: prepare only.


def run(args: argparse.Namespace) -> int:
    """Prepare and fit; returns the exit status."""
    if args.shards is not None:
        count = atlases.prepare(args.shards, args.cache, atlases.AtlasConfig(size=args.size), args.seed)
        logger.info("%d samples in %s", count, args.cache)
    if args.minutes > 0:
        config = options.config(args)
        settings = FitConfig(views=args.views, perceptual=Lpips.from_file(args.lpips) if args.lpips else None)
        fit(args.cache, SMALL, args.output, config, args.seed, settings)
    return 0
