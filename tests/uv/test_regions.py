"""An atlas falls into the parts that its colours say, wherever its charts are cut."""

import math

import pytest
import torch
from torch import Tensor

from arm_blender.graphics.color import linear_from_srgb
from arm_blender.structures import MaterialMaps, Regions, TexelMap, UvMesh
from arm_blender.uv import regions
from arm_blender.uv.maps import pad
from arm_blender.uv.regions import regions_of
from arm_blender.uv.texels import texel_map

from ..blender.conftest import torus

T = 512
RED, BLUE, GREY, WHITE = ((0.7, 0.2, 0.15), (0.15, 0.25, 0.6), (0.4, 0.4, 0.4), (0.9, 0.9, 0.9))


@pytest.fixture(scope="module")
def mesh() -> UvMesh:
    """A torus whose atlas is shrunk, so that it has a border, and cut open along two circles."""
    ring = torus(48, 24)
    return UvMesh(ring.vertices, ring.faces, 0.1 + 0.8 * ring.uvs, ring.face_uvs, 1)


@pytest.fixture(scope="module")
def texels(mesh) -> TexelMap:
    return texel_map(mesh, T)


def color(srgb: tuple[float, float, float]) -> Tensor:
    return linear_from_srgb(torch.tensor(srgb))[:, None]


def painted(texels: TexelMap, *layers: tuple[Tensor, tuple[float, float, float]], noise: float = 0.0) -> MaterialMaps:
    """Maps on which each layer's (T, T) texels have its colour, sRGB, over those before."""
    albedo = torch.zeros(3, T, T)
    for where, srgb in layers:
        albedo[:, where] = color(srgb)
    albedo += noise * torch.randn(3, T, T, generator=torch.Generator().manual_seed(3)) * albedo
    albedo = pad(albedo.clamp(0.0, 1.0) * texels.mask, texels.mask)
    return MaterialMaps(albedo, (2.0 * albedo).clamp(max=1.0), 0.5, 0.0)


def everywhere(texels: TexelMap) -> Tensor:
    return torch.ones_like(texels.mask)


def test_one_colour_is_one_region(mesh, texels):
    found = regions_of(mesh, painted(texels, (everywhere(texels), RED), noise=0.05), texels.mask)
    assert found.count == 1 and found.area == (pytest.approx(1.0),)
    assert bool((found.index == 1).all())
    assert torch.allclose(torch.tensor(found.swatch[0]), color(RED)[:, 0], atol=0.01)


def test_two_colours_are_two_regions_numbered_by_their_area(mesh, texels):
    """The upper half and a little more is red: the share of the torus above a height has a closed form, about."""
    upper = texels.position[2] > -0.15
    maps = painted(texels, (everywhere(texels), BLUE), (upper, RED), noise=0.05)
    found = regions_of(mesh, maps, texels.mask)
    assert found.count == 2
    # A band of the tube's circle, weighted by its distance to the axis, which is symmetric: 240 of 360 degrees.
    assert found.area[0] == pytest.approx(2.0 / 3.0, abs=0.01) and sum(found.area) == pytest.approx(1.0)
    wrong = (found.index != torch.where(upper, 1, 2)) & texels.mask
    assert float(wrong.sum() / texels.mask.sum()) < 0.003
    for swatch, srgb in zip(found.swatch, (RED, BLUE), strict=True):
        assert torch.allclose(torch.tensor(swatch), color(srgb)[:, 0], atol=0.02)


def test_borders_are_as_crisp_as_the_albedo(mesh, texels):
    """The lattice has half of the texels a side; the border does not have its steps."""
    upper = texels.position[2] > 0.0
    found = regions_of(mesh, painted(texels, (everywhere(texels), BLUE), (upper, RED)), texels.mask)
    red = int(found.index[upper & texels.mask][0])
    assert float((((found.index == red) != upper) & texels.mask).sum() / texels.mask.sum()) < 1e-4


def test_the_same_maps_give_the_same_regions(mesh, texels):
    stripes = (texels.position[0] * 3.0).sin() > 0.2
    maps = painted(texels, (everywhere(texels), WHITE), (stripes, RED), noise=0.1)
    first, again = (regions_of(mesh, maps, texels.mask) for _ in range(2))
    assert torch.equal(first.index, again.index) and first.area == again.area


def test_a_patch_across_a_seam_is_judged_as_a_whole(mesh, texels, monkeypatch):
    """None of its quarters, which lie in the corners of the atlas, would be enough on its own."""
    spot = (texels.position - torch.tensor([1.0, 0.0, 0.0])[:, None, None]).norm(dim=0) < 0.175
    maps = painted(texels, (everywhere(texels), GREY), (spot, (0.95, 0.05, 0.05)))
    found = regions_of(mesh, maps, texels.mask)
    disc = math.pi * 0.175**2 / (4.0 * math.pi**2 * 0.7 * 0.3)
    assert found.count == 2 and found.area[1] == pytest.approx(disc, rel=0.1)
    assert float((found.index[spot & texels.mask] == 2).float().mean()) > 0.95
    monkeypatch.setattr(regions, "_across_seams", lambda *_: torch.zeros(0, 2, dtype=torch.long))
    assert regions_of(mesh, maps, texels.mask).count == 1


def test_specks_join_what_surrounds_them(mesh, texels):
    specks = torch.zeros(T, T, dtype=torch.bool)
    specks[60:450:60, 60:450:60] = True
    specks = torch.nn.functional.max_pool2d(specks[None].float(), 5, 1, 2)[0] > 0
    found = regions_of(mesh, painted(texels, (everywhere(texels), GREY), (specks, RED)), texels.mask)
    assert found.count == 1


def test_a_gradient_of_light_is_not_cut(mesh, texels):
    maps = painted(texels, (everywhere(texels), RED))
    shade = 0.45 + 0.55 * (0.5 + 0.5 * texels.position[0]).clamp(0.0, 1.0)
    maps = MaterialMaps(pad(maps.albedo * shade * texels.mask, texels.mask), maps.baked, 0.5, 0.0)
    assert regions_of(mesh, maps, texels.mask).count == 1


def test_noise_gives_no_more_than_eight(mesh, texels):
    generator = torch.Generator().manual_seed(5)
    albedo = torch.rand(3, 16, 16, generator=generator).repeat_interleave(32, 1).repeat_interleave(32, 2)
    found = regions_of(mesh, MaterialMaps(albedo, albedo, 0.5, 0.0), texels.mask)
    assert 2 <= found.count <= 8
    assert set(found.index.unique().tolist()) <= set(range(1, found.count + 1))
    assert list(found.area) == sorted(found.area, reverse=True) and min(found.area) >= 0.01


@pytest.mark.parametrize("level", [0.0, 1.0])
def test_black_and_white_are_one_region(mesh, texels, level):
    albedo = torch.full((3, T, T), level)
    found = regions_of(mesh, MaterialMaps(albedo, albedo, 0.5, 0.0), texels.mask)
    assert found.count == 1 and all(light == pytest.approx(1.0) for light in found.light)


def test_light_is_the_baked_colour_over_the_albedo(mesh, texels):
    albedo = torch.full((3, T, T), 0.4)
    baked = albedo * torch.tensor([1.5, 1.0, 0.5])[:, None, None]
    found = regions_of(mesh, MaterialMaps(albedo, baked, 0.5, 0.0), texels.mask)
    assert found.light == pytest.approx((1.5, 1.0, 0.5), rel=1e-4)


def test_an_atlas_without_a_texel_has_one_region(mesh):
    maps = MaterialMaps(torch.zeros(3, 8, 8), torch.zeros(3, 8, 8), 0.5, 0.0)
    away = UvMesh(mesh.vertices, mesh.faces, mesh.uvs + 5.0, mesh.face_uvs, 1)
    assert regions_of(away, maps, torch.zeros(8, 8, dtype=torch.bool)).count == 1


def test_regions_refuse_what_they_cannot_be():
    with pytest.raises(ValueError, match="uint8"):
        Regions(torch.ones(4, 4), (1.0,), ((0.5, 0.5, 0.5),))
