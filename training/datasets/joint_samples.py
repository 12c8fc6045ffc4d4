"""Windows of simulated captures with what all their pictures tell of each pixel: what the joint look learns from.

Read are the folders of `python -m training render --layout capture`. Their first masks are those of the shipped
network, their cameras as wrong as solved ones are.
"""

import json
import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor
from torch.nn.functional import grid_sample

from arm_blender.errors import ArmError
from arm_blender.graphics.color import linear_from_srgb
from arm_blender.photographs.capture import Lens
from arm_blender.photographs.masks.evidence import Scene, evidence, places_of, scene, window
from arm_blender.photographs.masks.eyes import Eye
from arm_blender.photographs.masks.joint_look import LOOKED_AT, logit_of
from arm_blender.views.cutout import cut_out
from arm_blender.views.masks import Unsure

from ..random_numbers import uniform
from .cutout_samples import HELD_OUT_EVERY, developed

GROUND = slice(4, 8)
"""The channels of the evidence that tell of the ground; one sample in seven is without."""

NO_GROUND = 0.15
"""Share of the samples that know nothing of the ground."""

VARIANTS = 2
"""Of each capture: with other mistakes in its cameras, and other windows."""


@dataclass(frozen=True)
class JointSamples:
    """The windows of one capture.

    Attributes:
        name: the object's key.
        rgb: (N, 3, S, S) uint8 sRGB.
        evidence: (N, C, S, S) int8, 127 times what `masks.evidence.evidence` gives.
        mask: (N, 1, S, S) uint8, how much of a pixel is the object.
    """

    name: str
    rgb: Tensor
    evidence: Tensor
    mask: Tensor

    @property
    def held_out(self) -> bool:
        """Whether the object only validates."""
        return zlib.crc32(self.name.encode()) % HELD_OUT_EVERY == 0


def read_capture(folder: Path, side: int, seed: int) -> JointSamples:
    """The samples of one capture.

    Args:
        side: pixels of the windows.
        seed: of the mistakes and the windows.
    Raises:
        ArmError: it is not whole.
    """
    try:
        truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        with np.load(folder / "mesh.npz") as mesh:
            ground = float(mesh["vertices"][:, 2].min())
        pictures, masks, logits = [], [], []
        for entry in truth["pictures"]:
            picture, mask = _small(folder / entry["file"], "RGB"), _small(folder / entry["mask"], "L")
            pictures.append(picture)
            masks.append(mask[0])
            logits.append(_first_look(picture))
        poses = [(torch.tensor(entry["c2w"], dtype=torch.float64), entry["lens"]) for entry in truth["pictures"]]
    except (OSError, ValueError, KeyError) as error:
        raise ArmError(f"{folder}: not a whole capture ({error}); remove it, and render again") from error
    rgb, told, true = [], [], []
    for variant in range(VARIANTS):
        random = torch.Generator().manual_seed(zlib.crc32(folder.name.encode()) + 10 * seed + variant)
        eyes, height = mistaken(poses, ground, random)
        seen = scene(pictures, logits, eyes, height)
        for view, mask in enumerate(masks):
            box = _jittered(seen, view, random)
            colors, known = evidence(seen, view, box, side)
            rgb.append((colors * 255.0).round().to(torch.uint8))
            told.append((known * 127.0).round().to(torch.int8))
            where = places_of(box, side)[None]
            alpha = grid_sample(mask[None, None], where, padding_mode="zeros", align_corners=False)[0]
            true.append((alpha * 255.0).round().to(torch.uint8))
    return JointSamples(truth["object"], torch.stack(rgb), torch.stack(told), torch.stack(true))


def mistaken(
    poses: Sequence[tuple[Tensor, dict[str, Any]]], ground: float, random: torch.Generator
) -> tuple[list[Eye], float]:
    """Cameras as a solver might have found them, and the ground: a little off, in a frame of another size and place.

    Args:
        poses: (4, 4) c2w in OpenGL axes, and the lens as `truth.json` has it.
        ground: its true height.
    """
    draw = partial(uniform, random)
    size, tilt = math.exp(draw(-0.2, 0.2)), _turned(torch.randn(3, generator=random) * math.radians(0.3))
    shift = torch.tensor([draw(-0.15, 0.15), draw(-0.15, 0.15), draw(-0.1, 0.1)], dtype=torch.float64)
    eyes = []
    for c2w, lens in poses:
        off = c2w.clone()
        off[:3, :3] = tilt @ _turned(torch.randn(3, generator=random) * math.radians(0.08)) @ c2w[:3, :3]
        center = c2w[:3, 3] * (1.0 + 0.002 * torch.randn(3, generator=random).double())
        off[:3, 3] = size * tilt @ center + shift
        eyes.append(eye_of(off, lens))
    return eyes, size * ground + float(shift[2]) + 0.006 * float(torch.randn((), generator=random))


def eye_of(c2w: Tensor, lens: dict[str, Any]) -> Eye:
    """Of a pose (4, 4) in OpenGL axes and a lens as `truth.json` has it."""
    return Eye.posed(c2w, Lens(lens["model"], tuple(lens["parameters"]), lens["width"], lens["height"]))


def drawn(samples: Sequence[JointSamples], count: int, random: torch.Generator) -> tuple[Tensor, Tensor]:
    """Random windows: (count, 3 + C, S, S) as the network takes them, and (count, 1, S, S) alpha."""
    inputs, alphas = [], []
    for _ in range(count):
        item = samples[int(torch.randint(len(samples), (), generator=random))]
        index = int(torch.randint(len(item.rgb), (), generator=random))
        told = item.evidence[index].float() / 127.0
        if uniform(random) < NO_GROUND:
            told[GROUND] = 0.0
        both = torch.cat([developed(item.rgb[index] / 255.0, random), told, item.mask[index] / 255.0])
        both = both.flip(-1) if uniform(random) < 0.5 else both
        inputs.append(both[:-1])
        alphas.append(both[-1:])
    return torch.stack(inputs), torch.stack(alphas)


def plain(samples: Sequence[JointSamples]) -> tuple[Tensor, Tensor]:
    """Every third window, unchanged."""
    rgb, told, mask = (
        torch.cat([getattr(item, name)[::3] for item in samples]) for name in ("rgb", "evidence", "mask")
    )
    return torch.cat([rgb / 255.0, told / 127.0], dim=1), mask / 255.0


def _small(path: Path, mode: str) -> Tensor:
    """(C, H, W) in [0, 1], as large as the look takes it."""
    with Image.open(path) as picture:
        picture.thumbnail((LOOKED_AT, LOOKED_AT), Image.Resampling.BOX)
        values = np.array(picture.convert(mode), np.float32) / 255.0
    return torch.from_numpy(values if values.ndim == 3 else values[..., None]).permute(2, 0, 1).contiguous()


def _first_look(picture: Tensor) -> Tensor:
    """(H, W) logits of the shipped network's mask; 0 where it sees nothing."""
    try:
        return logit_of(cut_out(torch.cat([linear_from_srgb(picture), torch.ones_like(picture[:1])])))
    except Unsure:
        return torch.zeros_like(picture[0])


def _jittered(seen: Scene, view: int, random: torch.Generator) -> Tensor:
    """A window around the object, larger or smaller than it should be, and beside it."""
    box = window(seen, view)
    middle, half = (box[2:] + box[:2]) / 2.0, (box[2:] - box[:2]) / 2.0
    middle = middle + half * torch.tensor([uniform(random, -0.15, 0.15) for _ in range(2)])
    half = half * math.exp(uniform(random, -0.2, 0.25))
    return torch.cat([middle - half, middle + half])


def _turned(axis: Tensor) -> Tensor:
    """(3, 3) float64 rotation about `axis` (3,) by its length in radians."""
    x, y, z = axis.double()
    zero = torch.zeros((), dtype=torch.float64)
    return torch.linalg.matrix_exp(
        torch.stack([torch.stack([zero, -z, y]), torch.stack([z, zero, -x]), torch.stack([-y, x, zero])])
    )
