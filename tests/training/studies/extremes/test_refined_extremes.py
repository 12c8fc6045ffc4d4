"""The measures of the refinement's extremes: each is as extreme as it says, and sees what it is there for."""

from dataclasses import replace

import pytest
import torch

from arm_blender.graphics.meshes import face_areas
from arm_blender.structures import TriangleMesh
from training.studies.extremes import refined_extremes
from training.studies.extremes.pebble import CAMERAS, ball, pictures, radius, wrong_radius


@pytest.fixture(scope="module")
def start() -> TriangleMesh:
    return ball(wrong_radius, 40)


def test_slivers_are_on_the_same_surface(start):
    mesh = refined_extremes.with_slivers(start)
    longest = (mesh.vertices[mesh.faces] - mesh.vertices[mesh.faces.roll(-1, 1)]).norm(dim=2).amax(dim=1)
    thin = 2.0 * face_areas(mesh.vertices, mesh.faces) / longest.square() < 0.01
    assert float(thin.float().mean()) > 0.2
    assert abs(refined_extremes.distance(mesh) - refined_extremes.distance(start)) < 1e-3


def test_a_close_camera_sees_nothing_but_the_pebble():
    truth = ball(radius, 64)
    views = refined_extremes.with_a_close_camera(pictures(truth), truth)
    assert views.images.shape[0] == 7 and bool((views.images[6, 3] > 0.99).all())


def test_reflections_are_not_alike_in_two_views():
    truth = ball(radius, 64)
    views = pictures(truth)
    mirrored = refined_extremes.with_reflections(views, truth)
    assert torch.equal(mirrored.images[:, 3], views.images[:, 3])
    assert bool(mirrored.images.isfinite().all())
    same = pictures(truth, (CAMERAS[0],) * 6)
    turned = refined_extremes.with_reflections(same, truth)
    assert float((turned.images[0, :3] - turned.images[1, :3]).abs().mean()) > 0.05


@pytest.mark.parametrize("what, finite, folds", [("nothing", True, False), ("nan", False, False), ("swap", True, True)])
def test_what_is_measured_is_what_a_refinement_did(start, monkeypatch, what, finite, folds):
    def moved(mesh, *_):
        vertices, (a, b, _) = mesh.vertices.clone(), mesh.faces[10].tolist()
        if what == "nan":
            vertices[a] = torch.nan
        elif what == "swap":
            vertices[[a, b]] = vertices[[b, a]]
        return _Result(replace(mesh, vertices=vertices))

    monkeypatch.setattr(refined_extremes, "refine", moved)
    found = refined_extremes.measured(start, pictures(start))
    assert found.finite == finite and (found.folded > 0) == folds and not found.taken


class _Result:
    def __init__(self, mesh: TriangleMesh) -> None:
        self.mesh, self.better = mesh, False


def test_float32_solves_as_float64_does(start):
    single, largest = refined_extremes.solve_errors(start)
    assert 0.0 < single < 1e-4 < largest
