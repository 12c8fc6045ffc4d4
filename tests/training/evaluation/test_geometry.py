"""F-score and Chamfer distance against closed forms."""

import math

import numpy as np
import pytest
import torch
import trimesh

from arm_blender.structures import TriangleMesh
from training.evaluation.scores.geometry import ceiling, compare, f_score

SAMPLES = 20_000


def structured(mesh: trimesh.Trimesh) -> TriangleMesh:
    return TriangleMesh(
        torch.tensor(np.asarray(mesh.vertices), dtype=torch.float32),
        torch.tensor(np.asarray(mesh.faces), dtype=torch.int64),
    )


def sphere(radius: float) -> TriangleMesh:
    return structured(trimesh.creation.icosphere(subdivisions=5, radius=radius))


def square(z: float, side: float = 2.0) -> TriangleMesh:
    corners = torch.tensor([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * side / 2.0
    vertices = torch.cat([corners, torch.full((4, 1), z)], dim=1)
    return TriangleMesh(vertices, torch.tensor([[0, 1, 2], [0, 2, 3]]))


def test_a_surface_equals_itself_up_to_the_spacing_of_the_samples():
    scores = compare(sphere(0.8), sphere(0.8), SAMPLES)
    # In a random set of a given density the nearest point is farther than r with probability exp(-density pi r^2),
    # and lies 1 / (2 sqrt(density)) away on average.
    density = SAMPLES / (4.0 * math.pi * 0.8**2)
    assert scores.f_coarse == 1.0
    assert scores.f_fine == pytest.approx(1.0 - math.exp(-density * math.pi * 0.02**2), abs=0.005)
    assert scores.chamfer == pytest.approx(2.0 * 0.5 / math.sqrt(density), rel=0.03)


@pytest.mark.parametrize("gap", [0.05, 0.15])
def test_concentric_spheres_lie_twice_their_gap_apart(gap):
    scores = compare(sphere(0.7 + gap), sphere(0.7), SAMPLES)
    assert scores.chamfer == pytest.approx(2.0 * gap, rel=0.05)
    assert scores.f_coarse == float(gap < 0.1)
    assert scores.f_fine == 0.0


def test_parallel_planes_lie_twice_their_distance_apart():
    assert compare(square(0.3), square(0.0), SAMPLES).chamfer == pytest.approx(0.6, rel=0.01)


def test_normals_are_compared_without_their_sign():
    turned = TriangleMesh(square(0.0).vertices, square(0.0).faces.flip(1))
    assert compare(turned, square(0.0), SAMPLES).angle == pytest.approx(0.0, abs=0.05)
    assert compare(sphere(0.8), sphere(0.8), SAMPLES).angle < 3.0


@pytest.mark.parametrize("degrees", [10.0, 30.0])
def test_a_tilted_square_is_off_by_its_angle(degrees):
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    turn = torch.tensor([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    tilted = TriangleMesh(square(0.0).vertices @ turn.T, square(0.0).faces)
    assert compare(tilted, square(0.0), SAMPLES).angle == pytest.approx(degrees, abs=0.05)


def test_half_a_square_has_full_precision_and_half_the_recall():
    half = TriangleMesh(square(0.0).vertices, square(0.0).faces[:1])
    precision, triangle_and_band = 1.0, 0.5 + 0.1 * math.sqrt(2.0) / 2.0  # A band of 0.1 along the diagonal is met too.
    # The band narrows at both of its ends, by less than the square of its width.
    expected = 2.0 * precision * triangle_and_band / (precision + triangle_and_band)
    assert compare(half, square(0.0), SAMPLES).f_coarse == pytest.approx(expected, abs=0.01)


def test_a_cube_scores_lower_than_a_sphere_against_a_sphere():
    cube = structured(trimesh.creation.box((1.4, 1.4, 1.4)))
    far, near = compare(cube, sphere(0.8), SAMPLES), compare(sphere(0.81), sphere(0.8), SAMPLES)
    assert far.chamfer > near.chamfer and far.f_coarse < near.f_coarse and far.f_fine < near.f_fine


def test_far_surfaces_share_nothing():
    scores = compare(square(0.9), square(-0.9), SAMPLES)
    assert (scores.f_coarse, scores.f_fine) == (0.0, 0.0)


def test_f_score_is_the_harmonic_mean():
    to_truth, to_predicted = np.array([0.0, 0.0, 1.0, 1.0]), np.array([0.0, 1.0, 1.0, 1.0])
    assert f_score(to_truth, to_predicted, 0.5) == pytest.approx(2.0 / (1.0 / 0.5 + 1.0 / 0.25))


def test_the_same_seed_gives_the_same_numbers():
    assert compare(sphere(0.7), sphere(0.8), 2_000, seed=5) == compare(sphere(0.7), sphere(0.8), 2_000, seed=5)


def test_a_mesh_without_area_is_refused():
    line = TriangleMesh(torch.zeros(3, 3), torch.tensor([[0, 1, 2]]))
    with pytest.raises(ValueError, match="without area"):
        compare(line, sphere(0.5), 100)


def test_a_ball_inside_of_a_ball_is_beyond_the_ceiling():
    """What no view sees counts in the truth: of two balls, the inner with a quarter of the area, a fifth is lost."""
    outer, inner = sphere(0.8), sphere(0.4)
    both = TriangleMesh(
        torch.cat([outer.vertices, inner.vertices]), torch.cat([outer.faces, inner.faces + len(outer.vertices)])
    )
    scores, recall = ceiling(both, SAMPLES), 0.8
    assert scores.f_coarse == pytest.approx(2.0 * recall / (1.0 + recall), abs=0.01)
    # Points of the inner ball lie 0.4 from the outer one.
    assert scores.chamfer == pytest.approx(0.2 * 0.4, abs=0.02)
