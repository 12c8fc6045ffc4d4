"""A network's shape is moved to meet the rig's views, as the program does."""

import pytest
import torch

from arm_blender.graphics.surface.isosurface import extract
from arm_blender.graphics.surface.sample_grid import IsosurfaceConfig
from training.datasets.gloss_samples import Shapes
from training.rendering import shards


@pytest.fixture
def shapes(tmp_path, monkeypatch) -> Shapes:
    """What a network that makes everything a tenth too small says of the ball "one"."""
    true = float(shards.read_mesh(tmp_path / "shards" / "one" / "mesh.npz").vertices.norm(dim=1).mean())
    made = Shapes.__new__(Shapes)
    made.folder, made._mark = tmp_path / "shapes", "wrong"
    ball = extract(lambda points: 20.0 * (0.9 * true - points.norm(dim=1)), IsosurfaceConfig(32, iso=0.0))
    monkeypatch.setattr(Shapes, "mesh", lambda self, path: ball)
    return made


def test_it_meets_the_views_and_is_kept(ball_shards, shapes):
    path = ball_shards / "one" / "rig_0.npz"
    true = float(shards.read_mesh(path.with_name("mesh.npz")).vertices.norm(dim=1).mean())
    mesh = shapes.refined(path, 500)
    assert len(mesh.faces) <= 500
    assert float(mesh.vertices.norm(dim=1).mean()) == pytest.approx(true, rel=0.03)
    again = shapes.refined(path, 500)
    assert torch.equal(again.vertices, mesh.vertices) and torch.equal(again.faces, mesh.faces)
    assert len(list(shapes.folder.iterdir())) == 1
