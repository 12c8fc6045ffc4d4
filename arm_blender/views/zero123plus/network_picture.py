"""A picture as an encoder takes it: scaled, cropped and normalised as its preprocessor_config.json says.

transformers' CLIPImageProcessor does the same, but differently by a few levels with torchvision installed and without.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor


@dataclass(frozen=True)
class PreprocessorConfig:
    """Of preprocessor_config.json. Another size or range than that of the training gives views of something else."""

    shortest_edge: int
    """Pixels that the shorter side is scaled to."""
    crop: int
    """Pixels a side of what is cut out of the middle."""
    mean: tuple[float, ...]
    """Per channel, of values in [0, 1]."""
    std: tuple[float, ...]
    """Per channel; 0.8 for the VAE of Zero123++: its image scaling by 0.5 / 0.8 is in it."""
    resample: int = Image.Resampling.BICUBIC
    """Pillow's number of the filter."""


def preprocessor_config(values: dict[str, Any]) -> PreprocessorConfig:
    """The config of a preprocessor_config.json, whose sizes are numbers in old files and mappings in newer ones.

    Raises:
        ValueError: a field is absent, or asks for what is not done here.
    """
    try:
        size, crop = values["size"], values["crop_size"]
        config = PreprocessorConfig(
            shortest_edge=int(size["shortest_edge"] if isinstance(size, dict) else size),
            crop=int(crop["height"] if isinstance(crop, dict) else crop),
            mean=tuple(map(float, values["image_mean"])),
            std=tuple(map(float, values["image_std"])),
            resample=Image.Resampling(values.get("resample", Image.Resampling.BICUBIC)),
        )
    except (KeyError, TypeError) as error:
        raise ValueError(f"{error} is missing or malformed") from error
    steps = ("do_resize", "do_center_crop", "do_rescale", "do_normalize")
    if not all(values.get(step, True) for step in steps) or config.crop > config.shortest_edge:
        raise ValueError(f"{', '.join(steps)} must be true, and crop_size at most size")
    return config


def network_picture(picture: Tensor, config: PreprocessorConfig) -> Tensor:
    """(1, 3, crop, crop) float32 of a picture (3, H, W) of bytes, uint8 sRGB."""
    image = Image.fromarray(picture.permute(1, 2, 0).contiguous().numpy(), "RGB")
    scale = config.shortest_edge / min(image.size)
    width, height = (max(config.shortest_edge, int(side * scale)) for side in image.size)
    # In bytes and with Pillow's filter: so were the pictures scaled that the encoders were trained on.
    image = image.resize((width, height), config.resample)
    left, top = (width - config.crop) // 2, (height - config.crop) // 2
    image = image.crop((left, top, left + config.crop, top + config.crop))
    values = torch.from_numpy(np.array(image)).permute(2, 0, 1).float() / 255.0
    mean, std = (torch.tensor(numbers).view(3, 1, 1) for numbers in (config.mean, config.std))
    return ((values - mean) / std)[None]
