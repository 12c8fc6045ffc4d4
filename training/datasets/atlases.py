"""Training samples of InstantAlbedo: rendered rigs, carried into texture space once and kept on disk.

Unwrapping and back-projecting are too slow for a training step (the paper prepares its atlases beforehand, too). One
file per rig holds what the network reads and where each pixel of the truth images lies in the atlas.
"""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from arm_blender.commands.progress_line import Counted
from arm_blender.errors import ArmError, EmptyMeshError, UnwrapError
from arm_blender.graphics.cameras import Camera, project, view_directions
from arm_blender.graphics.color import bytes_from_unit, linear_from_srgb, srgb_from_linear
from arm_blender.graphics.connectivity import face_components
from arm_blender.graphics.raster.rasterize import rasterize_uv, rasterize_views
from arm_blender.structures import TexelMap, TexelViews, UvMesh, ViewSet
from arm_blender.uv.backproject import BackprojectConfig, backproject
from arm_blender.uv.blend import blend
from arm_blender.uv.decimate import clean, decimate
from arm_blender.uv.maps import diffuse_fill, pad
from arm_blender.uv.texels import texel_map
from arm_blender.uv.unwrap import UnwrapConfig, unwrap

from ..rasterized.surface import welded
from ..rendering.shards import Arrays, cameras, read_mesh, rigs, save_arrays
from ..rendering.shards import arrays as read_arrays
from .atlas_lookup import AtlasLookup, atlas_lookup

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
        lookup: from the N views into the atlas; its mask is where prediction and truth both show the object.
        baked: (N, 3, S, S) sRGB truth, lit.
        albedo: (N, 3, S, S) sRGB truth, unlit.
    """

    images: Tensor
    texels: TexelMap
    seen: TexelViews
    base: Tensor
    lookup: AtlasLookup
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
    found = rigs(shards)
    count = Counted(len(found), logger.info)
    for rig in found:
        target = cache / f"{rig.parent.name}.{rig.stem}.npz"
        if target.exists() and is_current(target):
            count.skip()
            continue
        if owner != rig.parent:
            mesh, owner = unwrapped(rig.with_name("mesh.npz"), config), rig.parent
        if mesh is None:
            count.skip()
            continue
        generator = torch.Generator().manual_seed(seed)
        subsets = random_subsets(config.subsets, generator)
        save_arrays(target, sample_arrays(mesh, read_arrays(rig), config.size, subsets))
        count(f"prepared {target.name}")
    return len(list(cache.glob(SAMPLES)))


def is_current(path: Path) -> bool:
    """Whether a sample holds faces and barycentric coordinates; those of earlier versions held texture coordinates."""
    with np.load(path) as file:
        return "barycentric" in file.files


def load(path: Path, subset: int) -> Atlas:
    """One sample with one of its choices of input views; `subset` counts round.

    Raises:
        ArmError: the sample was made by an earlier version.
    """
    if not is_current(path):
        raise ArmError(f"{path}: made by an earlier version; make the samples anew with --shards")
    with np.load(path) as file:
        return atlas_of({key: file[key] for key in file.files}, subset)


def atlas_of(arrays: Arrays, subset: int) -> Atlas:
    """One sample from the arrays of its file, as of `sample_arrays`."""
    views = cameras(arrays)
    subset %= len(arrays["subsets"])
    chosen = np.flatnonzero(arrays["subsets"][subset])
    rgba = torch.from_numpy(arrays["rgba"]).permute(0, 3, 1, 2) / 255.0  # (N, 4, S, S)
    size = arrays["chart"].shape[0]
    texels = TexelMap(
        torch.from_numpy(arrays["position"]).float(),
        torch.nn.functional.normalize(torch.from_numpy(arrays["normal"]).float(), dim=0),
        torch.from_numpy(arrays["chart"] >= 0),
    )
    visible = torch.from_numpy(np.unpackbits(arrays["visible"], axis=-1, count=size)[chosen].astype(bool))
    color = linear_from_srgb(torch.from_numpy(arrays["color"][chosen]) / 255.0)
    return Atlas(
        images=torch.cat([linear_from_srgb(rgba[chosen, :3]), rgba[chosen, 3:]], dim=1),
        texels=texels,
        seen=_seen(texels, color, visible, tuple(views[k] for k in chosen)),
        base=linear_from_srgb(torch.from_numpy(arrays["bases"][subset]) / 255.0),
        lookup=atlas_lookup(
            torch.from_numpy(arrays["face"]).long(),
            torch.from_numpy(arrays["barycentric"].astype(np.float32)) / 65535.0,
            torch.from_numpy(arrays["corner_uvs"]),
            torch.from_numpy(arrays["face_chart"]).long(),
            torch.from_numpy(arrays["chart"]).long(),
        ),
        baked=rgba[:, :3],
        albedo=torch.from_numpy(arrays["albedo"]).permute(0, 3, 1, 2) / 255.0,
    )


def unwrapped(path: Path, config: AtlasConfig) -> UvMesh | None:
    """The mesh of a `mesh.npz`, welded, within the face budget, with an atlas; None, with a warning, where none is."""
    try:
        mesh = decimate(clean(welded(read_mesh(path)), min_part=1e-3), config.faces)
        return unwrap(mesh, UnwrapConfig(texture_size=config.size, time_limit=config.time_limit))[0]
    except (EmptyMeshError, UnwrapError) as error:
        logger.warning("%s left out: %s", path.parent.name, error)
        return None


def sample_arrays(
    mesh: UvMesh,
    rig: Arrays,
    size: int,
    subsets: Tensor,
    depth_resolution: int = BackprojectConfig.depth_resolution,
) -> Arrays:
    """The arrays of one file: a rig in texture space.

    Args:
        rig: of the same object, rendered or rasterised.
        size: texels a side.
        subsets: (K, 6) bool: choices of input views. What none of them chooses is not back-projected.
        depth_resolution: pixels of the z-buffers that tell what a view sees.
    """
    views = cameras(rig)
    rgba = torch.from_numpy(rig["rgba"]).permute(0, 3, 1, 2) / 255.0
    texels, used = texel_map(mesh, size), subsets.any(dim=0).nonzero()[:, 0]
    images = torch.cat([linear_from_srgb(rgba[used, :3]), rgba[used, 3:]], dim=1)
    inputs = ViewSet(images, tuple(views[k] for k in used), torch.ones(len(used)), "sample")
    seen = backproject(mesh, texels, inputs, BackprojectConfig(depth_resolution=depth_resolution))
    bases = torch.stack([_base(texels, seen, subset[used]) for subset in subsets])
    color = torch.zeros(INPUTS, 3, size, size).index_copy_(0, used, seen.color)
    visible = torch.zeros(INPUTS, size, size, dtype=torch.bool).index_copy_(0, used, seen.visibility)
    fragments = rasterize_views(mesh.vertices, mesh.faces, views)
    # Of the truth only what is opaque: beyond its outline there is nothing to compare with.
    shown = fragments.mask & (rgba[:, 3] == 1.0)
    face_chart = face_components(mesh.face_uvs)
    covering = rasterize_uv(mesh.uvs, mesh.face_uvs, size).face_id
    chart = torch.where(covering >= 0, face_chart[covering], -1)
    return {
        **{name: rig[name] for name in ("rgba", "albedo", "c2w", "K")},
        "position": texels.position.half().numpy(),
        "normal": (texels.normal * 127.0).round().to(torch.int8).numpy(),
        "chart": chart.int().numpy(),
        "color": _bytes(color),
        "visible": np.packbits(visible.numpy(), axis=-1),
        "subsets": subsets.numpy(),
        "bases": _bytes(bases),
        "face": torch.where(shown, fragments.face_id, -1).int().numpy(),
        "barycentric": (fragments.barycentric[:, 1:].movedim(1, -1) * 65535.0).round().numpy().astype(np.uint16),
        "corner_uvs": mesh.uvs[mesh.face_uvs].numpy(),
        "face_chart": face_chart.int().numpy(),
    }


def random_subsets(count: int, generator: torch.Generator) -> Tensor:
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


def _seen(texels: TexelMap, color: Tensor, visible: Tensor, views: tuple[Camera, ...]) -> TexelViews:
    """What need not be stored: it follows from the surface and the cameras."""
    points = texels.position.permute(1, 2, 0)  # (T, T, 3)
    direction = torch.stack([view_directions(points, camera).permute(2, 0, 1) for camera in views])
    cosine = (direction * texels.normal).sum(dim=1).clamp(min=0.0) * visible
    pixels = torch.stack([project(points, camera)[0] for camera in views])
    eyes = torch.stack([camera.center for camera in views])
    return TexelViews(color * visible[:, None], visible, eyes, cosine, pixels)


def _bytes(linear: Tensor) -> NDArray[np.uint8]:
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
