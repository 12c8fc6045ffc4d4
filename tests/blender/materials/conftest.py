"""A square of two regions and a strip of none, as an object of ours, with the extension enabled."""

from dataclasses import replace

import pytest
import torch

import arm_blender
from arm_blender.structures import MaterialMaps, Regions, RelightableAsset, UvMesh

SIDE = 16


def square() -> UvMesh:
    """Of two triangles from (-1, -1) to (1, 1) at height 0; u grows along x, v along y."""
    uvs = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    vertices = torch.cat([2.0 * uvs - 1.0, torch.zeros(4, 1)], dim=1)
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    return UvMesh(vertices, faces, uvs, faces, charts=1)


def two_regions() -> Regions:
    """1 in the left half, 2 in the right one, but none in the uppermost quarter."""
    index = torch.ones(SIDE, SIDE, dtype=torch.uint8)
    index[:, SIDE // 2 :] = 2
    index[: SIDE // 4] = 0
    return Regions(index, (0.5, 0.5), ((0.8, 0.2, 0.1), (0.1, 0.4, 0.9)), light=(0.9, 0.8, 0.5))


@pytest.fixture
def maps(maps) -> MaterialMaps:
    """Noise: every texel has values of its own."""
    return replace(maps, regions=two_regions())


@pytest.fixture
def tile(maps) -> RelightableAsset:
    return RelightableAsset("tile", square(), maps)


@pytest.fixture
def shown(empty_file, tile):
    """The object, active, with the extension enabled."""
    from arm_blender.blender.asset.scene import build_object

    arm_blender.register()
    yield build_object(tile, {})
    arm_blender.unregister()
