"""From extreme pictures and cameras to an asset of numbers, or to one line that names the file and the remedy."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from arm_blender import pipeline
from arm_blender.config import Settings
from arm_blender.errors import CheckpointError, InputImageError
from arm_blender.graphics import silhouette_fill
from arm_blender.graphics.cameras import orbit_camera
from arm_blender.models.atlas_network import Painted
from arm_blender.models.small.finish import Finish
from arm_blender.models.small.instant_albedo import InstantAlbedo
from arm_blender.models.small.ray_occupancy import RayOccupancy
from arm_blender.models.small.volume_georm import VolumeGeoRM
from arm_blender.structures import TriangleMesh, ViewSet
from arm_blender.views import load_views

QUICK = Settings(quality="draft", grid=32, faces=500, texture_size=256)
SIDE = 48


def views_of_a_disc(color: float, cameras: int = 2) -> ViewSet:
    """Views from the front and the side in which the same disc stands, of one grey."""
    centers = torch.arange(SIDE) + 0.5 - SIDE / 2
    alpha = (centers[:, None] ** 2 + centers[None] ** 2 < (0.35 * SIDE) ** 2).float()
    images = torch.cat([torch.full((3, SIDE, SIDE), color), alpha[None]]).expand(cameras, -1, -1, -1)
    rig = tuple(orbit_camera(90.0 * k, 10.0, 4.0, 40.0, SIDE, SIDE) for k in range(cameras))
    return ViewSet(images, rig, torch.ones(cameras), "disc")


def with_a_camera_inside(views: ViewSet) -> ViewSet:
    inside = orbit_camera(30.0, 0.0, 0.1, 60.0, SIDE, SIDE)
    images = torch.cat([views.images, torch.ones(1, 4, SIDE, SIDE)])
    return ViewSet(images, (*views.cameras, inside), torch.ones(len(images)), views.name)


@pytest.mark.parametrize(
    "views",
    [
        with_a_camera_inside(views_of_a_disc(0.0)),
        views_of_a_disc(1.0).only([0, 0, 0]),
        views_of_a_disc(0.0, 1),
    ],
    ids=["black, and a camera inside", "white, and one view three times", "one black view"],
)
def test_extreme_views_become_an_asset_of_numbers(views, monkeypatch):
    for name, value in (("GRID", 24), ("SIDE", 60), ("STEPS", 33)):  # Coarser: most of the time of such small views.
        monkeypatch.setattr(silhouette_fill, name, value)
    asset, _ = pipeline.generate(views, QUICK)
    maps = asset.maps
    for image in map(maps.image, ("albedo", "baked", "roughness", "metallic")):
        assert bool(((image >= 0.0) & (image <= 1.0)).all())
    assert bool(asset.mesh.vertices.isfinite().all())
    assert bool(((asset.mesh.uvs >= 0.0) & (asset.mesh.uvs <= 1.0)).all())


def test_a_view_that_shows_nothing_is_named():
    views = views_of_a_disc(0.5)
    images = views.images.clone()
    images[1, 3] = 0.0
    with pytest.raises(InputImageError, match="disc: view 1 shows nothing"):
        pipeline.generate(replace(views, images=images), QUICK)


@pytest.mark.parametrize("network", ["georm", "ray_occupancy", "finish", "instant_albedo"])
def test_weights_that_overflow_are_named(network, monkeypatch):
    def overflowing(encode):
        part = {"georm": "volume", "ray_occupancy": "logits"}[network]
        return lambda self, views: replace(encode(self, views), **{part: torch.full((1, 3, 1, 2, 2), torch.inf)})

    kind = {"georm": VolumeGeoRM, "ray_occupancy": RayOccupancy}.get(network)
    if kind:
        monkeypatch.setattr(kind, "encode", overflowing(kind.encode))
    elif network == "finish":
        monkeypatch.setattr(Finish, "maps", lambda self, surface, points: surface[:2] * torch.nan)
    else:
        monkeypatch.setattr(
            InstantAlbedo, "painted", lambda self, *given: Painted(given[-1] * torch.nan, given[-1], None)
        )
    mesh = None
    if network not in ("georm", "ray_occupancy"):  # A mesh of the user's saves the time of making one.
        ball = trimesh.creation.icosphere(2, 0.6)
        mesh = TriangleMesh(torch.from_numpy(ball.vertices.copy()).float(), torch.from_numpy(ball.faces.copy()))
    with pytest.raises(CheckpointError, match=rf"small\.{network}\.safetensors: overflows on disc; use the weights"):
        pipeline.generate(views_of_a_disc(0.5, 1 if network == "ray_occupancy" else 3), QUICK, mesh=mesh)


PICTURES = {
    "all black": (np.zeros((64, 64, 3)), "alpha"),
    "all white": (np.full((64, 64, 3), 255), "alpha"),
    "transparent": (np.zeros((64, 64, 4)), "alpha"),
    "one pixel": (np.full((1, 1, 3), 255), "1x1 pixels; give at least 16"),
    "one transparent pixel": (np.zeros((1, 1, 4)), "1x1 pixels; give at least 16"),
    "one opaque pixel": (np.pad(np.full((1, 1, 4), 255), ((31, 32), (31, 32), (0, 0))), "alpha"),
}


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_of_nothing_is_refused_by_name(tmp_path, name):
    pixels, remedy = PICTURES[name]
    Image.fromarray(pixels.astype(np.uint8)).save(tmp_path / "cup.png")
    with pytest.raises(InputImageError, match=rf"cup\.png: .*{remedy}"):
        load_views(tmp_path / "cup.png")


@pytest.mark.parametrize("object_level", [0, 255])
def test_a_black_or_white_object_is_found_before_its_opposite(tmp_path, object_level):
    pixels = np.full((64, 64, 3), 255 - object_level, np.uint8)
    pixels[16:48, 20:44] = object_level
    Image.fromarray(pixels).save(tmp_path / "cup.png")
    views = load_views(tmp_path / "cup.png")
    shown = views.images[0, 3] > 0.5
    assert int(shown.sum()) == 32 * 24
    assert bool((views.images[0, :3, shown] == object_level / 255.0).all())


def test_a_large_picture_is_brought_to_the_size_of_a_view(tmp_path):
    """8,192 pixels a side are read, 8,193 are refused before they are decoded."""
    pixels = np.full((128, 8192, 3), 255, np.uint8)
    pixels[32:96, 2000:4000] = 60
    Image.fromarray(pixels).save(tmp_path / "long.png")
    views = load_views(tmp_path / "long.png")
    assert max(views.images.shape[2:]) == 2048
    assert bool(views.images.isfinite().all())
    Image.new("L", (8193, 32)).save(tmp_path / "longer.png")
    with pytest.raises(InputImageError, match="longer.png: 8193x32 pixels; scale it to at most 8192"):
        load_views(tmp_path / "longer.png")
