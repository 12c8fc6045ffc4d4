"""The truth of the occupancy warm-up: known solids, and open ones that stay hollow."""

import numpy as np
import pytest
import torch
import trimesh

from arm_blender.structures import TriangleMesh
from training.rendering import occupancy


@pytest.fixture(autouse=True)
def fewer(monkeypatch):
    for name, value in (("NEAR_POINTS", 3000), ("BAND_POINTS", 3000), ("BOX_POINTS", 3000), ("SURFACE_POINTS", 40_000)):
        monkeypatch.setattr(occupancy, name, value)


def distances(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    triangles = TriangleMesh(torch.from_numpy(mesh.vertices).float(), torch.from_numpy(mesh.faces).long())
    points, distance = occupancy.signed_distances(triangles, torch.Generator().manual_seed(0))
    return points.numpy(), distance.numpy()


def test_a_balls_distances_are_those_of_the_formula():
    points, distance = distances(trimesh.creation.icosphere(subdivisions=4, radius=0.8))
    truth = (0.8 - np.linalg.norm(points, axis=1)).clip(-occupancy.FARTHEST, occupancy.FARTHEST)
    # 40,000 surface points lie some 0.014 apart; the facets cut 0.002 off the ball.
    assert np.abs(np.abs(distance) - np.abs(truth)).max() < 0.02
    clear = np.abs(truth) > 0.02
    assert np.array_equal(distance[clear] > 0, truth[clear] > 0)


def test_an_open_box_is_hollow_and_a_closed_one_with_inner_walls_is_solid():
    outer = trimesh.creation.box((1.6, 1.6, 1.6))
    inner = trimesh.creation.box((1.2, 1.2, 1.2))
    closed = trimesh.util.concatenate([outer, inner])
    points, distance = distances(closed)
    middle = np.abs(points).max(axis=1) < 0.5
    assert (distance[middle] > 0).all()
    lid = np.abs(outer.triangles_center[:, 2] - 0.8) < 1e-6
    open_box = trimesh.Trimesh(outer.vertices, outer.faces[~lid], process=False)
    points, distance = distances(open_box)
    middle = (np.abs(points[:, :2]).max(axis=1) < 0.5) & (points[:, 2] > 0.0) & (points[:, 2] < 0.7)
    assert middle.sum() > 50 and (distance[middle] < 0).mean() > 0.99
