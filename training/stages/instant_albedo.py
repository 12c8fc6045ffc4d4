"""Fit InstantAlbedo: predicted atlases, rendered into the truth views, against what the views show (ARM, section 5.4).

The loss is the paper's, in image space over all views of a rig; a render is a look-up, as each pixel's face is known
beforehand (`training.datasets.atlas_lookup`).
"""

import argparse
import logging
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor, nn

from arm_blender.errors import ArmError
from arm_blender.graphics.color import srgb_from_linear
from arm_blender.weight_files import checkpoints

from .. import distributed, options
from ..datasets import atlases
from ..datasets.atlas_augmentation import augmented
from ..datasets.atlases import Atlas
from ..datasets.rasterized_atlases import RasterizedAtlases
from ..datasets.view_samples import on_device
from ..losses import Perceptual, image_loss
from ..lpips import Lpips
from ..options import TrainerConfig
from ..rasterized.pictures import read_library
from ..rendering.shards import meshes
from ..run_record import RunRecord
from ..trainer import Trainer
from .instant_albedo_start import SIZES, Start, start_of

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class FitConfig:
    """What one step and a validation compare."""

    views: int = 10
    """Truth views compared in a step, drawn anew each time; fewer are faster and noisier."""
    validate: int = 16
    """Held-out samples at most in a validation."""
    perceptual: Perceptual | None = None
    """LPIPS where its weights are at hand; without it the loss has no perceptual term."""
    bfloat16: bool = False
    """Predict so in training; the loss is in float32."""
    device: str = "cpu"
    """Where the network is; samples are made on the processor."""


@dataclass(frozen=True)
class Samples:
    """Where a fit's samples come from."""

    cache: Path
    """Of those made by `atlases.prepare`."""
    held_out: int = 20
    """One object in so many is kept for validation."""
    rasterized: RasterizedAtlases | None = None
    """Makes samples on the fly; held-out objects are taken out of it."""
    share: float = 0.0
    """Of the samples that are rasterised on the fly; the others are Cycles' renders."""


def fit(
    start: Start,
    samples: Samples,
    output: Path,
    trainer_config: TrainerConfig,
    settings: FitConfig = FitConfig(),
    record: RunRecord | None = None,
) -> nn.Module:
    """Fit until the time is up and write the averaged weights; goes on from `<output>.resume` where there is one.

    Args:
        output: of the checkpoint.
        record: of the run.
    Raises:
        ArmError: there are no samples, or the prior is not for this network.
    """
    seed, rasterized = trainer_config.seed, samples.rasterized
    torch.manual_seed(seed)
    training, held_out = split(atlases.files(samples.cache), samples.held_out)
    logger.info("%d samples, %d held out", len(training), len(held_out))
    device = distributed.device(settings.device)
    model = start.network().to(device)
    if rasterized is not None:
        hidden = {owner(path) for path in held_out}
        rasterized = replace(rasterized, meshes=[p for p in rasterized.meshes if owner(p.parent) not in hidden])
    loop = Trainer(model, trainer_config, output.with_suffix(".resume"), record)

    def step(index: int) -> tuple[Tensor, dict[str, float]]:
        random = distributed.generator(seed, index)
        if rasterized is not None and float(torch.rand((), generator=random)) < samples.share:
            atlas = augmented(rasterized.draw(random), random)
        else:
            atlas = draw(training, random)
        return sample_loss(loop.model, on_device(atlas, device), settings, random)

    averaged = loop.run(step, lambda model: validate(model, held_out, settings))
    metadata = {
        "steps": str(loop.step),
        "samples": str(len(training)),
        "rasterized_share": str(samples.share),
        "material_prior": "random" if start.material_prior is None else start.material_prior.name,
    }
    if distributed.rank() == 0:
        name = f"{start.preset}.instant_albedo"
        checkpoints.save(output, averaged.state_dict(), start.config, name, metadata, half=True)
    return averaged


def sample_loss(
    model: nn.Module, atlas: Atlas, settings: FitConfig, random: torch.Generator
) -> tuple[Tensor, dict[str, float]]:
    """Loss of the prediction, with gradient, and that of the blend of the views, which is what it must beat."""
    views = torch.randperm(len(atlas.baked), generator=random)[: settings.views]
    with torch.autocast(atlas.base.device.type, torch.bfloat16, enabled=settings.bfloat16):
        albedo, baked = model(atlas.images, atlas.texels, atlas.seen, atlas.base)
    albedo, baked = albedo.float(), baked.float()
    loss = atlas_loss(albedo, baked, atlas, views, settings)
    with torch.no_grad():
        blend = atlas_loss(atlas.base, atlas.base, atlas, views, settings)
    return loss, {"blend": float(blend)}


def atlas_loss(albedo: Tensor, baked: Tensor, atlas: Atlas, views: Tensor, settings: FitConfig) -> Tensor:
    """The paper's L_albedo (equation 4) over the truth views with these indices, where both shapes show something.

    Args:
        albedo, baked: (3, T, T) linear, predicted.
    """
    rows, columns = _window(atlas.lookup.mask[views])
    lookup = atlas.lookup.part(views, rows, columns)
    shown = lookup.render(torch.cat([baked, albedo])).split(3, dim=1)
    of_baked, of_albedo = (
        image_loss(srgb_from_linear(x), y[views, :, rows, columns], lookup.mask, perceptual=settings.perceptual)
        for x, y in zip(shown, (atlas.baked, atlas.albedo), strict=True)
    )
    return of_baked + of_albedo


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


def owner(path: Path) -> str:
    """The object of a sample or of a folder of shards: its name up to the first dot."""
    return path.name.split(".")[0]


def split(files: list[Path], held_out: int) -> tuple[list[Path], list[Path]]:
    """Training and validation samples; all rigs of an object fall on one side."""
    owners = sorted({owner(path) for path in files})
    chosen = set(owners[held_out - 1 :: held_out])
    training = [path for path in files if owner(path) not in chosen]
    return training, [path for path in files if owner(path) in chosen]


@torch.no_grad()
def validate(model: nn.Module, files: list[Path], settings: FitConfig) -> dict[str, float]:
    """Mean PSNR in dB of albedo and baked colour over the truth views, all input views given; of the blend as well."""
    found: dict[str, list[float]] = {}
    for path in files[: settings.validate]:
        atlas = on_device(atlases.load(path, 0), distributed.device(settings.device))
        if not atlas.lookup.mask.any():
            continue
        albedo, baked = model(atlas.images, atlas.texels, atlas.seen, atlas.base)
        pairs = {
            "albedo": (srgb_from_linear(albedo), atlas.albedo),
            "baked": (srgb_from_linear(baked), atlas.baked),
            "blend as albedo": (srgb_from_linear(atlas.base), atlas.albedo),
            "blend as baked": (srgb_from_linear(atlas.base), atlas.baked),
        }
        for name, (texture, truth) in pairs.items():
            error = (atlas.lookup.render(texture) - truth).movedim(1, -1)[atlas.lookup.mask].square().mean()
            found.setdefault(name, []).append(float(-10.0 * torch.log10(error.clamp(min=1e-10))))
    return {name: sum(values) / len(values) for name, values in found.items()}


def draw(files: list[Path], random: torch.Generator) -> Atlas:
    """A random sample with a random choice of input views, augmented."""
    path = files[int(torch.randint(len(files), (), generator=random))]
    return augmented(atlases.load(path, int(torch.randint(1 << 16, (), generator=random))), random)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What `python -m training fit instant-albedo` takes."""
    parser.add_argument("--shards", type=Path, help="rendered objects; prepared into --cache where they are not yet")
    parser.add_argument("--cache", type=Path, required=True, help="folder of prepared samples")
    parser.add_argument("--output", type=Path, required=True, help="checkpoint to write")
    parser.add_argument(
        "--size", type=int, default=atlases.AtlasConfig.size, help="texels a side of the prepared atlases"
    )
    parser.add_argument("--views", type=int, default=FitConfig.views, help="truth views compared in a step")
    parser.add_argument("--lpips", type=Path, help="weights of LPIPS (VGG); without them its term is left out")
    parser.add_argument("--preset", choices=SIZES, default="small", help="sizes of the network")
    parser.add_argument("--material-prior", type=Path, help="weights of `fit material-prior` for the encoder")
    parser.add_argument("--delighting", type=Path, help="weights of `fit delighting`; without them it is left out")
    parser.add_argument("--start", type=Path, help="InstantAlbedo's own weights to go on from")
    parser.add_argument(
        "--rasterized", type=float, default=Samples.share, help="share of samples rasterised on the fly, 0 to 1"
    )
    parser.add_argument("--data", type=Path, help="textures and environments of those; ARM_DATA by default")
    options.add_device_arguments(parser)
    options.add_loop_arguments(parser, minutes=25.0, learning_rate=4e-4)  # The paper's rate. No minutes: prepare only.


def run(args: argparse.Namespace) -> int:
    """Prepare and fit; returns the exit status."""
    if args.shards is not None:
        count = atlases.prepare(args.shards, args.cache, atlases.AtlasConfig(size=args.size), args.seed)
        logger.info("%d samples in %s", count, args.cache)
    if args.minutes > 0:
        config, record = options.config(args), RunRecord.beside(args.output, vars(args))
        perceptual = Lpips.from_file(args.lpips) if args.lpips else None
        samples = Samples(args.cache, rasterized=_rasterized(args), share=args.rasterized)
        settings = FitConfig(args.views, perceptual=perceptual, bfloat16=args.bfloat16, device=args.device)
        fit(start_of(args), samples, args.output, config, settings, record)
    return 0


def _rasterized(args: argparse.Namespace) -> RasterizedAtlases | None:
    """What makes samples on the fly, where some are asked for."""
    if not 0.0 <= args.rasterized <= 1.0:
        raise ArmError(f"--rasterized {args.rasterized:g}: give a share from 0 to 1")
    if args.rasterized == 0.0:
        return None
    if args.shards is None:
        raise ArmError("--rasterized: whose shapes? give --shards")
    config = atlases.AtlasConfig(size=args.size)
    return RasterizedAtlases(meshes(args.shards), args.cache / "shapes", read_library(args.data), config=config)
