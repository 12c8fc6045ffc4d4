"""Samples of delighting: what six views say of points on the shape that GeoRM makes of them, and the albedo there.

The true shape would be too good a teacher: in the program normals are GeoRM's, and pictures lie on them a little askew.
Colours and albedo are carried onto the points in the same way, so that both are askew alike. Each rig that was rendered
gives a sample, and the same object under other materials and light, rasterised, gives more.
"""

import logging
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from arm_blender.commands.progress_line import Counted
from arm_blender.graphics.color import bytes_from_unit, linear_from_srgb, srgb_from_linear
from arm_blender.graphics.meshes import sample_surface, vertex_normals
from arm_blender.models.small.delighting import SeenPoints
from arm_blender.structures import TriangleMesh
from arm_blender.uv.backproject import BackprojectConfig, look, sight
from arm_blender.uv.view_sampling import sample_view

from ..rasterized import pictures as rasterized
from ..rasterized.pictures import Library
from ..rendering import shards
from ..rendering.camera_rigs import INPUT_VIEWS
from .gloss_samples import Shapes

logger = logging.getLogger(__name__)

POINTS = 2048
"""Kept of a shape, of twice as many drawn: those that some view sees. A step takes a part of them."""

FACES = 6_000
"""Of a shape; light changes little over one of them."""

FEWEST = 256
"""Points that views see; a shape of fewer was missed by GeoRM."""

RASTERIZED_SIZE = 160
"""Pixels a side of pictures made on the fly."""


@dataclass(frozen=True)
class DelightingSample:
    """P points of one shape.

    Attributes:
        name: of the object.
        points: B = 1; colours linear.
        albedo: (1, P, 3) linear, blended from the views' as `SeenPoints.blended` blends colours.
    """

    name: str
    points: SeenPoints
    albedo: Tensor


def prepare(folder: Path, cache: Path, shapes: Shapes, library: Library, copies: int) -> int:
    """Make the samples of all rigs of a folder of shards that a cache lacks; returns how many it has.

    Args:
        copies: of each rig, rasterised with random materials and light.
    """
    rigs = shards.rigs(folder)
    count = Counted(len(rigs), logger.info)
    for path in rigs:
        wanted = [cache / f"{path.parent.name}.{path.stem}.{k}.npz" for k in range(1 + copies)]
        if all(target.exists() for target in wanted):
            count.skip()
            continue
        mesh = shapes.refined(path, FACES)
        if not len(mesh.faces):
            count.skip()
            continue
        for k, target in enumerate(wanted):
            if not target.exists():
                found = carried(mesh, _rig(path, k, library, cache), torch.Generator().manual_seed(0))
                if found is not None:
                    save(target, *found)
        count(f"prepared {path.parent.name}")
    return len(list(cache.glob("[!.]*.npz")))


def _rig(path: Path, copy: int, library: Library, cache: Path) -> shards.Arrays:
    """The rig as it was rendered, or a copy of it with other materials and light."""
    if copy == 0:
        return shards.arrays(path, "rgba", "albedo", "c2w", "K")
    seed = zlib.crc32(f"{path.parent.name}.{path.stem}.{copy}".encode())
    random = torch.Generator().manual_seed(seed)
    surface = rasterized.surface_at(path.with_name("mesh.npz"), cache / "surfaces")
    return rasterized.random_rig(surface, library, RASTERIZED_SIZE, random, INPUT_VIEWS)


def save(target: Path, points: SeenPoints, albedo: Tensor) -> None:
    """Write a sample; arguments as of `DelightingSample`."""
    colors = bytes_from_unit(srgb_from_linear(torch.cat([points.color, albedo[:, None]], dim=1))[0])
    arrays = {
        "position": points.position[0].half(),
        "normal": points.normal[0].half(),
        "color": colors[:-1],
        "visible": points.visible[0],
        "eyes": points.eyes[0],
        "albedo": colors[-1],
    }
    shards.save_arrays(target, {name: tensor.numpy() for name, tensor in arrays.items()})


@torch.no_grad()
def carried(
    mesh: TriangleMesh,
    rig: shards.Arrays,
    generator: torch.Generator,
    decoded: Callable[[Tensor], Tensor] = linear_from_srgb,
    surely: bool = True,
) -> tuple[SeenPoints, Tensor] | None:
    """What the input views of a rig show, on points of a mesh.

    Args:
        rig: with rgba, albedo, c2w and K, as of `rig_<k>.npz`.
        decoded: makes linear numbers of the albedo, or of what stands in its place.
        surely: leave out what lies close to an outline, or grazing.
    Returns:
        The points that a view sees, `POINTS` at most, B = 1, and their albedo (1, P, 3) linear; None where fewer than
        `FEWEST` are seen.
    """
    place, face, weights = sample_surface(mesh.vertices, mesh.faces, 2 * POINTS, generator)
    corners = vertex_normals(mesh.vertices, mesh.faces)[mesh.faces[face]]
    normal = functional.normalize((weights[..., None] * corners).sum(dim=1), dim=1)
    step, config = torch.ones(len(place)), BackprojectConfig()
    shown, visible, eyes = [], [], []
    for k, camera in enumerate(shards.cameras(rig)[:INPUT_VIEWS]):
        rgba, albedo = (torch.from_numpy(rig[name][k]).permute(2, 0, 1).float() / 255.0 for name in ("rgba", "albedo"))
        pixels, facing = look(camera, place, normal)
        seen = sight(mesh, place, normal, facing, step, rgba, camera, config)[int(surely)]
        both = [
            sample_view(torch.cat([c, rgba[3:]]), pixels, step, config.min_alpha)
            for c in (linear_from_srgb(rgba[:3]), decoded(albedo))
        ]
        shown.append(torch.cat([color.T for color, _ in both], dim=1))
        visible.append(seen & both[0][1])
        eyes.append(camera.center)
    colors, sights = torch.stack(shown), torch.stack(visible)  # (V, 2 P, 6), (V, 2 P)
    chosen = sights.any(dim=0).nonzero()[:POINTS, 0]
    if len(chosen) < FEWEST:
        return None
    color, albedo = colors[None, :, chosen].split(3, dim=-1)
    points = SeenPoints(
        place[None, chosen], normal[None, chosen], color, sights[None, :, chosen], torch.stack(eyes)[None]
    )
    return points, replace(points, color=albedo).blended()


def samples(cache: Path) -> Iterator[DelightingSample]:
    """All that a cache holds, in the order of the names."""
    for path in sorted(cache.glob("[!.]*.npz")):
        arrays = {name: torch.from_numpy(array) for name, array in shards.arrays(path).items()}
        color, albedo = (linear_from_srgb(arrays[name] / 255.0)[None] for name in ("color", "albedo"))
        position, normal = (arrays[name].float()[None] for name in ("position", "normal"))
        normal = functional.normalize(normal, dim=-1)
        points = SeenPoints(position, normal, color, arrays["visible"][None], arrays["eyes"][None])
        yield DelightingSample(path.name.rsplit(".", 3)[0], points, albedo)
