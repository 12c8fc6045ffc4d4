"""The truth that predictions are compared with, as it lies in the cache.

`CACHE/<protocol>/<id>/`: `transforms.json` with the six input views, as a user would bring them; `front/` with the one
true view in the same layout; `mesh.npz`, the true surface; `truth.npz`, the test views and the front view last; and
`truth.json`, what it was rendered with. Where other views than those are relit, `relit-<k>.npz` holds them under each
light. A folder is there whole or not at all.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from arm_blender.errors import ArmError
from arm_blender.graphics.cameras import Camera

from ...rendering import shards
from .objects import EvaluationObject
from .protocol import Protocol

ARRAYS, RECORD, FRONT = "truth.npz", "truth.json", "front"


@dataclass(frozen=True)
class Appearance:
    """Pictures of one object from V cameras, N x N pixels; where `alpha` is 0 their colours mean nothing.

    Attributes:
        cameras: V of them.
        alpha: (V, 1, N, N) coverage.
        albedo: (V, 3, N, N) sRGB.
        roughness, metallic: (V, 1, N, N) linear.
        lit: (V, 3, N, N) sRGB under the light of the inputs; None where it was not rendered.
        relit: (V, 3, N, N) sRGB under another light; None where it was not rendered.
    """

    cameras: tuple[Camera, ...]
    alpha: Tensor
    albedo: Tensor
    roughness: Tensor
    metallic: Tensor
    lit: Tensor | None = None
    relit: Tensor | None = None

    @property
    def mask(self) -> Tensor:
        """(V, 1, N, N) bool: more than half of the pixel shows the object."""
        return self.alpha > 0.5

    def only(self, chosen: slice) -> "Appearance":
        """Some of the views."""
        always = (t[chosen] for t in (self.alpha, self.albedo, self.roughness, self.metallic))
        lit, relit = (None if t is None else t[chosen] for t in (self.lit, self.relit))
        return replace(Appearance(self.cameras[chosen], *always), lit=lit, relit=relit)


@dataclass(frozen=True)
class Relighting:
    """Views of their own under several lights; their pictures stay on disk.

    Attributes:
        cameras: V of them.
        files: of each light, for `relit_pictures`.
        lights: HDRI files, in the same order.
    """

    cameras: tuple[Camera, ...]
    files: tuple[Path, ...]
    lights: tuple[Path, ...]


@dataclass(frozen=True)
class Truth:
    """One object of the cache.

    Attributes:
        tests: what the test views show.
        front: what the one true view shows; it is not relit.
        input_light, other_light: HDRI files of the lit and the relit views.
        relighting: views that are relit instead of the test views; None where it is those.
    """

    tests: Appearance
    front: Appearance
    input_light: Path
    other_light: Path
    relighting: Relighting | None = None


def is_whole(folder: Path) -> bool:
    """Whether the truth of an object has been rendered."""
    return (folder / RECORD).is_file()


def read_truth(item: EvaluationObject, data: Path, protocol: Protocol) -> Truth:
    """The truth of an object.

    Args:
        data: the data folder, to which the HDRIs' paths are relative.
        protocol: by which it was rendered.
    Raises:
        ArmError: it is missing or damaged.
    """
    try:
        record = json.loads((item.folder / RECORD).read_text(encoding="utf-8"))
        with np.load(item.folder / ARRAYS) as file:
            arrays = {name: file[name] for name in file.files}
        light, other = (data / record[name] for name in ("input_light", "other_light"))
        relighting = None
        if protocol.relit_views is not None:
            others = tuple(data / name for name in record["relit_lights"])
            relighting = Relighting(protocol.relit(), tuple(relit_files(item.folder, len(others))), others)
    except (OSError, ValueError, KeyError) as error:
        raise ArmError(f"{item.folder}: no whole truth ({error}); remove the folder, it is rendered again") from error
    views = appearance(shards.cameras(arrays), arrays)
    return Truth(views.only(slice(None, -1)), views.only(slice(-1, None)), light, other, relighting)


def relit_files(folder: Path, count: int) -> list[Path]:
    """Of an object's folder, one for each light."""
    return [folder / f"relit-{k}.npz" for k in range(count)]


def relit_pictures(path: Path) -> tuple[Tensor, Tensor]:
    """The true pictures of a file of `Relighting`: (V, 3, N, N) sRGB, and (V, 1, N, N) coverage, in [0, 1].

    Raises:
        ArmError: it is missing or damaged.
    """
    rgba = channels_first(shards.arrays(path, "rgba")["rgba"])
    return rgba[:, :3], rgba[:, 3:]


def appearance(cameras: tuple[Camera, ...], arrays: shards.Arrays) -> Appearance:
    """What the arrays of views show, stacked from those of `render_view`, perhaps with relit (V, N, N, 3) uint8."""
    rgba = channels_first(arrays["rgba"])
    return Appearance(
        cameras,
        rgba[:, 3:],
        channels_first(arrays["albedo"]),
        channels_first(arrays["roughness"][..., None]),
        channels_first(arrays["metallic"][..., None]),
        lit=rgba[:, :3],
        relit=channels_first(arrays["relit"]) if "relit" in arrays else None,
    )


def channels_first(pixels: NDArray[np.uint8]) -> Tensor:
    """(V, C, N, N) in [0, 1] of (V, N, N, C) uint8."""
    return torch.from_numpy(pixels).permute(0, 3, 1, 2).float() / 255.0
