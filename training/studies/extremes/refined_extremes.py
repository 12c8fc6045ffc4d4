"""The refinement on a pebble whose true surface is known, and what its pictures or its mesh may be at their worst."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.connectivity import half_edges
from arm_blender.graphics.meshes import vertex_normals
from arm_blender.graphics.raster.rasterize import interpolate, rasterize
from arm_blender.refinement.conjugate_gradient import solved
from arm_blender.refinement.displacement import TERMS
from arm_blender.refinement.refine import refine
from arm_blender.refinement.untangling import folded
from arm_blender.refinement.vertex_graph import Bending, VertexGraph
from arm_blender.structures import TriangleMesh, ViewSet

from ...documents import Row
from .pebble import (
    CAMERAS,
    SIDE,
    ball,
    distance,
    pattern,
    pictures,
    radius,
    slab,
    with_another_picture,
    with_shifted_mask,
    with_turned_cameras,
    with_varying_exposure,
    wrong_radius,
)

ROUNDS = 2
MEASURED = "distance to the pebble in the mean, in 0.001: before; after; was it taken; faces newly folded; all finite"


@dataclass(frozen=True)
class Found:
    """What a refinement did: mean distances before and after, whether it was taken, faces that it folds over,
    and whether all vertices are finite."""

    before: float
    after: float
    taken: bool
    folded: int
    finite: bool


def refined_extremes() -> Iterator[Row]:
    """A row a case."""
    start, truth = ball(wrong_radius, 48), ball(radius, 96)
    views = pictures(truth)
    cases = {
        "six views of a pebble": views,
        "two of three views are one": _chosen(views, [0, 3, 3]),
        "one view three times": _chosen(views, [0, 0, 0]),
        "every view twice": _chosen(views, [0, 1, 2, 3, 4, 5] * 2),
        "a seventh camera, 0.01 from the surface": with_a_close_camera(views, truth),
        "a mirror under light that turns from view to view": with_reflections(views, truth),
        "one of six masks moved by 3 % of the picture": with_shifted_mask(views),
        "one of six pictures is another's": with_another_picture(views),
        "exposure 30 % up and down": with_varying_exposure(views),
        "all cameras turned by half a degree": with_turned_cameras(views),
    }
    for name, shown in cases.items():
        yield _row(name, measured(start, shown))
    yield _row("slivers: a third of the vertices slid almost onto a neighbour", measured(with_slivers(start), views))
    before, after, taken = edge_on()
    yield (
        "a flat top, 0.03 too low, that all six views see edge-on",
        "how far it is from its true height in the mean, in 0.001: before; after; was it taken",
        f"{1e3 * before:.1f}; {1e3 * after:.1f}; {'taken' if taken else 'left'}",
    )
    single, double = solve_errors(start)
    yield (
        "displacements of outlines beside an anchor 1e5 times as weak",
        "largest difference from float64: of the solve in float32; of how far vertices move",
        f"{single:.1e}; {double:.1e}",
    )


def measured(start: TriangleMesh, views: ViewSet) -> Found:
    """`start` refined by `views`, beside the pebble."""
    found = refine(start, views, ROUNDS)
    graph = VertexGraph.of(start.vertices, start.faces)
    over = folded(found.mesh.vertices, graph, start.faces) & ~folded(start.vertices, graph, start.faces)
    finite = bool(found.mesh.vertices.isfinite().all())
    return Found(distance(start), distance(found.mesh), found.better, int(over.sum()), finite)


def _row(name: str, found: Found) -> Row:
    taken = "taken" if found.taken else "left"
    return name, MEASURED, f"{1e3 * found.before:.1f}; {1e3 * found.after:.1f}; {taken}; {found.folded}; {found.finite}"


def _chosen(views: ViewSet, numbers: list[int]) -> ViewSet:
    cameras = tuple(views.cameras[number] for number in numbers)
    return ViewSet(views.images[numbers], cameras, torch.ones(len(numbers)), views.name)


def with_a_close_camera(views: ViewSet, truth: TriangleMesh) -> ViewSet:
    """The views, and one from so near that the pebble fills it."""
    reach = float(truth.vertices[:, 1].min())  # A camera at azimuth 0 looks along +Y.
    close = pictures(truth, (orbit_camera(0.0, 0.0, 0.01 - reach, 60.0, SIDE, SIDE),))
    return ViewSet(torch.cat([views.images, close.images]), (*views.cameras, *close.cameras), torch.ones(7), views.name)


def with_reflections(views: ViewSet, truth: TriangleMesh) -> ViewSet:
    """Nothing but what a mirror shows of surroundings, which turn by 50 degrees from view to view."""
    images, normals = views.images.clone(), vertex_normals(truth.vertices, truth.faces)
    for number, camera in enumerate(CAMERAS):
        fragments = rasterize(truth.vertices, truth.faces, camera)
        points = interpolate(truth.vertices, truth.faces, fragments).flatten(1).T
        normal = torch.nn.functional.normalize(interpolate(normals, truth.faces, fragments).flatten(1).T, dim=1)
        towards = torch.nn.functional.normalize(points - camera.c2w[:3, 3], dim=1)
        mirrored = towards - 2.0 * (towards * normal).sum(dim=1, keepdim=True) * normal
        angle = torch.tensor(number * 50.0).deg2rad()
        x, y, z = mirrored.unbind(dim=1)
        around = torch.stack([angle.cos() * x - angle.sin() * y, angle.sin() * x + angle.cos() * y, z], dim=1)
        images[number, :3] = pattern(around).T.view(3, SIDE, SIDE)
    return replace(views, images=images)


def with_slivers(mesh: TriangleMesh) -> TriangleMesh:
    """The same surface with every third vertex 0.999 of the way to one of its neighbours."""
    edges = half_edges(mesh.faces)
    neighbour = torch.arange(len(mesh.vertices)).scatter(0, edges[:, 0], edges[:, 1])
    moves = torch.arange(len(mesh.vertices)) % 3 == 0
    moves &= ~moves[neighbour]  # Two that swapped their places would fold all around them.
    vertices = mesh.vertices.clone()
    vertices[moves] += 0.999 * (vertices[neighbour[moves]] - vertices[moves])
    return replace(mesh, vertices=vertices)


def edge_on() -> tuple[float, float, bool]:
    """A slab in views at the height of its top: mean errors of the top before and after, and whether it was taken."""
    low, height = 0.27, 0.3
    start = slab(lambda points: torch.full_like(points[:, 0], low), 48)
    truth = slab(lambda points: torch.full_like(points[:, 0], height), 96)
    cameras = tuple(orbit_camera(60.0 * k, 0.0, 6.0, 24.0, SIDE, SIDE) for k in range(6))
    for camera in cameras:
        camera.c2w[2, 3] += height
    found = refine(start, pictures(truth, cameras), ROUNDS)
    top = (start.vertices[:, 2] > low - 0.01) & (start.vertices[:, :2].abs().amax(dim=1) < 0.6)
    errors = [float((mesh.vertices[top, 2] - height).abs().mean()) for mesh in (start, found.mesh)]
    return errors[0], errors[1], found.better


def solve_errors(mesh: TriangleMesh) -> tuple[float, float]:
    """Of a solve in which a third of the vertices is held: its largest error in float32, and its largest value."""
    normals = vertex_normals(mesh.vertices, mesh.faces)
    generator = torch.Generator().manual_seed(1)
    held = torch.where(torch.rand(len(normals), generator=generator) < 0.33, 1e5, 1.0 / TERMS.anchor**2)
    wanted = held * 0.02 * torch.randn(len(normals), generator=generator)
    bending = Bending.of(VertexGraph.of(mesh.vertices, mesh.faces), mesh.vertices, normals)
    stiff = torch.full_like(held, 1.0 / TERMS.plate**2)
    right = wanted - bending.transposed(stiff * bending.still)
    found = _solve(bending, stiff, held, right, 1e-4)
    exact = _solve(
        replace(bending, forth=bending.forth.double(), back=bending.back.double(), still=bending.still.double()),
        stiff.double(),
        held.double(),
        right.double(),
        1e-12,
    )
    return float((found - exact).abs().max()), float(exact.abs().max())


def _solve(
    bending: Bending, stiff: torch.Tensor, held: torch.Tensor, right: torch.Tensor, tolerance: float
) -> torch.Tensor:
    return solved(
        lambda x: bending.transposed(stiff * bending.change(x)) + held * x,
        held + bending.diagonal(stiff),
        right,
        torch.zeros_like(right),
        tolerance,
    )
