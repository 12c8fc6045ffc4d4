"""What the stages load from tar shards is what they load from folders of the same arrays."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.raster.rasterize import interpolate, rasterize
from arm_blender.models.paper.georm import GeoRM
from arm_blender.models.paper.reconstruction import PAPER
from arm_blender.structures import TriangleMesh, UvMesh
from arm_blender.uv.unwrap import UnwrapConfig
from arm_blender.weight_files import checkpoints
from training.datasets import atlases, outline_samples, point_samples, view_samples
from training.datasets.gloss_samples import Shapes
from training.rendering import shard_writer, shards

SIZE = 24


def ball_rig(vertices: torch.Tensor, faces: torch.Tensor) -> dict[str, np.ndarray]:
    """Eight views of a ball, in noise of known seed."""
    cameras = [orbit_camera(45.0 * i, (20.0, -10.0)[i % 2], 4.0, 30.0, SIZE, SIZE) for i in range(8)]
    fragments = [rasterize(vertices, faces, camera) for camera in cameras]
    mask = torch.stack([f.face_id >= 0 for f in fragments]).numpy()
    normal = torch.stack([interpolate(vertices, faces, f).permute(1, 2, 0) for f in fragments]).numpy()
    noise = np.random.default_rng(0).integers(0, 255, (8, SIZE, SIZE, 8), np.uint8)
    return {
        "rgba": np.concatenate([noise[..., :3], (mask * 255).astype(np.uint8)[..., None]], axis=-1),
        "albedo": noise[..., 3:6],
        "roughness": noise[..., 6],
        "metallic": noise[..., 7],
        "depth": np.where(mask, torch.stack([f.depth for f in fragments]).numpy(), np.inf).astype(np.float16),
        "normal": (np.clip(normal, -1.0, 1.0) * 127.0).astype(np.int8),
        "c2w": torch.stack([c.c2w for c in cameras]).numpy(),
        "K": torch.stack([c.K for c in cameras]).numpy(),
    }


@pytest.fixture
def both(tmp_path, monkeypatch) -> tuple[Path, Path]:
    """A folder of files and one of shards, with distances beside."""
    for module in (point_samples, outline_samples):
        monkeypatch.setattr(module, "is_held_out", lambda path: path.parent.name == "other")
    ball = trimesh.creation.icosphere(subdivisions=2)
    mesh = {"vertices": (0.8 * ball.vertices).astype(np.float32), "faces": ball.faces.astype(np.int32)}
    rig = ball_rig(torch.from_numpy(mesh["vertices"]), torch.from_numpy(mesh["faces"]).long())
    points = np.random.default_rng(0).uniform(-1, 1, (2000, 3)).astype(np.float16)
    occupancy = {"points": points, "distance": (0.8 - np.linalg.norm(points, axis=1)).astype(np.float16)}
    folder, packed = tmp_path / "folder", tmp_path / "packed"
    files = {"mesh.npz": mesh, "rig_0.npz": rig, "rig_1.npz": rig}
    with shard_writer.writing(packed, {}):
        for key in ("ball", "other"):
            shard_writer.save_part(packed, {"key": key, "source": key, "dropped": None}, files, {})
        shard_writer.pack(packed, ["ball", "other"])
    for key in ("ball", "other"):
        for name, arrays in files.items():
            shards.save_arrays(folder / key / name, arrays)
        for place in (folder, packed):
            shards.save_arrays(place / key / "occupancy.npz", occupancy)
    return folder, packed


def assert_same(one: object, other: object) -> None:
    """Equal in every tensor, array and number, however deep."""
    assert type(one) is type(other)
    if dataclasses.is_dataclass(one):
        for field in dataclasses.fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, list | tuple):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    elif isinstance(one, torch.Tensor | np.ndarray):
        assert torch.equal(torch.as_tensor(one), torch.as_tensor(other))
    else:
        assert one == other


def test_points(both):
    one, other = ([point_samples.load_occupancy(path) for path in shards.rigs(place)] for place in both)
    assert len(one) == 4
    assert_same(one, other)


def test_views(both):
    one, other = ([view_samples.load(path, PAPER) for path in shards.rigs(place)] for place in both)
    assert len(one) == 4 and float(one[0].truth.mask.mean()) > 0.1
    assert_same(one, other)


def test_finish_on_shapes_of_a_network(both, plane_network, tmp_path):
    weights = tmp_path / "georm.safetensors"
    torch.manual_seed(0)
    checkpoints.save(weights, GeoRM(plane_network).state_dict(), plane_network, "georm")
    shapes = Shapes(weights, 16, torch.device("cpu"))
    one, other = ([shapes.load(path, plane_network) for path in shards.rigs(place)[:2]] for place in both)
    assert one[0].gloss.shape == (8, 2, SIZE, SIZE)
    assert_same(one, other)


def test_outlines_and_what_validates(both):
    one, other = (outline_samples.load_solids(place) for place in both)
    assert len(one) == 1 and len(one[0].clouds) == 2
    assert_same(one, other)
    held_out = [point_samples.load_held_out(place) for place in both]
    assert len(held_out[0]) == 2
    assert_same(*held_out)


def test_atlases(both, tmp_path, monkeypatch):
    def seen_from_above(mesh: TriangleMesh, config: UnwrapConfig) -> tuple[UvMesh]:  # Faster than an unwrapping.
        uvs = 0.5 + 0.5 * mesh.vertices[:, :2]
        return (UvMesh(mesh.vertices, mesh.faces, uvs, mesh.faces, charts=1),)

    monkeypatch.setattr(atlases, "unwrap", seen_from_above)
    monkeypatch.setattr(atlases, "rigs", lambda place: shards.rigs(place)[:1])
    config = atlases.AtlasConfig(size=16, subsets=1)
    for place in both:
        assert atlases.prepare(place, tmp_path / f"{place.name}_cache", config) == 1
    one, other = ([atlases.load(p, 0) for p in atlases.files(tmp_path / f"{b.name}_cache")] for b in both)
    assert_same(one, other)
