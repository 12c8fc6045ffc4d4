"""Losses and the commands of the stages that learn at points, on a made-up sample."""

import math

import numpy as np
import pytest
import torch
import trimesh

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.networks import read
from training import __main__ as command
from training.datasets import outline_samples, point_samples
from training.stages.occupancy_loss import TEMPERATURE, intersection_over_union, occupancy_loss


def test_the_occupancy_loss_is_least_where_the_logit_is_the_distance():
    distance = torch.linspace(-0.1, 0.1, 50)[None]
    logit = (distance / TEMPERATURE).clone().requires_grad_()
    occupancy_loss(logit, distance, torch.zeros(1, 50)).backward()
    assert float(logit.grad.abs().max()) < 1e-7
    best = occupancy_loss(logit.detach(), distance, torch.zeros(1, 50))
    plain = logit.detach()
    for wrong in (0.5 * plain, plain + 0.3, -plain):
        assert float(occupancy_loss(wrong, distance, torch.zeros(1, 50))) > float(best)


def test_undecided_points_in_the_hull_weigh_more():
    distance, logit = torch.tensor([[-0.2, -0.2]]), torch.tensor([[3.0, -9.0]])
    inside_hull = occupancy_loss(logit, distance, torch.tensor([[0.1, -0.1]]))
    outside_hull = occupancy_loss(logit, distance, torch.tensor([[-0.1, -0.1]]))
    assert float(inside_hull) > 1.3 * float(outside_hull)


def test_intersection_over_union_of_known_sets():
    a, b = torch.tensor([True, True, False, False]), torch.tensor([True, False, True, False])
    assert intersection_over_union(a, b) == pytest.approx(1.0 / 3.0)
    assert intersection_over_union(a, a) == 1.0


@pytest.fixture
def shards(tmp_path, monkeypatch):
    """Two balls as the renderer would leave them, one of them held out."""
    names = ["ball", "other"]
    monkeypatch.setattr(point_samples, "is_held_out", lambda path: path.parent.name == "other")
    size, radius = 32, 0.6
    cameras = [orbit_camera(30 + 60 * i, (20, -10)[i % 2], 4.0, 30, size, size) for i in range(10)]
    disc = float(cameras[0].K[0, 0]) * math.tan(math.asin(radius / 4.0))
    centers = np.arange(size) + 0.5 - size / 2
    mask = centers[:, None] ** 2 + centers[None] ** 2 < disc**2
    rgba = np.zeros((10, size, size, 4), np.uint8)
    rgba[..., :3], rgba[..., 3] = 150, mask * 255
    depth = np.where(mask, 3.5, np.inf).astype(np.float16)
    points = np.random.default_rng(0).uniform(-1, 1, (3000, 3)).astype(np.float16)
    ball = trimesh.creation.icosphere(subdivisions=2)
    for name in names:
        folder = tmp_path / "shards" / name
        folder.mkdir(parents=True)
        np.savez(folder / "mesh.npz", vertices=radius * ball.vertices.astype(np.float32), faces=ball.faces)
        np.savez(folder / "occupancy.npz", points=points, distance=radius - np.linalg.norm(points, axis=1))
        np.savez(
            folder / "rig_0.npz",
            rgba=rgba,
            depth=np.broadcast_to(depth, (10, size, size)),
            c2w=torch.stack([c.c2w for c in cameras]).numpy(),
            K=torch.stack([c.K for c in cameras]).numpy(),
        )
    return tmp_path / "shards"


def test_a_fit_leaves_weights_that_the_next_and_the_program_load(shards, tmp_path, caplog):
    words = ["--shards", str(shards), "--batch", "1", "--points", "64", "--steps", "1", "--log-every", "1", "--output"]
    first, second = tmp_path / "first.safetensors", tmp_path / "second.safetensors"
    with caplog.at_level("INFO"):
        assert command.main(["fit", "georm-outlines", *words, str(first)]) == 0
        assert command.main(["fit", "georm-outlines", *words, str(second), "--start", str(first)]) == 0
    assert "1 solids" in caplog.text
    networks = [read("georm", path) for path in (first, second)]
    before, after = (network.state_dict() for network in networks)
    changed = {key.split(".")[0] for key, value in before.items() if not torch.equal(value, after[key])}
    assert changed == set(dict(networks[0].named_children()))
    logged = (tmp_path / "runs" / "second" / "scalars.csv").read_text()
    assert all(f",mean,{name}," in logged for name in ("occupancy", "coarse")) and ",validation,iou," in logged


def test_a_few_objects_none_of_them_held_out_are_enough(shards, tmp_path, monkeypatch):
    for module in (point_samples, outline_samples):
        monkeypatch.setattr(module, "is_held_out", lambda path: False)
    words = ["--shards", str(shards), "--steps", "1", "--batch", "1", "--points", "64", "--log-every", "1"]
    assert command.main(["fit", "georm-outlines", *words, "--output", str(tmp_path / "x.safetensors")]) == 0
    logged = (tmp_path / "runs" / "x" / "scalars.csv").read_text()
    assert ",mean,loss," in logged and "validation" not in logged


@pytest.mark.parametrize("stage", ["georm-outlines", "ray-occupancy"])
def test_objects_that_were_not_prepared_are_one_line_that_says_how(shards, tmp_path, capsys, stage):
    for path in shards.glob("*/occupancy.npz"):
        path.unlink()
    output = tmp_path / "x.safetensors"
    assert command.main(["fit", stage, "--shards", str(shards), "--steps", "1", "--output", str(output)]) == 1
    assert f"python -m training prepare --shards {shards}" in capsys.readouterr().err and not output.exists()


@pytest.mark.parametrize("words", [["prepare"], ["fit", "georm-outlines", "--output", "x.safetensors"]], ids=" ".join)
def test_no_samples_is_one_line_with_the_remedy(tmp_path, capsys, words):
    assert command.main([*words, "--shards", str(tmp_path)]) == 1
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert str(tmp_path) in line and "python -m training render" in line
