"""The views that a prior on shapes is learnt from belong to their points, and it learns from them."""

import numpy as np
import pytest
import torch
import trimesh

from arm_blender.graphics.visual_hull import Outlines, signed_silhouette_distance
from arm_blender.models.small.ray_occupancy import RayOccupancy, RayOccupancyConfig
from arm_blender.models.unet import UnetConfig
from arm_blender.structures import TriangleMesh
from arm_blender.weight_files import checkpoints
from training import __main__ as command
from training.datasets import one_view_samples, outline_samples
from training.datasets.one_view_samples import SIZE, OneViewBatch, Views, mirrored, seen
from training.stages.ray_occupancy import NAME, answer, held_out_views, validate

TINY = RayOccupancyConfig(size=32, unet=UnetConfig(widths=(8, 16, 16), out_channels=16, stem_stride=2), depths=24)
SHAPES = {
    "box": trimesh.creation.box((1.8, 1.0, 0.6)),
    "ball": trimesh.creation.icosphere(subdivisions=2, radius=0.9),
    "other": trimesh.creation.icosphere(subdivisions=1, radius=0.7),
}
HELD_OUT = "other"


def write(folder, name: str, mesh: trimesh.Trimesh) -> None:
    """A box or a ball with exact signs, and two grey pictures from 60 pixels a side."""
    place = folder / name
    place.mkdir(parents=True)
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (4000, 3))
    half = mesh.vertices.max(axis=0)
    ball = half[0] - np.linalg.norm(points, axis=1)
    distance = (half - np.abs(points)).min(axis=1) if name == "box" else ball
    np.savez(place / "mesh.npz", vertices=mesh.vertices.astype(np.float32), faces=mesh.faces.astype(np.int32))
    np.savez(place / "occupancy.npz", points=points.astype(np.float16), distance=distance.astype(np.float16))
    camera = one_view_samples.orbit_camera(0.0, 10.0, 6.0, 30.0, 60, 60)
    rgba = np.full((2, 60, 60, 4), (150, 150, 150, 255), np.uint8)
    depth = np.full((2, 60, 60), 5.5, np.float16)
    c2w, K = camera.c2w.expand(2, 4, 4).numpy(), camera.K.expand(2, 3, 3).numpy()
    np.savez(place / "rig_0.npz", rgba=rgba, depth=depth, c2w=c2w, K=K)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("shards")
    for name, mesh in SHAPES.items():
        write(place, name, mesh)
    return place


@pytest.fixture
def held_out(monkeypatch):
    monkeypatch.setattr(outline_samples, "is_held_out", lambda path: path.parent.name == HELD_OUT)


@pytest.fixture
def solids(folder, held_out):
    return outline_samples.load_solids(folder)


def batch(solids, count: int, points: int, seed: int = 0, favoured: frozenset[str] = frozenset()) -> OneViewBatch:
    return Views(solids, favoured, points, seed).batch(0, count)


def outlines(drawn) -> Outlines:
    return Outlines(drawn.views.silhouette, drawn.views.c2w, drawn.views.K)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_solid_lies_behind_the_silhouette(solids, seed):
    drawn = batch(solids, 3, 2000, seed)
    hull = outlines(drawn).hull_distance(drawn.points)
    pixel = float((outlines(drawn).range / drawn.views.K[..., 0, 0]).amax())
    assert bool((hull[drawn.distance > 0] > -1.5 * pixel).all())
    assert int((drawn.distance > 0).sum()) > 100 and bool((drawn.points.abs() <= 1.0).all())


def test_the_picture_shows_the_object_where_its_silhouette_is(solids):
    drawn = batch(solids, 4, 10)
    coverage = drawn.views.images[:, :, 3] > 0.5
    assert torch.equal(coverage, drawn.views.silhouette[:, :, 0] > 0.5) and 0.02 < float(coverage.float().mean()) < 0.6
    assert bool((drawn.views.images[:, :, :3].movedim(2, -1)[~coverage] == 1.0).all())  # White, as GeoRM's.


def test_what_a_mirror_shows_is_as_consistent(solids):
    """Images, cameras and points are mirrored together: a point is seen at the mirrored pixel."""
    drawn = batch(solids, 3, 500)
    other = mirrored(drawn)
    assert not torch.equal(other.views.c2w, drawn.views.c2w)
    plain, flipped = (outlines(b).project(b.points) for b in (drawn, other))
    torch.testing.assert_close(flipped.grid[..., 0], -plain.grid[..., 0], atol=1e-4, rtol=0.0)
    torch.testing.assert_close(flipped.grid[..., 1], plain.grid[..., 1], atol=1e-4, rtol=0.0)
    torch.testing.assert_close(outlines(other).hull_distance(other.points), outlines(drawn).hull_distance(drawn.points))
    for name in ("points", "first", "last"):
        torch.testing.assert_close(getattr(mirrored(other), name), getattr(drawn, name))


def test_views_come_back_as_they_were_and_a_step_is_a_function_of_its_number(solids, monkeypatch):
    monkeypatch.setattr(one_view_samples, "AGAIN", (1, 2))
    drawn, fresh = Views(solids, frozenset(), 50, 0), Views(solids, frozenset(), 50, 0)
    steps = [drawn.batch(step, 2) for step in range(4)]
    assert [len(step.points) for step in steps] == [2, 4, 6, 6]
    torch.testing.assert_close(mirrored(steps[3]).points[2:4], steps[2].points[:2])
    assert torch.equal(steps[3].views.images[4:], steps[1].views.images[:2])
    again = fresh.batch(3, 2)  # As after a resume.
    assert torch.equal(again.views.images, steps[3].views.images) and torch.equal(again.first, steps[3].first)
    assert not torch.equal(Views(solids, frozenset(), 50, 1).batch(3, 2).points, again.points)


def test_distances_to_the_outline_are_those_of_the_program(solids):
    silhouette = batch(solids, 2, 10, 1).views.silhouette
    for coverage, distance in silhouette[:, 0]:
        torch.testing.assert_close(distance, signed_silhouette_distance(coverage[None])[0], atol=1e-3, rtol=0.0)


def test_held_out_objects_are_seen_from_their_four_sides_at_full_size(folder, held_out):
    views = held_out_views(outline_samples.load_solids(folder, held_out=True))
    assert len(views) == 4
    for view in views:
        inside = view.points[0][view.distance[0] > 0]
        assert float((inside.amax(0) - inside.amin(0)).amax()) == pytest.approx(2.0, abs=0.2)
        assert view.views.images.shape == (1, 1, 4, SIZE, SIZE)


def test_favoured_objects_are_drawn_more_often(solids, monkeypatch):
    names, one = [], batch(solids, 1, 10)
    monkeypatch.setattr(one_view_samples, "seen", lambda solid, *rest: names.append(solid.name) or one)
    batch(solids, 60, 10, 0, frozenset({"ball"}))
    assert 0.55 < names.count("ball") / 60 < 0.85  # 0.7 is expected.


def test_a_network_learns_where_made_up_shapes_are(solids, one_thread):
    torch.manual_seed(0)
    model, drawn = RayOccupancy(TINY), batch(solids, 4, 1000)
    optimizer = torch.optim.AdamW(model.parameters(), 5e-3)
    before = validate(model.eval(), [drawn])
    for _ in range(40):
        loss = sum(answer(model, drawn)[1].values())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    after = validate(model.eval(), [drawn])
    assert all(after[name] < 0.7 * before[name] for name in ("occupancy", "first", "last"))
    assert after["iou"] > before["iou"] + 0.1


def test_the_stage_leaves_weights_that_the_program_loads(folder, held_out, tmp_path):
    output = tmp_path / f"{NAME}.safetensors"
    words = ["--shards", str(folder), "--output", str(output), "--steps", "1", "--batch", "1", "--points", "64"]
    assert command.main(["fit", "ray-occupancy", *words]) == 0
    config, state = checkpoints.load(output, RayOccupancyConfig)
    checkpoints.restore(RayOccupancy(config), state, output)
    assert output.stat().st_size < 8 * 2**20


@pytest.mark.parametrize("seed", range(3))
def test_rays_meet_a_ball_and_leave_it_at_its_surface(seed):
    ball = SHAPES["ball"]
    mesh = TriangleMesh(torch.tensor(ball.vertices).float(), torch.tensor(ball.faces).long())
    points = torch.zeros(10, 3)
    solid = outline_samples.Solid("ball", mesh, points, torch.ones(10), ((np.zeros((0, 3)), np.zeros((0, 3))),))
    draws = torch.Generator().manual_seed(seed)
    camera = one_view_samples._camera(draws)
    drawn = seen(solid, solid, camera, 10, draws)
    eye = camera.center
    for surface, sign in ((drawn.first[0], -1.0), (drawn.last[0], 1.0)):
        assert surface.shape == (one_view_samples.SURFACE_POINTS, 3)
        radius, toward = surface.norm(dim=1), torch.nn.functional.normalize(surface - eye, dim=1)
        assert 0.86 < float(radius.min()) and float(radius.max()) < 0.905  # Facets lie a little inside.
        along = (surface * toward).sum(dim=1)  # From the point of the ray that is nearest to the ball's centre.
        aside = (radius.square() - along.square()).clamp(min=0.0).sqrt()
        steep = aside < 0.7
        expected = sign * (0.9**2 - aside.square()).sqrt()
        assert int(steep.sum()) > 500 and float((along - expected)[steep].abs().max()) < 0.06
    same = torch.cosine_similarity(drawn.first[0] - eye, drawn.last[0] - eye, dim=1)
    assert float(same.min()) > 1.0 - 1e-6
