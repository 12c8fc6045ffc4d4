"""Training samples of InstantAlbedo: rendered rigs, carried into texture space once and kept on disk.

Unwrapping and back-projecting are too slow for a training step (the paper prepares its atlases beforehand, too). One
file per rig holds what the network reads and where each pixel of the truth images lies in the atlas.
"""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from arm_blender.errors import ArmError, EmptyMeshError, UnwrapError
from arm_blender.graphics.cameras import Camera, project, view_directions
from arm_blender.graphics.color import bytes_from_unit, linear_from_srgb, srgb_from_linear
from arm_blender.graphics.rasterize import interpolate, rasterize
from arm_blender.structures import TexelMap, TexelViews, TriangleMesh, UvMesh, ViewSet
from arm_blender.uv.backproject import backproject, blend
from arm_blender.uv.decimate import clean, decimate
from arm_blender.uv.maps import diffuse_fill, pad
from arm_blender.uv.texels import texel_map
from arm_blender.uv.unwrap import UnwrapConfig, unwrap

from .shards import arrays as read_arrays
from .shards import cameras, read_mesh, rigs, save_arrays

logger = logging.getLogger(__name__)

SAMPLES = "[!.]*.npz"
"""Names of the samples in a cache; what is hidden is a file that is being written."""

INPUTS = 6
"""The first views of a rig are the network's input; all of them are compared."""


@dataclass(frozen=True)
class AtlasConfig:
    """How samples are made."""

    size: int = 192
    """Texels a side; the resolution that the network runs at."""
    faces: int = 5000
    """Face budget; more costs time in unwrapping."""
    subsets: int = 3
    """Choices of input views kept for each rig, the first with all of them: so the network learns to do with fewer."""
    time_limit: float = 20.0
    """Seconds for one unwrapping."""


@dataclass(frozen=True)
class Atlas:
    """One sample, T texels a side, S pixels a side, N truth views of which the first are the inputs.

    Attributes:
        images: (V, 4, S, S) linear, straight alpha: the chosen inputs.
        texels: the surface.
        seen: what the chosen inputs say of it.
        base: (3, T, T) linear: their blend, filled and padded.
        uv: (N, S, S, 2) where each pixel lies in the atlas, v up.
        mask: (N, S, S) bool: the pixels that show the mesh and are opaque.
        baked: (N, 3, S, S) sRGB truth, lit.
        albedo: (N, 3, S, S) sRGB truth, unlit.
    """

    images: Tensor
    texels: TexelMap
    seen: TexelViews
    base: Tensor
    uv: Tensor
    mask: Tensor
    baked: Tensor
    albedo: Tensor


def prepare(shards: Path, cache: Path, config: AtlasConfig = AtlasConfig(), seed: int = 0) -> int:
    """Write the samples of all rigs in `shards` that are not in `cache` yet; returns how many there are now.

    An object that cannot be unwrapped is left out, with a warning.

    Raises:
        ArmError: there are no rigs.
    """
    cache.mkdir(parents=True, exist_ok=True)
    mesh, owner = None, None
    for rig in rigs(shards):
        target = cache / f"{rig.parent.name}.{rig.stem}.npz"
        if target.exists():
            continue
        if owner != rig.parent:
            mesh, owner = _unwrapped(rig.parent, config), rig.parent
        if mesh is None:
            continue
        generator = torch.Generator().manual_seed(seed)
        save_arrays(target, _sample(mesh, read_arrays(rig), config, generator))
        logger.info("prepared %s", target.name)
    return len(list(cache.glob(SAMPLES)))


def load(path: Path, subset: int) -> Atlas:
    """One sample with one of its choices of input views; `subset` counts round."""
    with np.load(path) as file:
        arrays = {key: file[key] for key in file.files}
    views = cameras(arrays)
    subset %= len(arrays["subsets"])
    chosen = np.flatnonzero(arrays["subsets"][subset])
    rgba = torch.from_numpy(arrays["rgba"]).permute(0, 3, 1, 2) / 255.0  # (N, 4, S, S)
    albedo = torch.from_numpy(arrays["albedo"]).permute(0, 3, 1, 2) / 255.0
    size = arrays["covered"].shape[0]
    texels = TexelMap(
        torch.from_numpy(arrays["position"]).float(),
        torch.nn.functional.normalize(torch.from_numpy(arrays["normal"]).float(), dim=0),
        torch.from_numpy(arrays["covered"]),
    )
    visible = torch.from_numpy(np.unpackbits(arrays["visible"], axis=-1, count=size)[chosen].astype(bool))
    color = linear_from_srgb(torch.from_numpy(arrays["color"][chosen]) / 255.0)
    return Atlas(
        images=torch.cat([linear_from_srgb(rgba[chosen, :3]), rgba[chosen, 3:]], dim=1),
        texels=texels,
        seen=_seen(texels, color, visible, tuple(views[k] for k in chosen)),
        base=linear_from_srgb(torch.from_numpy(arrays["bases"][subset]) / 255.0),
        uv=torch.from_numpy(arrays["uv"].astype(np.float32)) / 65535.0,
        mask=torch.from_numpy(arrays["shown"]),
        baked=rgba[:, :3],
        albedo=albedo,
    )


def _unwrapped(folder: Path, config: AtlasConfig) -> UvMesh | None:
    """The object's mesh, welded, within the face budget, with an atlas; None where that cannot be."""
    split = read_mesh(folder / "mesh.npz")
    # Files split vertices where normals or texture coordinates do; unwelded, every face would be its own chart.
    _, index = torch.unique((split.vertices * 1e5).round().long(), dim=0, return_inverse=True)
    welded = torch.empty(int(index.max()) + 1, 3).index_copy_(0, index, split.vertices)
    try:
        mesh = decimate(clean(TriangleMesh(welded, index[split.faces]), min_part=1e-3), config.faces)
        return unwrap(mesh, UnwrapConfig(texture_size=config.size, time_limit=config.time_limit))[0]
    except (EmptyMeshError, UnwrapError) as error:
        logger.warning("%s left out: %s", folder.name, error)
        return None


def _sample(
    mesh: UvMesh, rig: dict[str, np.ndarray], config: AtlasConfig, generator: torch.Generator
) -> dict[str, np.ndarray]:
    """The arrays of one file."""
    views = cameras(rig)
    rgba = torch.from_numpy(rig["rgba"]).permute(0, 3, 1, 2) / 255.0
    images = torch.cat([linear_from_srgb(rgba[:INPUTS, :3]), rgba[:INPUTS, 3:]], dim=1)
    texels = texel_map(mesh, config.size)
    seen = backproject(mesh, texels, ViewSet(images, views[:INPUTS], torch.ones(INPUTS), "sample"))
    subsets = _subsets(config.subsets, generator)
    bases = torch.stack([_base(texels, seen, subset) for subset in subsets])
    uv, shown = zip(*(_pixel_uvs(mesh, camera) for camera in views), strict=True)
    shown = torch.stack(shown) & (rgba[:, 3] == 1.0)
    return {
        "rgba": rig["rgba"],
        "albedo": rig["albedo"],
        "c2w": rig["c2w"],
        "K": rig["K"],
        "position": texels.position.half().numpy(),
        "normal": (texels.normal * 127.0).round().to(torch.int8).numpy(),
        "covered": texels.mask.numpy(),
        "color": _bytes(seen.color),
        "visible": np.packbits(seen.visibility.numpy(), axis=-1),
        "subsets": subsets.numpy(),
        "bases": _bytes(bases),
        "uv": (torch.stack(uv) * 65535.0).round().numpy().astype(np.uint16),
        "shown": shown.numpy(),
    }


def _subsets(count: int, generator: torch.Generator) -> Tensor:
    """(count, V) bool: all views, then random choices of one to all but one."""
    subsets = torch.ones(count, INPUTS, dtype=torch.bool)
    for subset in subsets[1:]:
        left_out = int(torch.randint(1, INPUTS, (), generator=generator))
        subset[torch.randperm(INPUTS, generator=generator)[:left_out]] = False
    return subsets


def _base(texels: TexelMap, seen: TexelViews, subset: Tensor) -> Tensor:
    """(3, T, T) linear: the blend of some views, filled where they see nothing, padded in the gaps."""
    color, weight = blend(seen.only(subset), torch.ones(int(subset.sum())))
    return pad(diffuse_fill(color, weight > 0, texels), texels.mask)


def _pixel_uvs(mesh: UvMesh, camera: Camera) -> tuple[Tensor, Tensor]:
    """(S, S, 2) where each pixel lies in the atlas, and (S, S) bool where the mesh is."""
    fragments = rasterize(mesh.vertices, mesh.faces, camera)
    uv = interpolate(mesh.uvs, mesh.face_uvs, fragments).permute(1, 2, 0)
    return uv.clamp(0.0, 1.0), fragments.face_id >= 0


def _seen(texels: TexelMap, color: Tensor, visible: Tensor, views: tuple[Camera, ...]) -> TexelViews:
    """What need not be stored: it follows from the surface and the cameras."""
    points = texels.position.permute(1, 2, 0)  # (T, T, 3)
    direction = torch.stack([view_directions(points, camera).permute(2, 0, 1) for camera in views])
    cosine = (direction * texels.normal).sum(dim=1).clamp(min=0.0) * visible
    pixels = torch.stack([project(points, camera)[0] for camera in views])
    eyes = torch.stack([camera.center for camera in views])
    return TexelViews(color * visible[:, None], visible, eyes, cosine, pixels)


def _bytes(linear: Tensor) -> np.ndarray:
    """uint8 sRGB, as files keep colours."""
    return bytes_from_unit(srgb_from_linear(linear)).numpy()


def files(cache: Path) -> list[Path]:
    """The samples in `cache`, in a stable order.

    Raises:
        ArmError: there are none.
    """
    found = sorted(cache.glob(SAMPLES))
    if not found:
        raise ArmError(f"{cache}: no samples; give --shards to prepare them")
    return found
