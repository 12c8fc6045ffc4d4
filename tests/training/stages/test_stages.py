"""Losses and the commands of GeoRM's and GlossyRM's stages, on a made-up sample."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.models.paper.georm import GeoRM
from arm_blender.models.paper.glossyrm import GlossyRM
from arm_blender.models.paper.reconstruction import SMALL, SMALL_TRIPLANE, EncodedViews, ReconstructionConfig
from arm_blender.weight_files import checkpoints
from training import __main__ as command
from training.datasets import outline_samples, point_samples
from training.stages.georm_occupancy import TEMPERATURE, intersection_over_union, occupancy_loss
from training.stages.view_side import VIEW_SIDE, EveryStep, Once


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
        finish = np.broadcast_to((mask * 100).astype(np.uint8), (10, size, size))
        np.savez(
            folder / "rig_0.npz",
            rgba=rgba,
            depth=np.broadcast_to(depth, (10, size, size)),
            roughness=finish,
            metallic=finish,
            c2w=torch.stack([c.c2w for c in cameras]).numpy(),
            K=torch.stack([c.K for c in cameras]).numpy(),
        )
    return tmp_path / "shards"


def test_a_fit_leaves_weights_that_the_next_stage_and_the_program_load(shards, tmp_path, capsys):
    words = ["--shards", str(shards), "--minutes", "0.01", "--batch", "1", "--points", "64"]
    georm, glossyrm = tmp_path / "georm.safetensors", tmp_path / "glossyrm.safetensors"
    assert command.main(["fit", "georm", "--output", str(georm), *words]) == 0
    assert command.main(["fit", "glossyrm-points", "--georm", str(georm), "--output", str(glossyrm), *words]) == 0
    for path, network in ((georm, GeoRM), (glossyrm, GlossyRM)):
        config, state = checkpoints.load(path, ReconstructionConfig)
        checkpoints.restore(network(config), state, path)


POINT_STAGES = ["georm-outlines", "georm", "glossyrm-points"]


@pytest.mark.parametrize("stage", POINT_STAGES)
def test_a_few_objects_none_of_them_held_out_are_enough(shards, tmp_path, monkeypatch, stage):
    for module in (point_samples, outline_samples):
        monkeypatch.setattr(module, "is_held_out", lambda path: False)
    words = ["--shards", str(shards), "--steps", "1", "--batch", "1", "--points", "64", "--log-every", "1"]
    assert command.main(["fit", stage, *words, "--output", str(tmp_path / "x.safetensors")]) == 0
    logged = (tmp_path / "runs" / "x" / "scalars.csv").read_text()
    assert ",mean,loss," in logged and "validation" not in logged


@pytest.mark.parametrize("stage", POINT_STAGES)
def test_objects_that_were_not_prepared_are_one_line_that_says_how(shards, tmp_path, capsys, stage):
    for path in shards.glob("*/occupancy.npz"):
        path.unlink()
    output = tmp_path / "x.safetensors"
    assert command.main(["fit", stage, "--shards", str(shards), "--steps", "1", "--output", str(output)]) == 1
    assert f"python -m training prepare --shards {shards}" in capsys.readouterr().err and not output.exists()


@pytest.mark.parametrize("stage", ["georm", "glossyrm-points"])
def test_looking_once_leaves_the_side_of_the_views_as_it_is(shards, tmp_path, stage):
    words = ["--shards", str(shards), "--batch", "2", "--points", "64", "--output"]
    first, second = tmp_path / "first.safetensors", tmp_path / "second.safetensors"
    assert command.main(["fit", stage, *words, str(first), "--minutes", "0.01"]) == 0
    assert (
        command.main(["fit", stage, *words, str(second), "--start", str(first), "--minutes", "0.02", "--look-once"])
        == 0
    )
    before, after = (checkpoints.load(path, ReconstructionConfig)[1] for path in (first, second))
    changed = {key.split(".")[1] for key, value in before.items() if not torch.equal(value, after[key])}
    assert {"volume", "reader", "decoder"} <= changed and not changed & set(VIEW_SIDE)


def test_features_found_once_are_those_found_at_every_step(shards):
    torch.manual_seed(0)
    network, path = GeoRM(SMALL).eval(), next(shards.glob("ball/rig_0.npz"))
    once, always = Once(network, point_samples.load_occupancy), EveryStep(point_samples.load_occupancy)
    points = torch.rand(1, 50, 3, generator=torch.Generator().manual_seed(0)) - 0.5
    found = [network.occupancy_logit(side.encode(network, side.load(path).views), points) for side in (once, always)]
    # Half precision in memory.
    torch.testing.assert_close(found[0], found[1], atol=2e-2, rtol=1e-2)


def test_what_is_frozen_stays_and_the_rest_learns(shards, tmp_path):
    words = ["--shards", str(shards), "--batch", "1", "--points", "64", "--bfloat16", "--output"]
    first, second = tmp_path / "first.safetensors", tmp_path / "second.safetensors"
    assert command.main(["fit", "georm", *words, str(first), "--minutes", "0.01"]) == 0
    more = ["--start", str(first), "--minutes", "0.02", "--freeze", "encoder", "transformer"]
    assert command.main(["fit", "georm", *words, str(second), *more]) == 0
    before, after = (checkpoints.load(path, ReconstructionConfig)[1] for path in (first, second))
    changed = {key.split(".")[1] for key, value in before.items() if not torch.equal(value, after[key])}
    assert {"volume", "coarse", "decoder", "reader"} <= changed and not changed & {"encoder", "transformer"}


def test_outlines_teach_the_fields_side_and_leave_image_features_without_a_say(shards, tmp_path):
    words = ["--shards", str(shards), "--batch", "2", "--points", "256", "--output"]
    first, second = tmp_path / "first.safetensors", tmp_path / "second.safetensors"
    assert command.main(["fit", "georm", *words, str(first), "--minutes", "0.01"]) == 0
    assert command.main(["fit", "georm-outlines", *words, str(second), "--start", str(first), "--minutes", "0.03"]) == 0
    before, (config, after) = (checkpoints.load(path, ReconstructionConfig) for path in (first, second))
    changed = {key.split(".")[1] for key, value in before[1].items() if not torch.equal(value, after[key])}
    assert changed == {"volume", "coarse", "detail", "detail_vote", "reader", "decoder", "pyramid"}
    # Of the pyramid only the depth head, which is silenced.
    pyramid = {key for key, value in before[1].items() if ".pyramid." in key and not torch.equal(value, after[key])}
    assert all(".to_depth." in key for key in pyramid)
    assert not has_a_say(shards, config, after)


def test_fitting_without_features_leaves_them_without_a_say(shards, tmp_path):
    words = ["--shards", str(shards), "--batch", "2", "--points", "256", "--minutes", "0.02", "--output"]
    seeing, blind = tmp_path / "seeing.safetensors", tmp_path / "blind.safetensors"
    assert command.main(["fit", "georm", *words, str(seeing), "--look-once"]) == 0
    assert command.main(["fit", "georm", *words, str(blind), "--start", str(seeing), "--no-features"]) == 0
    assert has_a_say(shards, *checkpoints.load(seeing, ReconstructionConfig))
    assert not has_a_say(shards, *checkpoints.load(blind, ReconstructionConfig))


@torch.no_grad()
def has_a_say(shards, config: ReconstructionConfig, weights: dict) -> bool:
    """Whether image features or planes change the density."""
    network = GeoRM(config).eval()
    checkpoints.restore(network, weights, shards)
    views = point_samples.expanded(point_samples.load_occupancy(next(shards.glob("ball/rig_0.npz"))).views)
    encoded = network.encode(views)
    other = replace(encoded.views, maps=torch.randn_like(encoded.views.maps))
    volume = network.model.volume(other)
    changed = EncodedViews(torch.randn_like(encoded.planes), other, volume, network.model.refined(other, volume))
    points = torch.rand(1, 50, 3) - 0.5
    return not torch.equal(network.occupancy_logit(encoded, points), network.occupancy_logit(changed, points))


def test_triplanes_alone_are_fitted_from_pictures_and_loaded_as_such(shards, tmp_path, capsys):
    words = ["--shards", str(shards), "--batch", "1", "--points", "64", "--no-pixel-aligned"]
    first = tmp_path / "first.safetensors"
    assert command.main(["fit", "georm", *words, "--steps", "2", "--log-every", "1", "--output", str(first)]) == 0
    config, state = checkpoints.load(first, ReconstructionConfig)
    assert config == SMALL_TRIPLANE and not any("volume" in key or "pyramid" in key for key in state)
    network = GeoRM(config)
    checkpoints.restore(network, state, first)
    views = point_samples.expanded(point_samples.load_occupancy(next(shards.glob("ball/rig_0.npz"))).views)
    repainted = replace(views, images=1.0 - views.images)
    points = torch.rand(1, 50, 3) - 0.5
    with torch.no_grad():
        found = [network.occupancy_logit(network.encode(each), points) for each in (views, repainted)]
    assert not torch.equal(*found)
    logged = (tmp_path / "runs" / "first" / "scalars.csv").read_text()
    assert ",mean,occupancy," in logged and "depth" not in logged and ",validation,iou," in logged
    assert command.main(["fit", "georm", *words, "--output", str(first), "--no-features"]) == 1
    assert "need what it leaves out" in capsys.readouterr().err


def test_outlines_keep_the_volume_learning_beside_the_pictures(shards, tmp_path, caplog):
    words = ["--shards", str(shards), "--batch", "1", "--points", "64", "--minutes", "0.02", "--outlines", "1"]
    with caplog.at_level("INFO"):
        assert command.main(["fit", "georm", *words, "--output", str(tmp_path / "x.safetensors")]) == 0
    assert "1 solids" in caplog.text


def test_freezing_an_unknown_part_names_those_there_are(shards, tmp_path, capsys):
    words = ["fit", "georm", "--shards", str(shards), "--output", str(tmp_path / "x.safetensors")]
    assert command.main([*words, "--freeze", "hull"]) == 1
    assert "--freeze hull: unknown; choose among encoder" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["prepare"], ["fit", "georm", "--output", "x.safetensors"]], ids=" ".join)
def test_no_samples_is_one_line_with_the_remedy(tmp_path, capsys, words):
    assert command.main([*words, "--shards", str(tmp_path)]) == 1
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert str(tmp_path) in line and "python -m training render" in line
