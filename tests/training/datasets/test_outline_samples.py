"""Outlines drawn from meshes belong to the points that say what is solid, however the object is stretched and seen."""

import numpy as np
import pytest
import torch
import trimesh

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.raster.rasterize import interpolate, rasterize_views
from training.datasets import outline_samples

SIZE = 96
HALF = np.array([0.9, 0.5, 0.3], np.float32)
"""Half extents of the box that is learnt from."""


@pytest.fixture(autouse=True)
def all_views(monkeypatch):
    """What is said of hulls here is said of six views."""
    monkeypatch.setattr(outline_samples, "drop_views", lambda *_: torch.arange(6))


def write_rig(path, mesh: trimesh.Trimesh) -> None:
    """Six pictures in which every point of the surface has its place for a colour."""
    cameras = [orbit_camera(60.0 * i, (30.0, -30.0)[i % 2], 4.0, 40.0, SIZE, SIZE) for i in range(6)]
    vertices, faces = torch.tensor(np.asarray(mesh.vertices), dtype=torch.float32), torch.tensor(mesh.faces.copy())
    fragments = rasterize_views(vertices, faces, cameras)
    place = torch.stack([interpolate(vertices, faces, fragments[i]) for i in range(6)])
    rgba = torch.cat([(0.5 + 0.5 * place).clamp(0.0, 1.0), fragments.mask[:, None].float()], dim=1)
    np.savez(
        path,
        rgba=(rgba * 255.0).round().byte().permute(0, 2, 3, 1).numpy(),
        depth=fragments.depth.half().numpy(),
        c2w=torch.stack([c.c2w for c in cameras]).numpy(),
        K=torch.stack([c.K for c in cameras]).numpy(),
    )


@pytest.fixture(scope="module")
def solids(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shards") / "box"
    folder.mkdir()
    box = trimesh.creation.box(2.0 * HALF)
    np.savez(folder / "mesh.npz", vertices=box.vertices.astype(np.float32), faces=box.faces.astype(np.int32))
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (6000, 3)).astype(np.float32)
    inside = (HALF - np.abs(points)).min(axis=1)  # Exact inside; outside of a corner a lower bound, with its sign.
    np.savez(folder / "occupancy.npz", points=points.astype(np.float16), distance=inside.astype(np.float16))
    write_rig(folder / "rig_0.npz", box)
    return outline_samples.load_solids(folder.parent)


@pytest.mark.parametrize("seed", range(5))
def test_what_is_solid_lies_in_the_hull_and_most_of_the_hull_is_solid(solids, seed):
    batch = outline_samples.batch(solids, 2, 3000, torch.Generator().manual_seed(seed))
    hull = batch.outlines.hull_distance(batch.points)
    pixel = outline_samples.FRAME / min(outline_samples.SIZES)
    assert bool((hull[batch.distance > 0] > -pixel).all())
    assert float((batch.distance[hull > 0] > 0).float().mean()) > 0.5
    assert bool((batch.points.abs() <= 1.0).all())


def test_views_are_dropped_with_their_colours(solids, monkeypatch):
    whole = outline_samples.batch(solids, 1, 100, torch.Generator().manual_seed(0))
    monkeypatch.setattr(outline_samples, "drop_views", lambda *_: torch.tensor([1, 4]))
    some = outline_samples.batch(solids, 1, 100, torch.Generator().manual_seed(0))
    assert torch.equal(some.outlines.c2w, whole.outlines.c2w[:, [1, 4]])
    assert torch.equal(some.outlines.silhouette, whole.outlines.silhouette[:, [1, 4]])
    assert torch.equal(some.colors, whole.colors[:, [1, 4]])


def test_clouds_are_points_of_the_surface_with_their_colours(solids):
    ((points, colors),) = solids[0].clouds
    assert len(points) == len(colors) > 1000
    assert float(np.abs((HALF - np.abs(points)).min(axis=1)).max()) < 0.01
    assert float(np.abs(colors / 255.0 - (0.5 + 0.5 * points)).max()) < 0.01


@pytest.mark.parametrize("seed", range(3))
def test_a_stretched_object_keeps_its_colours(solids, monkeypatch, seed):
    """Where two views show the same point, they show the same colour; and the colours are the mesh's own."""
    monkeypatch.setattr(torch.Tensor, "uniform_", lambda self, *_, **__: self.fill_(1.0))
    batch = outline_samples.batch(solids, 1, 3000, torch.Generator().manual_seed(seed))
    shown = batch.colors[0]
    assert shown.shape == (6, 4, outline_samples.COLORED, outline_samples.COLORED)
    full = shown[:, 3] > 0.99
    values = (shown[:, :3] + 0.5).movedim(1, -1)[full]
    # A point of the box lies on one of its six sides: one channel is at that side's value.
    sides = torch.tensor([0.5 + 0.5 * sign * half for half in HALF.tolist() for sign in (-1.0, 1.0)])
    off = (values[..., None] - sides).abs().amin(dim=-1).amin(dim=-1)
    assert int(full.sum()) > 50 and float(off.median()) < 0.01
    assert bool((shown[:, :3][(shown[:, 3:] == 0.0).expand(-1, 3, -1, -1)] == 0.0).all())


def test_objects_are_stretched_and_turned_and_mostly_seen_by_the_rig_of_users(solids):
    generator = torch.Generator().manual_seed(0)
    batch = outline_samples.batch(solids, 24, 2000, generator)
    extents = torch.stack(
        [p[d > 0].amax(0) - p[d > 0].amin(0) for p, d in zip(batch.points, batch.distance, strict=True)]
    )
    assert len({tuple(e) for e in extents.tolist()}) == 24
    eyes = batch.outlines.c2w[:, 0, :3, 3]
    same = (eyes - eyes.median(dim=0).values).norm(dim=1) < 1e-3
    assert 12 <= int(same.sum()) < 24


def test_the_longest_side_of_a_stretched_object_fits_the_box(solids):
    generator = torch.Generator().manual_seed(1)
    for _ in range(20):
        vertices = outline_samples._moved(solids[0], generator).mesh.vertices
        low, high = vertices.amin(0), vertices.amax(0)
        assert 1.6 - 1e-4 <= float((high - low).amax()) <= 2.0 + 1e-4
        torch.testing.assert_close(low, -high)


def test_held_out_objects_and_those_of_too_many_faces_are_left_out(tmp_path, monkeypatch):
    for name in ("held", "heavy", "plain"):
        folder = tmp_path / name
        folder.mkdir()
        ball = trimesh.creation.icosphere(subdivisions=3 if name == "heavy" else 1)
        np.savez(folder / "mesh.npz", vertices=ball.vertices.astype(np.float32), faces=ball.faces.astype(np.int32))
        np.savez(folder / "occupancy.npz", points=np.zeros((500, 3), np.float16), distance=np.ones(500, np.float16))
        write_rig(folder / "rig_0.npz", ball)
    monkeypatch.setattr(outline_samples, "is_held_out", lambda path: path.parent.name == "held")
    monkeypatch.setattr(outline_samples, "MOST_FACES", 200)
    assert [len(s.mesh.faces) for s in outline_samples.load_solids(tmp_path)] == [80]
