"""`python -m training stability`: the pipeline's parts on extreme inputs, each measured against a closed form.

The document also holds how far float32 and bfloat16 stray from float64 (`precision.py`).
"""

import argparse
import logging
import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import normalize

from arm_blender.commands.progress_line import Counted
from arm_blender.graphics.cameras import Camera, intrinsics_from_fovy, look_at, orbit_camera, project
from arm_blender.graphics.light.brdf import MIN_ALPHA, evaluate
from arm_blender.graphics.meshes import face_areas, signed_areas
from arm_blender.graphics.raster.rasterize import Fragments, rasterize
from arm_blender.graphics.raster.screen_triangles import NEAR
from arm_blender.graphics.surface.isosurface import extract
from arm_blender.graphics.surface.sample_grid import IsosurfaceConfig
from arm_blender.structures import TriangleMesh
from arm_blender.uv.unwrap import UnwrapConfig, unwrap
from arm_blender.views import load_views

from ...documents import Row, markdown_table, paragraphs, write_text
from . import precision
from .ball import RADIUS, ball, open_edges
from .hard_views import conflicting_views, strange_views
from .refined_extremes import refined_extremes

logger = logging.getLogger(__name__)

GRID = 64
ON_SPHERE = "largest distance of a vertex from the sphere, in grid steps; open edges"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training stability`."""
    example = Path("arm_blender/examples/barrel")
    parser.add_argument("--views", type=Path, default=example, help="of an object, for the precision")
    parser.add_argument("--output", type=Path, default=Path("docs/stability.md"))


def run(args: argparse.Namespace) -> int:
    """Measure every case and write the document."""
    parts = (
        steep_densities,
        sharp_reflections,
        slivers,
        close_cameras,
        conflicting_views,
        strange_views,
        refined_extremes,
    )
    rows, count = list[tuple[str, str, str]](), Counted(len(parts) + 1, logger.info)
    for part in parts:
        rows += part()
        count(part.__name__.replace("_", " "))
    views = load_views(args.views)
    text = paragraphs(
        "# Stability",
        "Each part of the pipeline on inputs that are harsher than a scene should bring, against a closed form, "
        "float64, or what must hold of any input. A wall that passes behind the camera is cut at the near plane, far "
        "outside of the picture: of its depth float32 keeps few digits.",
        markdown_table(["case", "what is measured", "result"], rows),
        "## Precision",
        precision.EXPLANATION.format(views=views.name),
        markdown_table(precision.HEADER, precision.table(views)),
        f"Made by `{args.command}`.",
    )
    write_text(args.output, text)
    print(text)
    return 0


def steep_densities() -> Iterator[Row]:
    """The iso-surface of a sphere whose density rises faster and faster, up to a step, and with holes of NaN."""
    config = IsosurfaceConfig(resolution=GRID)
    for steepness in (1.0, 1e2, 1e4, 1e6, float("inf")):
        mesh = extract(partial(ball, steepness=steepness, iso=config.iso), config)
        yield f"density with slope {steepness:g} at the surface", ON_SPHERE, _sphere_quality(mesh)

    def with_nan(points: torch.Tensor) -> torch.Tensor:
        return torch.where(points[:, 0] > 0.3, torch.nan, ball(points, 10.0, config.iso))

    mesh = extract(with_nan, config)
    finite = bool(torch.isfinite(mesh.vertices).all())
    yield "density NaN in a half-space", "finite vertices; open edges", f"{finite}; {open_edges(mesh)}"


def _sphere_quality(mesh: TriangleMesh) -> str:
    error = (mesh.vertices.norm(dim=1) - RADIUS).abs().max() * (GRID - 1) / 2.0
    return f"{float(error):.3f}; {open_edges(mesh)}"


def sharp_reflections() -> Iterator[Row]:
    """The BRDF and its derivatives all over the lobe, towards a mirror and towards grazing views."""
    random = torch.Generator().manual_seed(0)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=random, dtype=torch.float64))[0]  # No axis is a special case.
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    for roughness in (0.5, 0.1, 0.01, 0.0):
        for cosine in (0.7, 1e-3, 1e-6):
            view = up.new_tensor([math.sqrt(1.0 - cosine**2), 0.0, cosine])
            aside = torch.randn(1000, 3, generator=random) * max(roughness**2, MIN_ALPHA) * 0.5
            half = normalize(up + aside, dim=1)
            light = 2.0 * (half * view).sum(1, keepdim=True) * half - view
            normal, toward, back = ((vector @ turn).float() for vector in (up, light, view))
            toward.requires_grad_()
            gloss = torch.full((1000, 1), roughness, requires_grad=True)
            value = evaluate(normal, toward, back, torch.ones(3), gloss, torch.ones(1))
            n, to_light, v, rough = (x.detach().double() for x in (normal, toward, back, gloss))
            exact = evaluate(n, to_light, v, n.new_ones(3), rough, n.new_ones(1))
            lit = exact[:, 0] > 0.0
            error = float((value.detach()[lit] / exact[lit] - 1.0).abs().max())
            slopes = torch.cat(torch.autograd.grad(value.sum(), (toward, gloss)), dim=1)
            yield (
                f"metal of roughness {roughness:g}, n.v = {cosine:g}",
                "of 1,000 lights all over the lobe, those above the surface; largest relative error of the BRDF in "
                "float32; its derivatives are finite",
                f"{int(lit.sum()):,}; {error:.1e}; {bool(slopes.isfinite().all())}",
            )


def slivers() -> Iterator[Row]:
    """Triangles much longer than wide, in the rasteriser and in the unwrapping."""
    camera = orbit_camera(0.0, 0.0, 4.0, 30.0, 128, 128)
    for width in (1e-2, 1e-4, 1e-6, 0.0):
        generator = torch.Generator().manual_seed(0)
        a, b, across = torch.rand(3, 500, 3, generator=generator) * 1.6 - 0.8
        corners = torch.stack([a, b, a + width * across], dim=1).reshape(-1, 3)
        fragments = rasterize(corners, torch.arange(1500).reshape(-1, 3), camera)
        screen = project(corners.double(), replace(camera, c2w=camera.c2w.double(), K=camera.K.double()))[0]
        missed, outside = missed_and_outside(screen.view(-1, 3, 2), fragments)
        yield (
            f"500 triangles of length 1 and width {width:g}, rasterised",
            "pixels covered; pixels missed; how far outside of its triangle a pixel's centre lies at most, pixels",
            f"{int(fragments.mask.sum()):,}; {missed}; {outside:.1e}",
        )
    for segments in (16, 256, 2048):
        mesh = _prism(segments)
        unwrapped, packing = unwrap(mesh, UnwrapConfig())
        area = signed_areas(unwrapped.uvs, unwrapped.face_uvs).abs()
        scale = (area / face_areas(mesh.vertices, mesh.faces)).sqrt()
        inside = bool(((unwrapped.uvs >= 0.0) & (unwrapped.uvs <= 1.0)).all())
        yield (
            f"a cylinder of {segments:,} slivers a side, unwrapped",
            "packed by; charts; all UVs in [0, 1]; largest over smallest scale of a face",
            f"{packing}; {unwrapped.charts}; {inside}; {float(scale.max() / scale.min()):.4f}",
        )


def missed_and_outside(screen: Tensor, fragments: Fragments) -> tuple[int, float]:
    """Fragments against the exact test of each of the pixels by each of the triangles (T, 3, 2) in float64.

    Returns:
        how many pixels are missed, and the largest distance of a pixel's centre outside of its triangle, pixels.
    """
    height, width = fragments.mask.shape
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    centers = torch.stack([x, y], dim=-1).view(1, -1, 2).double()
    covered = torch.zeros(height * width, dtype=torch.bool)
    for part in screen.split(50):
        covered |= (_inwards(part, centers) > 0.0).all(dim=-1).any(dim=0)
    missed = int((covered & ~fragments.mask.flatten()).sum())
    pixel = fragments.mask.flatten().nonzero()[:, 0]
    if not len(pixel):
        return missed, 0.0
    own = screen[fragments.face_id.flatten()[pixel]]
    return missed, float(-_inwards(own, centers[0, pixel, None]).min().clamp(max=0.0))


def _inwards(triangles: Tensor, points: Tensor) -> Tensor:
    """(T, P, 3) distances of points (1 or T, P, 2) inwards from the lines along the edges of triangles (T, 3, 2)."""
    edge = triangles.roll(-1, dims=1) - triangles
    area = edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0]
    to = points[:, :, None] - triangles[:, None]
    side = edge[:, None, :, 0] * to[..., 1] - edge[:, None, :, 1] * to[..., 0]
    return side * area.sign()[:, None, None] / edge.norm(dim=-1)[:, None].clamp(min=1e-30)


def _prism(segments: int) -> TriangleMesh:
    """A closed cylinder whose side consists of triangles as long as it is, with one fan at either end."""
    angle = torch.arange(segments) / segments * 2.0 * torch.pi
    ring = torch.stack([0.6 * angle.cos(), 0.6 * angle.sin()], dim=1)
    levels = [torch.cat([ring, torch.full((segments, 1), z)], dim=1) for z in (-0.9, 0.9)]
    vertices = torch.cat([*levels, torch.tensor([[0.0, 0.0, -0.9], [0.0, 0.0, 0.9]])])
    low = torch.arange(segments)
    after = low.roll(-1)
    high, above = low + segments, after + segments
    triangles = [
        (low, after, above),
        (low, above, high),
        (after, low, torch.full_like(low, 2 * segments)),
        (high, above, torch.full_like(low, 2 * segments + 1)),
    ]
    return TriangleMesh(vertices, torch.cat([torch.stack(corners, dim=1) for corners in triangles]))


def close_cameras() -> Iterator[Row]:
    """A slanted wall at arm's length and closer, and a floor that passes under the camera and behind it."""
    for gap in (1.0, 0.1, 0.012, 0.001):
        camera = orbit_camera(0.0, 0.0, gap, 60.0, 128, 128)
        wall = torch.tensor([[-9.0, -9.0, -9.0], [9.0, -9.0, -9.0], [9.0, 9.0, 9.0], [-9.0, 9.0, 9.0]])
        fragments = rasterize(wall, torch.tensor([[0, 1, 2], [0, 2, 3]]), camera)
        # Where the ray (x, 1, z) t from (0, -gap, 0) meets the plane y = z.
        depth = (gap / (1.0 - (64.0 - torch.arange(128) - 0.5) / camera.K[1, 1]))[:, None].expand(128, 128)
        seen = depth > NEAR
        both = seen & fragments.mask
        error = f"{float((fragments.depth / depth - 1.0)[both].abs().max()):.1e}" if both.any() else "-"
        yield (
            f"a wall at 45° that fills the view, {gap:g} away in its middle",
            f"pixels beyond the near plane ({NEAR:g}); pixels that differ; largest relative error of the depth",
            f"{int(seen.sum()):,}; {int((seen ^ fragments.mask).sum())}; {error}",
        )
    ahead = look_at(torch.zeros(3), torch.tensor([0.0, 1.0, 0.0]))
    camera = Camera(ahead, intrinsics_from_fovy(math.radians(60.0), 128, 128), 128, 128)
    floor = torch.tensor([[-1e3, -1e3, -0.1], [1e3, -1e3, -0.1], [1e3, 1e3, -0.1], [-1e3, 1e3, -0.1]])
    fragments = rasterize(floor, torch.tensor([[0, 1, 2], [0, 2, 3]]), camera)
    expected = 0.1 * camera.K[1, 1] / (torch.arange(64) + 0.5)
    worst = float((fragments.depth[64:] / expected[:, None] - 1.0).abs().max())
    yield (
        "a floor 0.1 under the camera, from far behind it to the horizon",
        "upper half empty; lower half full; largest relative error of the depth",
        f"{not fragments.mask[:64].any()}; {bool(fragments.mask[64:].all())}; {worst:.1e}",
    )
