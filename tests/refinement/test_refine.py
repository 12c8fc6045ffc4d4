"""What the pictures show is found again, and pictures that disagree make nothing worse."""

from dataclasses import replace

import pytest
import torch

from arm_blender.errors import Cancelled
from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.connectivity import manifold_pairs
from arm_blender.graphics.meshes import face_normals
from arm_blender.refinement import refine as refine_module
from arm_blender.refinement.refine import SWEPT, refine
from arm_blender.refinement.untangling import folded
from arm_blender.refinement.vertex_graph import VertexGraph
from arm_blender.structures import TriangleMesh, ViewSet
from training.studies.extremes.pebble import (
    ball,
    dent,
    distance,
    pictures,
    radius,
    slab,
    with_another_picture,
    with_shifted_mask,
    with_turned_cameras,
    with_varying_exposure,
    wrong_radius,
)


@pytest.fixture(scope="module")
def start() -> TriangleMesh:
    return ball(wrong_radius, 48)


@pytest.fixture(scope="module")
def views() -> ViewSet:
    return pictures(ball(radius, 96))


def test_the_mesh_meets_its_pictures(start, views):
    found = refine(start, views)
    assert found.better and found.after < 0.5 * found.before
    assert distance(found.mesh) < 0.4 * distance(start)


def test_photographs_have_a_limit_of_their_own(start, views, monkeypatch):
    monkeypatch.setattr(refine_module, "ENOUGH", 0.0)
    assert not refine(start, views, 1).better
    assert refine(start, replace(views, varying_exposure=True), 1).better


def test_the_faces_stay_and_none_folds_over(start, views):
    mesh = refine(start, views).mesh
    assert torch.equal(mesh.faces, start.faces)
    assert len(manifold_pairs(mesh.faces)) * 2 == mesh.faces.numel()  # It is still closed.
    assert bool(mesh.vertices.isfinite().all())
    graph = VertexGraph.of(start.vertices, start.faces)
    assert not bool((folded(mesh.vertices, graph, mesh.faces) & ~folded(start.vertices, graph, start.faces)).any())


@pytest.mark.parametrize(
    "conflict", [with_shifted_mask, with_another_picture, with_varying_exposure, with_turned_cameras]
)
def test_views_that_disagree_make_nothing_worse(start, views, conflict):
    assert distance(refine(start, conflict(views)).mesh) <= distance(start)


def test_a_view_that_parts_from_all_others_is_trusted_least(start, views):
    trust = refine(start, with_shifted_mask(views, 0.08)).trust
    assert min(trust) == trust[2] and trust[2] < 0.5
    assert sorted(trust)[1] > 2.0 * trust[2]


def test_a_dent_that_no_outline_shows_is_found_by_its_pattern():
    cameras = [orbit_camera(azimuth, 50.0, 6.0, 24.0, 200, 200) for azimuth in range(0, 360, 60)]
    views = pictures(slab(dent, 96), cameras)
    flat = slab(lambda points: torch.full_like(points[:, 0], 0.3), 48)
    mesh = refine(flat, views, rounds=3).mesh
    x, y, z = mesh.vertices.unbind(dim=1)
    upper = (face_normals(mesh.vertices, mesh.faces)[:, 2] > 0.8).nonzero()[:, 0]
    on_top = torch.zeros(len(z), dtype=torch.bool)
    on_top[mesh.faces[upper].flatten()] = True
    on_top &= (x.abs() < 0.55) & (y.abs() < 0.55) & (z > 0.0)
    off = (z - dent(mesh.vertices))[on_top].abs()
    assert float(off.mean()) < 0.01 and float(off.max()) < 0.03
    middle = on_top & (x.hypot(y) < 0.1)
    assert float(z[middle].mean()) < 0.3 - 0.04


def test_nothing_to_improve_stays_as_it_is(views):
    right = ball(radius, 48)
    assert distance(refine(right, views).mesh) < 0.006


def test_a_border_that_cuts_the_object_is_no_outline(views):
    right, middle = ball(radius, 48), 80
    images = views.images.clone()
    images[:3, :, :, middle:] = 0.0
    cut = replace(views, images=images, known=((0, 0, middle, 160),) * 3 + ((0, 0, 160, 160),) * 3)
    found = refine(right, cut)
    assert found.after < 0.3 and distance(found.mesh) < 0.006
    # The same pictures, taken for whole ones, ask for half an object.
    assert refine(right, replace(cut, known=None)).before > 10.0 * found.before


def test_a_mesh_with_more_vertices_than_are_compared_is_met_as_well(views):
    fine = ball(wrong_radius, 110)
    assert len(fine.vertices) > 1.5 * SWEPT
    assert distance(refine(fine, views).mesh) < 0.4 * distance(fine)


def test_a_stop_is_noticed_between_any_two_steps(start, views):
    calls = []
    refine(start, views, progress=lambda fraction, message: calls.append(fraction))
    assert calls == sorted(calls) and 0.0 <= calls[0] and calls[-1] <= 1.0 and len(calls) > 60

    def stop(fraction: float, message: str) -> None:
        if fraction >= calls[len(calls) // 2]:
            raise Cancelled("stopped")

    with pytest.raises(Cancelled):
        refine(start, views, progress=stop)


def test_the_same_comes_out_twice(start, views):
    first, second = (refine(start, views).mesh.vertices for _ in range(2))
    assert torch.equal(first, second)
