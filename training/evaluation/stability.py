"""`python -m training stability`: the pipeline's parts on extreme inputs, each measured against a closed form."""

import argparse
import math
from collections.abc import Iterator
from pathlib import Path

import torch

from arm_blender.graphics.brdf import evaluate
from arm_blender.graphics.cameras import Camera, intrinsics_from_fovy, look_at, orbit_camera
from arm_blender.graphics.isosurface import IsosurfaceConfig, extract
from arm_blender.graphics.meshes import signed_areas
from arm_blender.graphics.rasterize import rasterize
from arm_blender.structures import TriangleMesh, ViewSet
from arm_blender.uv.backproject import backproject, blend
from arm_blender.uv.texels import texel_map
from arm_blender.uv.unwrap import UnwrapConfig, unwrap

from .results import markdown_table, paragraphs, write_text

Row = tuple[str, str, str]
"""Case, what is measured, result."""

RADIUS = 0.7
GRID = 64
ON_SPHERE = "largest distance of a vertex from the sphere, in grid steps; open edges"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training stability`."""
    parser.add_argument("--output", type=Path, default=Path("docs/stability.md"))


def run(args: argparse.Namespace) -> int:
    """Measure every case and write the document."""
    parts = (steep_densities, sharp_reflections, slivers, close_cameras, conflicting_views)
    rows = [row for part in parts for row in part()]
    text = paragraphs(
        "# Stability",
        "Each part of the pipeline on inputs that are harsher than a scene should bring, against a closed form.",
        markdown_table(["case", "what is measured", "result"], rows),
        f"Made by `{args.command}`.",
    )
    write_text(args.output, text)
    print(text)
    return 0


def steep_densities() -> Iterator[Row]:
    """The iso-surface of a sphere whose density rises faster and faster, up to a step, and with holes of NaN."""
    for steepness in (1.0, 1e2, 1e4, 1e6, float("inf")):
        mesh = extract(lambda p, s=steepness: _ball(p, s), IsosurfaceConfig(resolution=GRID))
        yield f"density with slope {steepness:g} at the surface", ON_SPHERE, _sphere_quality(mesh)

    def with_nan(points: torch.Tensor) -> torch.Tensor:
        return torch.where(points[:, 0] > 0.3, torch.nan, _ball(points, 10.0))

    mesh = extract(with_nan, IsosurfaceConfig(resolution=GRID))
    finite = bool(torch.isfinite(mesh.vertices).all())
    yield "density NaN in a half-space", "finite vertices; open edges", f"{finite}; {_open_edges(mesh)}"


def _ball(points: torch.Tensor, steepness: float) -> torch.Tensor:
    inside = RADIUS - points.norm(dim=1)
    rise = torch.where(inside > 0.0, torch.inf, -torch.inf) if steepness == float("inf") else steepness * inside
    return IsosurfaceConfig().iso + rise


def _sphere_quality(mesh: TriangleMesh) -> str:
    error = (mesh.vertices.norm(dim=1) - RADIUS).abs().max() * (GRID - 1) / 2.0
    return f"{float(error):.3f}; {_open_edges(mesh)}"


def _open_edges(mesh: TriangleMesh) -> int:
    """How many edges do not have as many faces on one side as on the other."""
    start, end = mesh.faces, mesh.faces.roll(-1, dims=1)
    sign = torch.where(start < end, 1, -1).flatten()
    key = (torch.minimum(start, end) * len(mesh.vertices) + torch.maximum(start, end)).flatten()
    unique, index = key.unique(return_inverse=True)
    return int((torch.zeros(len(unique), dtype=torch.int64).index_add(0, index, sign) != 0).sum())


def sharp_reflections() -> Iterator[Row]:
    """The BRDF and its gradients in the direction of the mirror image, towards a mirror and towards grazing views."""
    for roughness in (0.5, 0.1, 0.01, 0.0):
        for cosine in (0.7, 1e-3, 0.0):
            sine = math.sqrt(1.0 - cosine**2)
            normal, view = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([sine, 0.0, cosine])
            light = torch.tensor([-sine, 0.0, cosine], requires_grad=True)
            rough = torch.tensor([roughness], requires_grad=True)
            value = evaluate(normal, light, view, torch.ones(3), rough, torch.ones(1)).sum()
            gradients = torch.cat([gradient.flatten() for gradient in torch.autograd.grad(value, (light, rough))])
            yield (
                f"metal of roughness {roughness:g}, n.v = n.l = {cosine:g}",
                "BRDF towards the mirror image, sum of the colours; its largest derivative by light and roughness",
                f"{value.item():.3g}; {gradients.abs().max().item():.3g}",
            )


def slivers() -> Iterator[Row]:
    """Triangles much longer than wide, in the rasteriser and in the unwrapping."""
    camera = orbit_camera(0.0, 0.0, 4.0, 30.0, 256, 256)
    for width in (1e-2, 1e-4, 1e-6, 0.0):
        generator = torch.Generator().manual_seed(0)
        a, b, across = torch.rand(3, 1000, 3, generator=generator) * 1.6 - 0.8
        corners = torch.stack([a, b, a + width * across], dim=1).reshape(-1, 3)
        fragments = rasterize(corners, torch.arange(3000).reshape(-1, 3), camera)
        sums = fragments.barycentric.sum(dim=0)[fragments.mask]
        error = float((sums - 1.0).abs().max()) if len(sums) else 0.0
        values = torch.cat([fragments.barycentric, fragments.depth[None]])[:, fragments.mask]
        finite = bool(torch.isfinite(values).all())
        yield (
            f"1,000 triangles of length 1 and width {width:g}, rasterised",
            "all finite; largest error of the sum of the barycentric coordinates; pixels covered",
            f"{finite}; {error:.1e}; {int(fragments.mask.sum()):,}",
        )
    for segments in (16, 256, 2048):
        mesh = _prism(segments)
        unwrapped, packing = unwrap(mesh, UnwrapConfig())
        area = signed_areas(unwrapped.uvs, unwrapped.face_uvs).abs()
        inside = bool(((unwrapped.uvs >= 0.0) & (unwrapped.uvs <= 1.0)).all())
        yield (
            f"a cylinder of {segments:,} slivers a side, unwrapped",
            "packed by; charts; all UVs in [0, 1]; faces without area in the atlas",
            f"{packing}; {unwrapped.charts}; {inside}; {int((area <= 0.0).sum())}",
        )


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
    """A wall at arm's length and closer, and a floor that passes under the camera and behind it."""
    for gap in (1.0, 0.1, 0.02, 0.001):
        camera = orbit_camera(0.0, 0.0, gap, 60.0, 128, 128)
        wall = torch.tensor([[-9.0, 0.0, -9.0], [9.0, 0.0, -9.0], [9.0, 0.0, 9.0], [-9.0, 0.0, 9.0]])
        fragments = rasterize(wall, torch.tensor([[0, 1, 2], [0, 2, 3]]), camera)
        seen = float(fragments.mask.float().mean())
        error = float((fragments.depth[fragments.mask] / gap - 1.0).abs().max()) if seen else float("nan")
        yield (
            f"a wall that fills the view, {gap:g} away",
            "share of pixels that see it; largest relative error of the depth",
            f"{seen:.3f}; {error:.1e}" if seen else "0.000: behind the near plane, left out",
        )
    ahead = look_at(torch.zeros(3), torch.tensor([0.0, 1.0, 0.0]))
    camera = Camera(ahead, intrinsics_from_fovy(math.radians(60.0), 128, 128), 128, 128)
    floor = torch.tensor([[-1e3, -1e3, -0.1], [1e3, -1e3, -0.1], [1e3, 1e3, -0.1], [-1e3, 1e3, -0.1]])
    fragments = rasterize(floor, torch.tensor([[0, 1, 2], [0, 2, 3]]), camera)
    expected = 0.1 * camera.K[1, 1] / (torch.arange(64) + 0.5)
    error = (fragments.depth[64:] / expected[:, None] - 1.0).abs().max()
    yield (
        "a floor 0.1 under the camera, from far behind it to the horizon",
        "upper half empty; lower half full; largest relative error of the depth",
        f"{not fragments.mask[:64].any()}; {bool(fragments.mask[64:].all())}; {float(error):.1e}",
    )


def conflicting_views() -> Iterator[Row]:
    """Six views of a green ball, of which some say that it is red."""
    ball, _ = unwrap(extract(lambda p: _ball(p, 10.0), IsosurfaceConfig(resolution=24)), UnwrapConfig())
    texels = texel_map(ball, 128)
    cameras = tuple(orbit_camera(60.0 * k, (20.0, -10.0)[k % 2], 6.0, 30.0, 160, 160) for k in range(6))
    masks = torch.stack([rasterize(ball.vertices, ball.faces, camera).mask for camera in cameras]).float()
    for wrong in range(3):
        images = torch.zeros(6, 4, 160, 160)
        images[:wrong, 0], images[wrong:, 1], images[:, 3] = 1.0, 1.0, masks
        seen = backproject(ball, texels, ViewSet(images, cameras, torch.ones(6), "ball"))
        color, _ = blend(seen, torch.ones(6))
        red, green = seen.visibility[:wrong].sum(dim=0), seen.visibility[wrong:].sum(dim=0)
        decided = (red + green >= 3) & (red != green)
        agrees = (color[1] > color[0]) == (green > red)
        yield (
            f"{wrong} of 6 views show another colour",
            "texels that three or more views see; share of them with the colour of most of their views",
            f"{int(decided.sum()):,}; {agrees[decided].float().mean().item():.3f}",
        )
