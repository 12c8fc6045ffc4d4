"""The paper's alignment: what was moved comes back, what is symmetric or flat stays sound."""

import math

import numpy as np
import pytest
import torch
import trimesh

from arm_blender.structures import TriangleMesh
from training.evaluation.scores.alignment import AlignmentConfig, align, moved_by, poses, similarity_between
from training.evaluation.scores.geometry import compare

SAMPLES, FEW = 10_000, AlignmentConfig(points=500)


def structured(mesh: trimesh.Trimesh) -> TriangleMesh:
    return TriangleMesh(torch.tensor(np.asarray(mesh.vertices), dtype=torch.float32), torch.tensor(mesh.faces.copy()))


def hook() -> TriangleMesh:
    """A shape without any symmetry."""
    bars = [
        ((1.8, 0.3, 0.3), (0.0, 0.0, -0.75)),
        ((0.3, 0.3, 1.2), (0.75, 0.0, 0.0)),
        ((0.3, 1.0, 0.2), (-0.6, 0.4, -0.5)),
    ]
    parts = [trimesh.creation.box(size, trimesh.transformations.translation_matrix(at)) for size, at in bars]
    return structured(trimesh.util.concatenate(parts))


def turned(axis, angle: float, scale: float, shift) -> torch.Tensor:
    motion = torch.eye(4)
    rotation = torch.from_numpy(trimesh.transformations.rotation_matrix(angle, axis)[:3, :3]).float()
    motion[:3, :3], motion[:3, 3] = scale * rotation, torch.tensor(shift)
    return motion


@pytest.mark.parametrize(
    "motion",
    [
        turned((0, 0, 1), math.pi / 2, 1.0, (0.0, 0.0, 0.0)),
        turned((1, 0, 0), -math.pi / 2, 0.2, (3.0, -1.0, 5.0)),
        turned((0, 0, 1), 0.6, 4.0, (0.5, 0.5, 0.0)),
        turned((0, 1, 1), math.pi, 1.1, (0.0, 0.2, 0.0)),
    ],
)
def test_a_moved_copy_comes_back(motion):
    truth = hook()
    copy = truth.moved(moved_by(motion))
    found = copy.moved(moved_by(align(copy, truth, config=FEW)))
    # A hundredth of the object's size: what the points compared can tell.
    assert (found.vertices - truth.vertices).abs().max() < 0.05
    assert compare(found, truth, SAMPLES).f_coarse == 1.0


@pytest.mark.parametrize("shape", [trimesh.creation.box((1.0, 1.0, 1.0)), trimesh.creation.icosphere(subdivisions=3)])
def test_a_symmetric_shape_keeps_its_pose(shape):
    mesh = structured(shape)
    found = align(mesh, mesh, config=FEW)
    assert torch.allclose(found, torch.eye(4), atol=1e-6)


def test_a_cube_is_no_sphere_in_any_pose():
    cube = structured(trimesh.creation.box((1.4, 1.4, 1.4)))
    sphere = structured(trimesh.creation.icosphere(subdivisions=4))
    aligned = compare(cube.moved(moved_by(align(cube, sphere, config=FEW))), sphere, SAMPLES)
    same = compare(sphere.moved(moved_by(align(sphere, sphere, config=FEW))), sphere, SAMPLES)
    assert same.f_coarse == 1.0
    assert aligned.chamfer > 3.0 * same.chamfer
    # No scale is better than all: the corners of the best cube stand out and its faces lie inside.
    assert aligned.f_fine < 0.6


@pytest.mark.parametrize("size", [(2.0, 2.0, 0.0), (2.0, 1e-7, 1e-7), (1e-9, 1e-9, 1e-9)])
def test_flat_long_and_tiny_shapes_give_a_sound_motion(size):
    """A sheet, a needle, a speck."""
    corners = torch.tensor([[-1.0, -1.0, -1.0], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, -1.0]]) / 2.0
    mesh = TriangleMesh(corners * torch.tensor(size), torch.tensor([[0, 1, 2], [0, 2, 3]]))
    motion = align(mesh, hook(), config=FEW)
    assert motion.isfinite().all()
    assert torch.linalg.det(motion[:3, :3].double()) > 0.0


def test_the_similarity_of_points_is_exact_and_never_a_reflection():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(50, 3))
    motion = turned((1, 2, 3), 1.2, 0.7, (1.0, 2.0, 3.0)).double().numpy()
    there = points @ motion[:3, :3].T + motion[:3, 3]
    assert np.allclose(similarity_between(points, there), motion, atol=1e-6)
    mirrored = points * np.array([-1.0, 1.0, 1.0])
    assert np.linalg.det(similarity_between(points, mirrored)[:3, :3]) > 0.0
    same = np.repeat(points[:1], 5, axis=0)
    assert np.allclose(similarity_between(same, same + 1.0)[:3, 3], 1.0)


def test_the_poses_tried_are_rotations_and_begin_with_none():
    tried = list(poses((0.7, 1.0, 1.4)))
    assert np.array_equal(tried[0], np.eye(4))
    for pose in tried:
        scale = np.cbrt(np.linalg.det(pose[:3, :3]))
        assert np.allclose(pose[:3, :3] @ pose[:3, :3].T, scale**2 * np.eye(3))
        assert round(scale, 6) in (0.7, 1.0, 1.4)
    assert len({np.round(pose, 6).tobytes() for pose in tried}) == 28 * 3
