"""Pictures on the fly: rigs like rendered ones, the same for the same seed, lit as closed forms say."""

import math

import numpy as np
import pytest
import torch
import trimesh

from arm_blender.graphics.cameras import Camera, orbit_camera, unproject
from arm_blender.graphics.color import linear_from_srgb
from arm_blender.structures import TriangleMesh
from training.rasterized import lights as rasterized_lights
from training.rasterized import pictures as rasterized
from training.rasterized import surface as rasterized_surface
from training.rasterized.lights import HEIGHT, WIDTH, Sun, lighting
from training.rasterized.materials import Finish, Procedural, random_pattern
from training.rasterized.textures import LABELS, NOTHING
from training.rendering.shards import cameras, save_arrays

SIZE = 48


def box(low, high) -> TriangleMesh:
    shape = trimesh.creation.box(bounds=[low, high])
    return TriangleMesh(torch.tensor(shape.vertices).float(), torch.tensor(shape.faces))


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    offset, faces = 0, []
    for mesh in meshes:
        faces.append(mesh.faces + offset)
        offset += len(mesh.vertices)
    return TriangleMesh(torch.cat([mesh.vertices for mesh in meshes]), torch.cat(faces))


@pytest.fixture(scope="module")
def ball():
    shape = trimesh.creation.icosphere(subdivisions=4, radius=0.9)
    mesh = TriangleMesh(torch.tensor(shape.vertices).float(), torch.tensor(shape.faces))
    return rasterized_surface.surface_of(mesh)


@pytest.fixture(scope="module")
def table():
    """A floor and a smaller plate that hovers over it."""
    return rasterized_surface.surface_of(
        joined(box((-1, -1, -0.6), (1, 1, -0.5)), box((-0.4, -0.4, 0.1), (0.4, 0.4, 0.2)))
    )


def plain(albedo=(0.5, 0.5, 0.5), roughness=1.0, metallic=0.0) -> Finish:
    generator = torch.Generator().manual_seed(0)
    pattern = random_pattern(generator, 1.0, 2.0)
    end = torch.tensor([*albedo, roughness, metallic])
    material = Procedural(LABELS.index("rubber"), torch.stack([end, end]), pattern, pattern)
    return Finish((material,), "parts", pattern, torch.zeros(1, 3))


def views(*angles) -> tuple[Camera, ...]:
    return tuple(orbit_camera(azimuth, elevation, 5.0, 30.0, SIZE, SIZE) for azimuth, elevation in angles)


@pytest.fixture(scope="module")
def rig(ball):
    return rasterized.random_rig(ball, rasterized.Library([], []), SIZE, torch.Generator().manual_seed(3))


def test_a_rig_has_the_arrays_of_a_rendered_one(rig):
    kinds = {name: (array.dtype.name, array.shape[1:]) for name, array in rig.items()}
    picture = (SIZE, SIZE)
    assert kinds == {
        "rgba": ("uint8", (*picture, 4)),
        "albedo": ("uint8", (*picture, 3)),
        "roughness": ("uint8", picture),
        "metallic": ("uint8", picture),
        "depth": ("float16", picture),
        "normal": ("int8", (*picture, 3)),
        "c2w": ("float32", (4, 4)),
        "K": ("float32", (3, 3)),
        "material": ("uint8", picture),
    }
    assert {len(array) for array in rig.values()} == {10}


def test_depth_and_normals_are_those_of_the_ball(rig):
    for k, camera in enumerate(cameras(rig)):
        row, column = np.nonzero(np.isfinite(rig["depth"][k]))
        pixels = torch.tensor(np.stack([column, row], axis=1) + 0.5).float()
        points = unproject(pixels, torch.from_numpy(rig["depth"][k][row, column]).float(), camera)
        assert len(points) > 100
        assert (points.norm(dim=1) - 0.9).abs().max() < 0.02
        normal = torch.from_numpy(rig["normal"][k][row, column]) / 127.0
        assert ((normal * points).sum(dim=1) / points.norm(dim=1)).min() > 0.98


def test_a_pixel_has_a_material_where_it_has_depth(rig):
    there = np.isfinite(rig["depth"])
    assert (rig["material"][there] < len(LABELS)).all()
    assert (rig["material"][~there] == NOTHING).all()
    assert (rig["rgba"][..., 3][there] > 0).all()
    assert ((rig["rgba"][..., 3] > 0) & (rig["rgba"][..., 3] < 255)).any()


def test_the_same_seed_gives_the_same_rig(ball, rig):
    def again(seed):
        return rasterized.random_rig(ball, rasterized.Library([], []), SIZE, torch.Generator().manual_seed(seed))

    same, other = again(3), again(4)
    assert all(np.array_equal(rig[name], same[name]) for name in rig)
    assert not np.array_equal(rig["rgba"], other["rgba"])


def test_under_even_light_a_white_ball_is_as_bright_as_the_light(ball):
    """The furnace: what a matt white surface sends on is what it gets, the coat's small losses aside."""
    even = lighting(torch.full((3, HEIGHT, WIDTH), 0.5))
    pictures = rasterized.rig_of(ball, views((0, 20), (120, -30)), plain((1.0, 1.0, 1.0)), even)
    shown = linear_from_srgb(torch.from_numpy(pictures["rgba"]) / 255.0)[..., :3]
    inside = torch.from_numpy(np.isfinite(pictures["depth"]))
    assert (shown[inside] - 0.5).abs().max() < 0.05


def test_a_smooth_metal_ball_mirrors_the_environment(ball):
    """Seen from -Y, the middle of a mirror shows what lies there, its upper part what lies above."""
    radiance = torch.zeros(3, HEIGHT, WIDTH)
    radiance[0, : HEIGHT // 2] = 0.8
    radiance[1, HEIGHT // 2 :] = 0.8
    (picture,) = rasterized.rig_of(ball, views((0, 0)), plain((1.0, 1.0, 1.0), 0.0, 1.0), lighting(radiance))["rgba"]
    shown = linear_from_srgb(torch.from_numpy(picture) / 255.0)
    upper, lower = shown[SIZE // 2 - 6, SIZE // 2], shown[SIZE // 2 + 5, SIZE // 2]
    assert upper[0] == pytest.approx(0.8, abs=0.05) and upper[1] < 0.05
    assert lower[1] == pytest.approx(0.8, abs=0.05) and lower[0] < 0.05


def test_a_sun_is_lambert_s_and_casts_a_shadow(table):
    sun = Sun(torch.tensor([0.0, 0.0, 1.0]), torch.full((3,), 1.2), 0.0)
    dark = lighting(torch.full((3, HEIGHT, WIDTH), 1e-4), (sun,))
    pictures = rasterized.rig_of(table, views((0, 60)), plain(), dark)
    shown = linear_from_srgb(torch.from_numpy(pictures["rgba"][0]) / 255.0)[..., 0]
    camera = views((0, 60))[0]
    centers = torch.arange(SIZE) + 0.5
    pixels = torch.stack(torch.meshgrid(centers, centers, indexing="xy"), dim=-1)
    depth = torch.from_numpy(pictures["depth"][0]).float()
    there = depth.isfinite()
    points = unproject(pixels, torch.where(there, depth, 1.0), camera)
    floor = there & (points[..., 2] < -0.49) & (points[..., 2] > -0.52)
    aside = points[..., :2].abs().amax(dim=-1)
    lit, hidden = floor & (aside > 0.5), floor & (aside < 0.3)
    assert lit.sum() > 100 and hidden.sum() > 10
    expected = 0.5 * 1.2 / math.pi  # The coat takes about 5 % and mirrors little upwards.
    assert shown[lit].median() == pytest.approx(expected, rel=0.1)
    assert shown[hidden].max() < 0.1 * expected


def test_what_hangs_over_a_surface_takes_its_sky(table):
    """The middle of the floor sees less of an even sky than its corners do: the plate's share of the cosine."""
    even = lighting(torch.full((3, HEIGHT, WIDTH), 1.0))
    light = rasterized.light_vertices(table, even, plain((0.0, 0.0, 0.0)))
    up = (table.normals[:, 2] > 0.9) & (table.vertices[:, 2] < -0.4)
    middle = up & (table.vertices[:, :2].norm(dim=1) < 0.15)
    corner = up & (table.vertices[:, :2].norm(dim=1) > 1.3)
    # A square of half side a at height h over its middle hides this share of the cosine-weighted sky.
    a, h = 0.4, 0.6
    hidden = 4.0 / math.pi * a / math.hypot(a, h) * math.atan(a / math.hypot(a, h))
    assert light.irradiance[: len(up)][middle].mean() / math.pi == pytest.approx(1.0 - hidden, abs=0.06)
    assert light.irradiance[: len(up)][corner].mean() / math.pi == pytest.approx(1.0, abs=0.06)


def test_a_sheet_is_lit_from_both_sides():
    """A square with light from below alone: seen from below it is as bright as the light, from above it is dark."""
    corners = torch.tensor([[-0.8, -0.8, 0.0], [0.8, -0.8, 0.0], [0.8, 0.8, 0.0], [-0.8, 0.8, 0.0]])
    sheet = rasterized_surface.surface_of(TriangleMesh(corners, torch.tensor([[0, 1, 2], [0, 2, 3]])))
    radiance = torch.zeros(3, HEIGHT, WIDTH)
    radiance[:, HEIGHT // 2 :] = 0.6
    pictures = rasterized.rig_of(sheet, views((0, -60), (0, 60)), plain((1.0, 1.0, 1.0)), lighting(radiance))
    below, above = linear_from_srgb(torch.from_numpy(pictures["rgba"]) / 255.0)[:, SIZE // 2, SIZE // 2, 0]
    assert below == pytest.approx(0.6, abs=0.05)
    assert above < 0.05
    assert (
        pictures["normal"][0, SIZE // 2, SIZE // 2, 2] < -120 and pictures["normal"][1, SIZE // 2, SIZE // 2, 2] > 120
    )


def test_the_sun_of_an_environment_is_taken_out_without_loss():
    radiance = torch.full((3, HEIGHT, WIDTH), 0.3)
    radiance[:, 20, 40] = 500.0
    found = lighting(radiance)
    (sun,) = found.suns
    lights = rasterized_lights.Environment(radiance).texels()
    assert sun.direction @ lights.direction[20 * WIDTH + 40] > 0.9999
    up = torch.tensor([0.0, 0.0, 1.0])
    whole = (lights.power * (lights.direction @ up).clamp(min=0.0)[:, None]).sum(dim=0)
    parts = torch.einsum("dac,a->dc", found.cones, up).clamp(min=0.0).sum(dim=0) + sun.power * (sun.direction @ up)
    torch.testing.assert_close(parts, whole, rtol=0.02, atol=0.0)


@pytest.mark.parametrize("roughness", [0.0, 1.0])
@pytest.mark.parametrize("metallic", [0.0, 1.0])
@pytest.mark.parametrize("radiance", [0.0, 1e5])
def test_light_and_material_at_their_ends_give_numbers(table, roughness, metallic, radiance):
    sun = Sun(torch.tensor([0.0, -0.6, 0.8]), torch.full((3,), radiance), 0.0)
    light = lighting(torch.full((3, HEIGHT, WIDTH), radiance), (sun,))
    finish = plain((1.0, 0.0, 0.5), roughness, metallic)
    found = rasterized.light_vertices(table, light, finish)
    points, _, _ = rasterized.points_in_views(table, views((0, 60)), finish, found)
    color = rasterized.shade(points, table, light, found.own)
    assert len(color) > 100
    assert color.isfinite().all() and color.min() >= 0.0


def test_a_box_keeps_its_edges_and_a_ball_is_smooth(ball):
    cube = rasterized_surface.surface_of(box((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)))
    assert cube.normals.abs().amax(dim=1).min() > 0.9999
    corners = cube.vertices[cube.faces]
    assert (corners - corners.roll(1, dims=1)).norm(dim=2).max() <= 0.12
    assert (ball.normals * ball.vertices).sum(dim=1).min() > 0.9 * 0.999
    assert len(torch.unique(ball.vertices, dim=0)) == len(ball.vertices)


def test_a_surface_is_kept_as_it_is(tmp_path, ball):
    mesh = tmp_path / "a" / "mesh.npz"
    mesh.parent.mkdir()
    shape = box((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))
    save_arrays(mesh, {"vertices": shape.vertices.numpy(), "faces": shape.faces.int().numpy()})
    made = rasterized.surface_at(mesh, tmp_path / "kept")
    mesh.unlink()
    kept = rasterized.surface_at(mesh, tmp_path / "kept")
    for name in ("vertices", "normals", "faces", "part", "visible"):
        assert torch.equal(getattr(made, name), getattr(kept, name))
