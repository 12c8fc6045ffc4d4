"""Six views of one picture (Zero123++, arXiv:2310.15110): prompt and reference, the steps, the decoded picture."""

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from ...graphics.color import bytes_from_unit, composite, srgb_from_linear
from ...knobs import DrawingKnobs, check
from ...machine.interruptible import interruptible
from ...progress import Progress, silent
from .attention import predict
from .network_picture import network_picture
from .networks import Networks
from .schedule import schedule
from .view_noise import ViewNoise, tiles

BACKGROUNDS = {"grey": 127.0 / 255.0, "white": 1.0}
"""sRGB level behind the object, of the picture that goes in and of the views that come out."""


@dataclass(frozen=True)
class Zero123PlusConfig(DrawingKnobs):
    """One run of the model."""

    model: Path
    """Folder of the weights, as diffusers saves a pipeline."""
    folder: Path
    """Where the six views go; what it already holds of them is replaced."""
    seed: int = 0
    """Of the views that are drawn. The same seed gives the same views on one machine."""
    device: str = "cpu"
    """Where the networks run."""
    threads: int | None = None
    """Of the CPU; None leaves torch's choice."""
    side: int = 320
    """Pixels a side of a view. The published network was trained on no other; a multiple of its scale of 8."""

    def __post_init__(self) -> None:
        check(self)


@torch.inference_mode()
def six_views(
    networks: Networks, picture: Tensor, config: Zero123PlusConfig, noise: ViewNoise, progress: Progress = silent
) -> Tensor:
    """The six views that the model sees around the object in a picture.

    Args:
        networks: of the model.
        picture: (4, S, S) linear Rec.709, straight alpha; the object's longer side takes 0.85 of it.
        config: of the run.
        noise: of the views.
        progress: is told each step, and asked before every block of every network: it may raise `Cancelled`.
    Returns:
        (6, 3, config.side, config.side) float32 on the CPU, sRGB in [0, 1], in the order of the rig.
    """
    report = 0.0, "Zero123++: reading the picture"
    levels = schedule(networks.noise, config.steps)
    with interruptible(networks.modules, lambda: progress(*report)):
        progress(*report)
        level = BACKGROUNDS[config.background]
        seen = bytes_from_unit(composite(srgb_from_linear(picture[:3]), picture[3:], level)).cpu()
        prompt = _prompt(networks, seen)
        reference = _reference(networks, seen, noise)
        scale = 2 ** (len(networks.vae.config.block_out_channels) - 1)  # Pixels a side of one latent.
        side, channels = config.side // scale, networks.unet.config.in_channels
        sample = noise.views(channels, side) * levels.initial_sigma
        for k, timestep in enumerate(levels.timesteps):
            report = 0.05 + 0.9 * k / config.steps, f"Zero123++: step {k + 1} of {config.steps}"
            progress(*report)
            noised = levels.scaled(levels.noised(reference, noise.reference(*reference.shape), k), k)
            # The first row knows nothing of the picture, the second one all.
            both = levels.scaled(sample, k).expand(2, -1, -1, -1)
            told = torch.tensor(timestep, device=networks.ramp.device)
            v = predict(networks.unet, _on(networks, both), _on(networks, noised), told, prompt)
            v = guided(v.float().cpu(), config.guidance)
            sample = levels.step(sample, v, noise.views(channels, side), k)
        report = 0.95, "Zero123++: decoding the views"
        progress(*report)
        latents = _on(networks, unscaled_latents(sample) / networks.vae.config.scaling_factor)
        image = networks.vae.decode(latents, return_dict=False)[0].float().cpu()
    return tiles((unscaled_image(image) / 2.0 + 0.5).clamp(0.0, 1.0))


def unscaled_latents(latents: Tensor) -> Tensor:
    """Latents as the VAE gives them, times its scaling factor, from (x - 0.22) * 0.75, which the UNet learnt."""
    return latents / 0.75 + 0.22


def unscaled_image(image: Tensor) -> Tensor:
    """A picture in [-1, 1] from x * 0.5 / 0.8, which the VAE was given: it left room for colours beyond."""
    return image / 0.5 * 0.8


def guided(predictions: Tensor, guidance: float) -> Tensor:
    """(1, ...) of (2, ...) predictions without and with the picture (classifier-free guidance, arXiv:2207.12598)."""
    without, with_picture = predictions.chunk(2)
    return without + guidance * (with_picture - without)


def ramped_prompt(prompt: Tensor, embedding: Tensor, ramp: Tensor) -> Tensor:
    """(B, L, D): a prompt's tokens (B, L, D) plus a picture's `embedding` (B, 1, D), as much as `ramp` (L,) says."""
    return prompt + embedding * ramp[:, None]


def _prompt(networks: Networks, seen: Tensor) -> Tensor:
    """(2, L, D): the empty prompt, and with the picture (3, S, S) of bytes in it."""
    empty = networks.text_encoder(networks.empty_prompt)[0]
    picture = _on(networks, network_picture(seen, networks.clip_picture))
    embedding = networks.vision_encoder(picture).image_embeds[:, None]
    return torch.cat([empty, ramped_prompt(empty, embedding, networks.ramp)])


def _reference(networks: Networks, seen: Tensor, noise: ViewNoise) -> Tensor:
    """(2, C, h, w) float32 latents of nothing, and of the picture (3, S, S) of bytes."""
    picture = network_picture(seen, networks.vae_picture)
    latents = networks.vae.encode(_on(networks, torch.cat([torch.zeros_like(picture), picture]))).latent_dist
    mean, std = latents.mean.float().cpu(), latents.std.float().cpu()
    return mean + std * noise.reference(*mean.shape)


def _on(networks: Networks, values: Tensor) -> Tensor:
    """`values` where and as the networks compute."""
    return values.to(networks.ramp)
