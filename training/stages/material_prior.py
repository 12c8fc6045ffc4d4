"""Pretrain InstantAlbedo's material-aware encoder: which material does each pixel show, with which BRDF (ARM, 5.3).

The paper begins with weights that were "trained on a dataset with semantic material maps". Ours sees objects under our
own materials, rasterised on the fly: per pixel the kind of material, albedo, roughness and metallic are known. One
linear map reads them off the encoder's features, so that these hold them; it is dropped afterwards.
"""

import argparse
import logging
from dataclasses import dataclass, fields
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from arm_blender.errors import ArmError
from arm_blender.graphics.color import composite
from arm_blender.models.material_encoder import MaterialEncoder, MaterialEncoderConfig
from arm_blender.weight_files import checkpoints

from .. import distributed, options
from ..datasets.view_samples import on_device
from ..options import TrainerConfig
from ..rasterized.pictures import Library, random_rig, read_library, surface_at
from ..rasterized.textures import LABELS, NOTHING
from ..rendering import shards
from ..run_record import RunRecord
from ..trainer import Trainer
from .instant_albedo_start import SIZES

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class PriorConfig:
    """What one step sees, and what is kept for validation."""

    objects: int = 2
    """Objects a step. One alone shows few materials, and its gradient points at them."""
    views: int = 2
    """Pictures of each, 1 to 10."""
    label: float = 0.3
    """Weight of the kinds' cross entropy; that of the BRDF's mean absolute error is 1."""
    held_out: int = 20
    """One object in so many is kept for validation."""
    validate: int = 20
    """Held-out objects at most in a validation."""
    bfloat16: bool = False
    """Predict so in training; the loss is in float32."""
    device: str = "cpu"
    """Where the network is; samples are made on the processor."""


@dataclass(frozen=True)
class Scenes:
    """What is shown."""

    meshes: list[Path]
    """`mesh.npz` files."""
    cache: Path
    """Where their surfaces are kept."""
    library: Library
    """Of materials and light."""

    def drawn(self, path: Path, size: int, views: int, random: torch.Generator) -> "MaterialSample":
        """Pictures of `size` pixels a side of one of the meshes, under random materials and light."""
        return material_sample(random_rig(surface_at(path, self.cache), self.library, size, random, views))


@dataclass(frozen=True)
class MaterialSample:
    """V pictures of S x S pixels whose materials are known.

    Attributes:
        images: (V, 3, S, S) sRGB on white, as InstantAlbedo shows them to its encoder.
        label: (V, S, S) int64: index into `LABELS`, `NOTHING` where there is none.
        values: (V, 5, S, S): sRGB albedo, roughness, metallic.
    """

    images: Tensor
    label: Tensor
    values: Tensor


class MaterialPrior(nn.Module):
    """The encoder and a linear map from its features to kinds and BRDF parameters."""

    def __init__(self, config: MaterialEncoderConfig) -> None:
        super().__init__()
        self.encoder = MaterialEncoder(config)
        self.head = nn.Conv2d(config.out_channels, len(LABELS) + 5, 1)

    @property
    def size(self) -> int:
        """Pixels a side of what is predicted."""
        config = self.encoder.config
        return 8 * config.image_size // config.vit.patch

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Images (V, 3, H, W) sRGB -> (V, kinds, S, S) logits, (V, 5, S, S) sRGB albedo, roughness, metallic.

        The numbers have no bounds: through a sigmoid, exact 0 and 1 have no gradient left to be unlearnt by.
        """
        found = self.head(self.encoder(images))
        return found[:, : len(LABELS)], found[:, len(LABELS) :]


def material_sample(rig: shards.Arrays) -> MaterialSample:
    """The pictures of a rasterised rig."""
    rgba = torch.from_numpy(rig["rgba"]).permute(0, 3, 1, 2) / 255.0
    gloss = torch.stack([torch.from_numpy(rig[name]) for name in ("roughness", "metallic")], dim=1)
    values = torch.cat([torch.from_numpy(rig["albedo"]).permute(0, 3, 1, 2), gloss], dim=1) / 255.0
    images = composite(rgba[:, :3], rgba[:, 3:], 1.0)
    return MaterialSample(images, torch.from_numpy(rig["material"]).long(), values)


def joined(samples: list[MaterialSample]) -> MaterialSample:
    """The pictures of several samples."""
    return MaterialSample(*(torch.cat([getattr(x, f.name) for x in samples]) for f in fields(MaterialSample)))


def prior_loss(model: MaterialPrior, sample: MaterialSample, config: PriorConfig) -> tuple[Tensor, dict[str, float]]:
    """Cross entropy of the kinds and mean absolute error of the BRDF, over the pixels that show something.

    Pictures without any object cost 0, and have a gradient of 0.
    """
    with torch.autocast(sample.images.device.type, torch.bfloat16, enabled=config.bfloat16):
        logits, values = model(sample.images)
    logits, values = logits.float(), values.float()
    inside = sample.label != NOTHING
    count = inside.sum().clamp(min=1)
    entropy = functional.cross_entropy(logits, sample.label, ignore_index=NOTHING, reduction="sum") / count
    error = ((values - sample.values).abs().mean(dim=1) * inside).sum() / count
    right = float(((logits.argmax(dim=1) == sample.label) & inside).sum() / count)
    return config.label * entropy + error, {"accuracy": right, "BRDF error": float(error.detach())}


def fit(
    config: MaterialEncoderConfig,
    scenes: Scenes,
    output: Path,
    trainer_config: TrainerConfig,
    settings: PriorConfig = PriorConfig(),
    record: RunRecord | None = None,
) -> MaterialEncoder:
    """Fit until the time is up and write the encoder's averaged weights; goes on from `<output>.resume` if it is there.

    Args:
        output: of the checkpoint, for `fit instant-albedo --material-prior`.
        record: of the run.
    Raises:
        ArmError: too few meshes.
    """
    torch.manual_seed(trainer_config.seed)
    held_out = scenes.meshes[settings.held_out - 1 :: settings.held_out]
    training = [path for path in scenes.meshes if path not in held_out]
    if not training:
        raise ArmError(f"{len(scenes.meshes)} objects are too few to fit and to validate; give more --shards")
    device = distributed.device(settings.device)
    loop = Trainer(MaterialPrior(config).to(device), trainer_config, output.with_suffix(".resume"), record)
    size = loop.model.size

    def drawn(paths: list[Path], random: torch.Generator) -> MaterialSample:
        path = paths[int(torch.randint(len(paths), (), generator=random))]
        return scenes.drawn(path, size, settings.views, random)

    def step(index: int) -> tuple[Tensor, dict[str, float]]:
        random = distributed.generator(trainer_config.seed, index)
        samples = [drawn(training, random) for _ in range(settings.objects)]
        return prior_loss(loop.model, on_device(joined(samples), device), settings)

    def check(model: MaterialPrior) -> dict[str, float]:
        chosen = held_out[: settings.validate]
        samples = [drawn([path], torch.Generator().manual_seed(k)) for k, path in enumerate(chosen)]
        return validate(model, [on_device(sample, device) for sample in samples])

    averaged = loop.run(step, check)
    if distributed.rank() == 0:
        metadata = {"steps": str(loop.step), "objects": str(len(training)), "labels": ", ".join(LABELS)}
        checkpoints.save(output, averaged.encoder.state_dict(), config, "material_encoder", metadata, half=True)
    return averaged.encoder


@torch.no_grad()
def validate(model: MaterialPrior, samples: list[MaterialSample]) -> dict[str, float]:
    """Over all pixels: share of kinds that are right, mean absolute errors, and those of the best constants."""
    right, errors, truths = [], [], []
    for sample in samples:
        logits, values = model(sample.images)
        inside = sample.label != NOTHING
        right.append((logits.argmax(dim=1) == sample.label)[inside].float())
        errors.append((values.clamp(0.0, 1.0) - sample.values).abs().movedim(1, -1)[inside])
        truths.append(sample.values.movedim(1, -1)[inside])
    if not sum(map(len, truths)):
        return {}
    error, truth = torch.cat(errors), torch.cat(truths)  # (P, 5)
    constant = (truth - truth.median(dim=0).values).abs().mean(dim=0)
    found = {"accuracy": float(torch.cat(right).mean())}
    for name, channels in (("albedo", slice(0, 3)), ("roughness", slice(3, 4)), ("metallic", slice(4, 5))):
        found |= {name: float(error[:, channels].mean()), f"{name}, best constant": float(constant[channels].mean())}
    return found


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What `python -m training fit material-prior` takes."""
    parser.add_argument("--shards", type=Path, required=True, help="objects whose shapes are shown")
    parser.add_argument(
        "--data", type=Path, help="textures and environments; ARM_DATA by default, else made ones alone"
    )
    parser.add_argument("--cache", type=Path, required=True, help="folder for the surfaces, made ready")
    parser.add_argument("--output", type=Path, required=True, help="checkpoint to write")
    parser.add_argument("--preset", choices=SIZES, default="small")
    parser.add_argument("--objects", type=int, default=PriorConfig.objects, help="objects a step")
    parser.add_argument("--views", type=int, default=PriorConfig.views, help="pictures of each, 1 to 10")
    options.add_device_arguments(parser)
    options.add_loop_arguments(parser, minutes=60.0, learning_rate=5e-4)


def run(args: argparse.Namespace) -> int:
    """Fit; returns the exit status."""
    if not 1 <= args.views <= 10:
        raise ArmError(f"--views {args.views}: give 1 to 10")
    if args.objects < 1:
        raise ArmError(f"--objects {args.objects}: give 1 or more")
    config, record = options.config(args), RunRecord.beside(args.output, vars(args))
    scenes = Scenes(shards.meshes(args.shards), args.cache / "surfaces", read_library(args.data))
    settings = PriorConfig(args.objects, args.views, bfloat16=args.bfloat16, device=args.device)
    fit(SIZES[args.preset].encoder, scenes, args.output, config, settings, record)
    return 0
