"""Hits are those of every ray against every triangle, whatever the grid is made of."""

import pytest
import torch
from torch.nn import functional

from arm_blender.graphics.meshes import face_normals
from arm_blender.graphics.raster import rays
from arm_blender.graphics.raster.rays import MISS, nearest_hits


def naive(origins, directions, vertices, faces, reach):
    """Each ray against each triangle, by the plane and the signs of three volumes, in float64."""
    origins, directions, corners = origins.double(), directions.double(), vertices.double()[faces]
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], dim=1)
    along = directions @ normals.T  # (P, F)
    away = ((corners[None, :, 0] - origins[:, None]) * normals).sum(dim=2) / along
    point = origins[:, None] + away[..., None] * directions[:, None]
    inside = torch.ones_like(away, dtype=torch.bool)
    for i in range(3):
        edge = corners[:, (i + 1) % 3] - corners[:, i]
        inside &= (torch.linalg.cross(edge.expand_as(point), point - corners[:, i], dim=2) * normals).sum(dim=2) >= 0
    away = torch.where(inside & (along > 0), away, torch.inf)
    best = away.abs().min(dim=1)
    return torch.where(best.values <= reach, best.indices, MISS), away.gather(1, best.indices[:, None])[:, 0]


@pytest.mark.parametrize("few", [0, 10**9], ids=["grid", "all pairs"])
@pytest.mark.parametrize("size, reach", [(0.3, 0.1), (0.1, 0.6), (0.8, 0.3)])
def test_hits_equal_those_of_all_pairs(size, reach, few, monkeypatch):
    monkeypatch.setattr(rays, "CHUNK", 1000)
    monkeypatch.setattr(rays, "FEW", few)
    generator = torch.Generator().manual_seed(1)
    centers = torch.rand(400, 1, 3, generator=generator)
    vertices = (centers + size * (torch.rand(400, 3, 3, generator=generator) - 0.5)).reshape(-1, 3)
    faces = torch.arange(1200).view(-1, 3)
    origins = torch.rand(500, 3, generator=generator)
    directions = functional.normalize(torch.randn(500, 3, generator=generator))
    hit, barycentric = nearest_hits(origins, directions, vertices, faces, reach)
    expected, away = naive(origins, directions, vertices, faces, reach)
    # A line that grazes an edge may go either way.
    assert (hit == expected).float().mean() > 0.99
    found = (hit != MISS) & (hit == expected)
    assert found.sum() > 20
    point = (barycentric[found, :, None] * vertices[faces[hit[found]]]).sum(dim=1)
    torch.testing.assert_close(point, origins[found] + away[found, None].float() * directions[found], atol=2e-4, rtol=0)
    assert ((face_normals(vertices, faces)[hit[found]] * directions[found]).sum(dim=1) > 0).all()


def test_nothing_to_hit_and_nothing_to_ask_are_no_error():
    one = torch.eye(3)
    nothing = torch.zeros(0, 3)
    assert nearest_hits(one, one, one, torch.zeros(0, 3, dtype=torch.int64), 1.0)[0].tolist() == [MISS] * 3
    assert nearest_hits(nothing, nothing, one, torch.tensor([[0, 1, 2]]), 1.0)[0].shape == (0,)
    with pytest.raises(ValueError, match="reach"):
        nearest_hits(one, one, one, torch.tensor([[0, 1, 2]]), 0.0)
