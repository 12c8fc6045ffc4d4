"""`python -m benchmarks.bench_normal_map`: what a normal map brings back of the detail that decimation takes.

The shape of the example at each quality level, seen by its six cameras: the angle between the normals of the dense mesh
and those of the decimated one, without the map and with it. It writes docs/normal-map.md.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from arm_blender import pipeline
from arm_blender.config import QUALITIES, Settings
from arm_blender.graphics.cameras import Camera
from arm_blender.graphics.meshes import angle_weighted_normals
from arm_blender.graphics.raster.rasterize import Fragments, interpolate, rasterize
from arm_blender.graphics.tangents import corner_tangents
from arm_blender.progress import silent
from arm_blender.report import Report
from arm_blender.structures import TriangleMesh, UvMesh, ViewSet
from arm_blender.uv.decimate import decimate
from arm_blender.uv.normal_map import bake_normal_map
from arm_blender.views import load_views
from arm_blender.views.scene_frame import normalise
from training.documents import markdown_table, paragraphs, write_text

SIZES = (512, 1024)
PIXELS = 320
"""A side of the views in which normals are compared."""


@dataclass(frozen=True)
class Reduced:
    """A shape before and after decimation, with its atlas."""

    level: str
    dense: TriangleMesh
    mesh: UvMesh


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--views", type=Path, default=Path("arm_blender/examples/barrel"))
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--output", type=Path, default=Path("docs/normal-map.md"))
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    views, _ = normalise(load_views(args.views))
    rows = []
    for shape in shapes(views):
        for row in measured(shape, views.cameras):
            print(*row, flush=True)
            rows.append(row)
    header = ["quality", "faces before", "faces", "texels", "error without", "error with", "seconds", "texels found"]
    text = paragraphs(
        "# Normal maps",
        f"`--normal-map` keeps the detail that decimation takes. The shape of `{args.views}` in its six views at "
        f"{PIXELS}² pixels: mean angle between the normals before decimation and those after it, "
        "without the map and with it, as Blender decodes it. *Seconds*: of the bake.",
        markdown_table(header, rows),
        f"CPU threads: {args.threads}. Made by `python -m benchmarks.bench_normal_map`.",
    )
    write_text(args.output, text)
    print(text)


def shapes(views: ViewSet) -> Iterator[Reduced]:
    """The shape in `views` at each quality level."""
    for level in QUALITIES:
        settings = Settings(quality=level)
        with torch.inference_mode():
            dense = pipeline.shape(views, settings)
            low = decimate(dense, settings.resolved.faces)
            mesh = pipeline.atlas(low, settings, Report("small", "cpu", 0), silent)
        yield Reduced(level, dense, mesh)


def measured(shape: Reduced, cameras: tuple[Camera, ...]) -> Iterator[list[object]]:
    """A row of the table for each size of map."""
    truth = angle_weighted_normals(shape.dense.vertices, shape.dense.faces)
    seen = []
    for camera in (camera.resized(PIXELS, PIXELS) for camera in cameras):
        before = rasterize(shape.dense.vertices, shape.dense.faces, camera)
        exact = functional.normalize(interpolate(truth, shape.dense.faces, before), dim=0)
        seen.append((before.mask, exact, rasterize(shape.mesh.vertices, shape.mesh.faces, camera)))
    for size in SIZES:
        start = time.perf_counter()
        baked, share = bake_normal_map(shape.mesh, shape.dense, size)
        seconds = time.perf_counter() - start
        errors = torch.stack([_errors(shape.mesh, baked, *view) for view in seen]).mean(dim=0).tolist()
        faces = [len(shape.dense.faces), len(shape.mesh.faces)]
        yield [shape.level, *faces, size, *(f"{error:.2f}°" for error in errors), f"{seconds:.1f}", f"{share:.2%}"]


def _errors(mesh: UvMesh, baked: Tensor, shown: Tensor, exact: Tensor, after: Fragments) -> Tensor:
    """(2,) mean angles in degrees over the pixels that show both meshes: without the map, with it."""
    both = shown & after.mask
    angles = [(exact * normal).sum(dim=0)[both].clamp(-1.0, 1.0).acos() for normal in _normals(mesh, baked, after)]
    return torch.stack(angles).rad2deg().mean(dim=1)


def _normals(mesh: UvMesh, baked: Tensor, fragments: Fragments) -> tuple[Tensor, Tensor]:
    """(3, H, W) unit normals of a mesh in a view: its smooth ones, and those of its map, as Cycles decodes them."""
    own = angle_weighted_normals(mesh.vertices, mesh.faces)
    tangents, sign = corner_tangents(mesh, own)
    corners = torch.arange(3 * len(mesh.faces)).view(-1, 3)
    normal = interpolate(own, mesh.faces, fragments)
    tangent = interpolate(tangents.reshape(-1, 3), corners, fragments)
    bitangent = sign[fragments.face_id.clamp(min=0)] * torch.linalg.cross(normal, tangent, dim=0)
    uv = interpolate(mesh.uvs, mesh.face_uvs, fragments)
    where = torch.stack([2.0 * uv[0] - 1.0, 1.0 - 2.0 * uv[1]], dim=-1)[None]
    x, y, z = functional.grid_sample(baked[None], where, padding_mode="border", align_corners=False)[0]
    return functional.normalize(normal, dim=0), functional.normalize(x * tangent + y * bitangent + z * normal, dim=0)


if __name__ == "__main__":
    main()
