"""An asset stands on the ground at the size that was asked for, and the way back is kept."""

import pytest
import torch

from arm_blender.structures import MaterialMaps, RelightableAsset, UvMesh
from arm_blender.views.placement import on_the_ground

FACES = torch.tensor([[0, 1, 2], [0, 2, 3]])


def asset(vertices: torch.Tensor) -> RelightableAsset:
    maps = MaterialMaps(*(torch.zeros(channels, 4, 4) for channels in (3, 3, 1, 1)))
    return RelightableAsset("plate", UvMesh(vertices, FACES, torch.zeros(4, 2), FACES, 1), maps)


@pytest.mark.parametrize("size", [None, 0.25, 40.0])
def test_the_foot_is_at_the_origin_and_the_longest_side_as_asked(size):
    vertices = torch.tensor([[1.0, 5.0, -2.0], [4.0, 5.0, -2.0], [4.0, 6.0, -1.0], [1.0, 6.0, -1.0]])
    stood, frame = on_the_ground(asset(vertices), size)
    low, high = stood.mesh.vertices.amin(0), stood.mesh.vertices.amax(0)
    assert float((high - low).max()) == pytest.approx(3.0 if size is None else size)
    assert float(low[2]) == pytest.approx(0.0, abs=1e-6)
    assert ((low + high) / 2.0)[:2].tolist() == pytest.approx([0.0, 0.0], abs=1e-6)
    assert torch.allclose(frame.restore(stood.mesh.vertices), vertices, atol=1e-5)


def test_a_point_keeps_its_size():
    stood, _ = on_the_ground(asset(torch.ones(4, 3)), 2.0)
    assert bool(stood.mesh.vertices.isfinite().all())
