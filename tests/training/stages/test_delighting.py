"""Delighting: its samples and their augmentation in closed form, and the stage, whose loss falls."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.nn import functional

from arm_blender.graphics.light.spherical_harmonics import COUNT, WHITE, gathered
from arm_blender.models.small.delighting import REFLECTED, Delighting, DelightingConfig, SeenPoints
from arm_blender.models.small.instant_albedo import SMALL as SMALL_ALBEDO
from arm_blender.models.small.volume_georm import VolumeGeoRM, VolumeGeoRMConfig
from arm_blender.weight_files import checkpoints
from training import __main__ as command
from training.datasets import delighting_samples
from training.datasets.delighting_augmentation import (
    EXPOSURE,
    augmented,
    exposed,
    fewer_views,
    fitted_light,
    random_light,
    relit,
    repainted,
)
from training.datasets.delighting_samples import DelightingSample, carried
from training.rasterized.pictures import Library
from training.rendering import shards
from training.stages.delighting import delighting_loss, validate
from training.stages.instant_albedo_start import Start

pytestmark = pytest.mark.usefixtures("one_thread")

NOTHING_STORED = Library([], [])
TINY = DelightingConfig(width=32, view_width=8, tokens=8, heads=2, depth=1)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def slanted_light(seed: int = 0, strength: float = 0.4) -> torch.Tensor:
    """(9, 3): white from everywhere, and more of a tint from one side."""
    light = torch.zeros(COUNT, 3)
    light[0] = WHITE * 0.8
    light[1:4] = strength * torch.randn(3, 3, generator=generator(seed))
    return light


def painted_ball(light: torch.Tensor, seed: int = 0, count: int = 500, colors: int = 2) -> DelightingSample:
    """A ball of a few dull colours, seen by six views that all see all of it."""
    random = generator(seed)
    normal = functional.normalize(torch.randn(1, count, 3, generator=random), dim=-1)
    palette = 0.05 + 0.6 * torch.rand(colors, 3, generator=random)
    albedo = palette[(normal[0] @ torch.randn(3, generator=random) > 0.0).long() % colors][None]
    sent = (albedo + REFLECTED) * (gathered(normal) @ light).clamp(min=0.0)
    eyes = 6.0 * functional.normalize(torch.randn(1, 6, 3, generator=random), dim=-1)
    points = SeenPoints(
        0.9 * normal, normal, sent[:, None].expand(1, 6, count, 3), torch.ones(1, 6, count, dtype=torch.bool), eyes
    )
    return DelightingSample("ball", points, albedo)


def test_the_light_of_a_sample_is_found_again():
    light = slanted_light()
    torch.testing.assert_close(fitted_light(painted_ball(light)), light, atol=0.02, rtol=0.02)


def test_relit_is_as_if_seen_under_that_light():
    old, new = slanted_light(0), slanted_light(1)
    found = relit(painted_ball(old), old, new)
    torch.testing.assert_close(found.points.color, painted_ball(new).points.color, atol=1e-4, rtol=1e-3)


@pytest.mark.parametrize("seed", range(6))
def test_repainted_is_as_if_seen_in_that_paint(seed):
    light = slanted_light(strength=0.1)
    before = painted_ball(light)
    after = repainted(before, light, generator(seed))
    assert not torch.allclose(after.albedo, before.albedo, atol=1e-3)
    assert float(after.albedo.min()) > 0.0 and float(after.albedo.max()) < 1.0
    sent = (after.albedo + REFLECTED) * (gathered(before.points.normal) @ light)
    torch.testing.assert_close(after.points.color[:, 0], sent.clamp(1e-4, 1.0), atol=1e-4, rtol=1e-3)


def test_some_paints_are_black_and_some_are_not():
    light = slanted_light()
    levels = torch.tensor([float(repainted(painted_ball(light), light, generator(k)).albedo.mean()) for k in range(40)])
    assert float(levels.min()) < 0.05 and float(levels.max()) > 0.35


def test_every_sample_is_brought_to_the_same_exposure():
    dim, bright = (exposed(painted_ball(k * slanted_light())) for k in (0.8, 1.4))
    torch.testing.assert_close(dim.points.color, bright.points.color, atol=0.01, rtol=0.02)
    assert float(fitted_light(dim)[0].mean()) == pytest.approx(EXPOSURE * WHITE, rel=0.02)


def test_random_lights_are_of_the_usual_exposure():
    lights = torch.stack([random_light(NOTHING_STORED, generator(k)) for k in range(20)])
    luminance = lights[:, 0] @ torch.tensor([0.2126, 0.7152, 0.0722]) / WHITE
    assert float(luminance.log().mean()) == pytest.approx(math.log(EXPOSURE), abs=0.1)
    assert 0.03 < float(luminance.log().std()) < 0.2


def test_some_views_are_dropped_but_never_all():
    points = painted_ball(slanted_light()).points
    counts = {int(fewer_views(points, generator(k)).visible.any(dim=2).sum()) for k in range(60)}
    assert 1 in counts and 6 in counts and 0 not in counts and len(counts) > 3


def test_augmentation_turns_cameras_and_surface_alike():
    sample = painted_ball(slanted_light())
    found = augmented(sample, fitted_light(sample), 100, NOTHING_STORED, generator(3))
    assert found.albedo.shape == (1, 100, 3)
    torch.testing.assert_close(found.points.normal, found.points.position / 0.9, atol=1e-5, rtol=0.0)
    torch.testing.assert_close(found.points.eyes.norm(dim=-1), torch.full((1, 6), 6.0))
    torch.testing.assert_close(found.points.eyes[..., 2], sample.points.eyes[..., 2])


def test_the_loss_falls_and_light_that_was_never_seen_is_divided_out():
    torch.manual_seed(0)
    model = Delighting(TINY)
    optimizer = torch.optim.Adam(model.parameters(), lr=3e-3)
    before = validate(model, [painted_ball(slanted_light(k), k) for k in range(500, 510)])
    for step in range(150):
        batch = [painted_ball(slanted_light(8 * step + k), 8 * step + k, 100) for k in range(8)]
        loss, _ = delighting_loss(model, batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    after = validate(model, [painted_ball(slanted_light(k), k) for k in range(500, 510)])
    assert after["blend"] == before["blend"]
    assert after["error"] < 0.75 * before["error"] and after["by light"] < before["by light"]


def test_colours_are_carried_from_the_views_that_see_them(ball_shards):
    path = ball_shards / "one" / "rig_0.npz"
    rig = shards.arrays(path, "rgba", "c2w", "K") | {"albedo": np.full((10, 48, 48, 3), 188, np.uint8)}
    points, albedo = carried(shards.read_mesh(path.with_name("mesh.npz")), rig, generator())
    assert 256 < albedo.shape[1] <= delighting_samples.POINTS
    torch.testing.assert_close(points.normal, functional.normalize(points.position, dim=-1), atol=0.05, rtol=0.0)
    cosine = (points.towards() * points.normal[:, None]).sum(dim=-1)
    assert float(cosine[points.visible].min()) > 0.0 and bool(points.visible.any(dim=1).all())
    torch.testing.assert_close(albedo, torch.full_like(albedo, ((188 / 255 + 0.055) / 1.055) ** 2.4))
    torch.testing.assert_close(points.blended(), torch.full_like(albedo, ((150 / 255 + 0.055) / 1.055) ** 2.4))


@pytest.fixture
def georm(tmp_path):
    """Weights of a GeoRM that has learnt nothing: its shape is the visual hull."""
    torch.manual_seed(0)
    path = tmp_path / "georm.safetensors"
    checkpoints.save(path, VolumeGeoRM(VolumeGeoRMConfig()).state_dict(), VolumeGeoRMConfig(), "small.georm")
    return path


def test_the_command_leaves_weights_that_instant_albedo_takes_in(ball_shards, georm, tmp_path, monkeypatch):
    for path in shards.rigs(ball_shards):
        shards.save_arrays(path, shards.arrays(path) | {"albedo": np.full((10, 48, 48, 3), 120, np.uint8)})
    output, cache = tmp_path / "delighting.safetensors", tmp_path / "cache"
    words = ["--cache", str(cache), "--steps", "2", "--batch", "2", "--points", "64", "--output", str(output)]
    new = ["--shards", str(ball_shards), "--georm", str(georm), "--grid", "24", "--copies", "1"]
    assert command.main(["fit", "delighting", *words, *new]) == 0
    assert len(list(cache.glob("*.npz"))) == 2 * len(shards.rigs(ball_shards))
    header = checkpoints.read_header(output)
    assert header["name"] == "delighting" and header["steps"] == "2"
    model = Start(SMALL_ALBEDO, delighting=output).network()
    for key, value in checkpoints.load(output, DelightingConfig)[1].items():
        assert torch.equal(model.delighting.state_dict()[key], value)
    assert not any(parameter.requires_grad for parameter in model.delighting.parameters())


def test_no_samples_are_one_line_that_says_how(tmp_path, capsys):
    words = ["--cache", str(tmp_path / "none"), "--output", str(tmp_path / "x.safetensors")]
    assert command.main(["fit", "delighting", *words]) == 1
    assert "give --shards" in capsys.readouterr().err


def test_samples_come_back_as_they_were(tmp_path):
    sample = painted_ball(slanted_light())
    visible = sample.points.visible & (torch.rand(1, 6, 500, generator=generator()) > 0.5)
    sample = replace(sample, points=replace(sample.points, visible=visible, color=sample.points.color.clamp(0.0, 1.0)))
    delighting_samples.save(tmp_path / "ball.rig_0.0.npz", sample.points, sample.albedo)
    (found,) = delighting_samples.samples(tmp_path)
    assert found.name == "ball" and torch.equal(found.points.visible, visible)
    torch.testing.assert_close(found.points.color, sample.points.color, atol=0.01, rtol=0.0)
    torch.testing.assert_close(found.albedo, sample.albedo, atol=0.01, rtol=0.0)
    torch.testing.assert_close(found.points.position, sample.points.position, atol=1e-3, rtol=0.0)
