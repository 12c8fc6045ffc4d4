"""What the sparse grid leaves out: nothing where a bound is known, next to nothing of the shipped network's fields."""

from dataclasses import replace

import pytest
import torch
import trimesh
from scipy.spatial import cKDTree
from torch import Tensor

from arm_blender.config import PRESETS, Settings
from arm_blender.graphics import silhouette_fill
from arm_blender.graphics.connectivity import components, half_edges
from arm_blender.graphics.raster.rasterize import rasterize
from arm_blender.graphics.surface.isosurface import IsosurfaceConfig, extract
from arm_blender.models.network_views import network_views
from arm_blender.models.small.volume_georm import VolumeGeoRM
from arm_blender.structures import ViewSet
from arm_blender.views.rigs import zero123plus_rig
from arm_blender.weight_files import checkpoints

ISO = 10.0


def ball(p: Tensor) -> Tensor:
    return ISO + 50.0 * (0.7 - p.norm(dim=1))


def torus(p: Tensor) -> Tensor:
    return ISO + 50.0 * (0.2 - torch.hypot(p[:, :2].norm(dim=1) - 0.6, p[:, 2]))


def plate(p: Tensor) -> Tensor:
    """One cell thick at 97 samples a side."""
    return ISO + 50.0 * (0.01 - torch.maximum((p[:, 2] - 0.137).abs(), p[:, :2].abs().amax(dim=1) - 0.7))


def specks(p: Tensor) -> Tensor:
    """Twelve balls of about a cell, far from which all is alike; of slope 1."""
    centers = torch.rand(12, 3, generator=torch.Generator().manual_seed(4)) * 1.8 - 0.9
    return (0.07 - torch.cdist(p, centers).amin(dim=1)).clamp(min=-0.1)


def test_a_bound_on_the_slope_finds_what_no_corner_of_a_block_sees():
    config = IsosurfaceConfig(33, iso=0.0)
    dense = extract(specks, replace(config, dense=True))
    assert len(components(half_edges(dense.faces), len(dense.vertices)).unique()) == 12
    bound = extract(specks, replace(config, slope=1.0))
    assert torch.equal(bound.faces, dense.faces)
    torch.testing.assert_close(bound.vertices, dense.vertices, rtol=0.0, atol=1e-5)
    assert len(extract(specks, config).faces) < len(dense.faces)  # Without the bound some are missed.


@pytest.mark.parametrize("density", [ball, torus, plate])
def test_a_bound_on_the_slope_still_leaves_most_of_the_box_out(density):
    asked = []
    bound = extract(lambda p: asked.append(len(p)) or density(p), IsosurfaceConfig(97, slope=50.0))
    assert torch.equal(bound.faces, extract(density, IsosurfaceConfig(97, dense=True)).faces)
    assert sum(asked) < 0.4 * 97**3


def test_a_bound_keeps_blocks_where_the_density_is_no_number():
    def density(p: Tensor) -> Tensor:
        return torch.where(p[:, 0] > 0.3, torch.nan, 0.7 - p.norm(dim=1))

    config = IsosurfaceConfig(33, iso=0.0)
    bound, dense = (extract(density, replace(config, **words)) for words in ({"slope": 1.0}, {"dense": True}))
    assert torch.equal(bound.faces, dense.faces)


def test_the_samples_grow_with_the_surface():
    """About fourfold, not eightfold, for twice the resolution."""
    asked = []
    for resolution in (33, 65, 129):
        count = []
        extract(lambda p, count=count: count.append(len(p)) or torus(p), IsosurfaceConfig(resolution))
        asked.append(sum(count))
    assert all(b / a < 5.5 for a, b in zip(asked, asked[1:], strict=False))


SHAPES = {
    "ring": lambda: trimesh.creation.torus(0.6, 0.2),
    "thin plate": lambda: trimesh.creation.box((1.4, 0.05, 1.2)),
    "two balls": lambda: trimesh.util.concatenate(
        [
            trimesh.creation.icosphere(3, 0.4).apply_translation((-0.5, 0.0, 0.0)),
            trimesh.creation.icosphere(3, 0.25).apply_translation((0.5, 0.2, 0.3)),
        ]
    ),  # fmt: skip
}


@pytest.fixture(scope="module")
def georm() -> VolumeGeoRM:
    network, path = VolumeGeoRM(PRESETS["small"].georm), Settings().weights("georm")
    checkpoints.restore(network, checkpoints.load(path, type(network.config))[1], path)
    return network.eval()


@torch.no_grad()
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("views", [1, 6])
def test_the_sparse_surface_of_the_shipped_network_is_the_dense_one(georm, shape, views, monkeypatch):
    """To half a cell everywhere (Hausdorff), and to a thousandth of the faces."""
    for name, value in (("GRID", 24), ("SIDE", 60), ("STEPS", 33)):
        monkeypatch.setattr(silhouette_fill, name, value)
    solid, resolution = SHAPES[shape](), 40
    cameras = zero123plus_rig(distance=4.0, size=160)[:views]
    vertices, faces = torch.tensor(solid.vertices).float(), torch.tensor(solid.faces).long()
    masks = torch.stack([rasterize(vertices, faces, camera).mask for camera in cameras]).float()
    images = torch.cat([torch.full((views, 3, 160, 160), 0.4), masks[:, None]], dim=1)
    encoded = georm.encode(network_views(ViewSet(images, tuple(cameras), torch.ones(views), shape), georm.config))
    field, config = georm.filled_logit(encoded, 2**14), IsosurfaceConfig(resolution, iso=0.0, chunk=2**14)
    sparse, dense = extract(field, config), extract(field, replace(config, dense=True))
    assert len(sparse.faces) >= 0.999 * len(dense.faces) > 1000
    farthest = cKDTree(sparse.vertices.numpy()).query(dense.vertices.numpy())[0].max()
    assert farthest * (resolution - 1) / 2.0 < 0.5
