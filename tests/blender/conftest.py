"""A torus with a seamed atlas, in an empty Blender file."""

import math
from collections.abc import Callable

import pytest
import torch

from arm_blender.structures import MaterialMaps, RelightableAsset, UvMesh


def torus(rings: int, segments: int) -> UvMesh:
    """A closed, welded torus about the z axis; its atlas is cut open along one ring and one segment."""
    u = torch.arange(rings).repeat_interleave(segments)
    v = torch.arange(segments).repeat(rings)
    around, tube = 2 * math.pi * u / rings, 2 * math.pi * v / segments
    radius = 0.7 + 0.3 * tube.cos()
    vertices = torch.stack([radius * around.cos(), radius * around.sin(), 0.3 * tube.sin()], dim=1)
    corners = [(0, 0), (1, 0), (1, 1), (0, 0), (1, 1), (0, 1)]
    faces = torch.stack([(u + du) % rings * segments + (v + dv) % segments for du, dv in corners], dim=1)
    face_uvs = torch.stack([(u + du) * (segments + 1) + (v + dv) for du, dv in corners], dim=1)
    grid = torch.meshgrid(torch.linspace(0, 1, rings + 1), torch.linspace(0, 1, segments + 1), indexing="ij")
    uvs = torch.stack(grid, dim=-1).reshape(-1, 2)
    return UvMesh(vertices, faces.reshape(-1, 3), uvs, face_uvs.reshape(-1, 3), charts=1)


def noisy_maps(size: int) -> MaterialMaps:
    generator = torch.Generator().manual_seed(1)
    albedo, baked, roughness, metallic = (torch.rand(c, size, size, generator=generator) for c in (3, 3, 1, 1))
    return MaterialMaps(albedo, baked, roughness, metallic)


def plain_maps(albedo: tuple[float, float, float], roughness: float, metallic: float) -> MaterialMaps:
    color = torch.tensor(albedo)[:, None, None].expand(3, 4, 4).contiguous()
    return MaterialMaps(color, color, roughness, metallic)


@pytest.fixture
def make_mesh() -> Callable[[int, int], UvMesh]:
    return torus


@pytest.fixture
def make_plain_maps() -> Callable[..., MaterialMaps]:
    return plain_maps


@pytest.fixture
def maps() -> MaterialMaps:
    return noisy_maps(16)


@pytest.fixture
def asset(maps) -> RelightableAsset:
    return RelightableAsset("ring", torus(24, 12), maps)


@pytest.fixture
def empty_file():
    """Blender with nothing in the open file but an empty scene."""
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy
