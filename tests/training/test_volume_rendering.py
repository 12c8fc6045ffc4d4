"""Rendering gives InstantMesh's numbers under its weights, closed forms for simple densities, and finite gradients."""

import math
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file
from torch.nn import functional

from arm_blender.graphics.cameras import orbit_camera, unproject
from arm_blender.models.paper.georm import RAW_ISO
from arm_blender.models.triplane import DecoderConfig, decoder, sample_planes
from arm_blender.weight_files.key_maps import convert, density_decoder
from training.volume_rendering import (
    Draws,
    Rays,
    SamplingConfig,
    coarse_depths,
    draw,
    expected_depth,
    fine_depths,
    interval_weights,
    march,
    pixel_rays,
    raw_in_box,
    render,
)

FIXTURE = load_file(Path(__file__).parents[1] / "data/parity/instantmesh_volume_render.safetensors")
WEIGHTS = {key.removeprefix("weights/"): t for key, t in FIXTURE.items() if key.startswith("weights/")}
PICTURES = ("weights_final", "images_weight", "depth_before_clamp", "images_depth")

VIEWS = 2
"""Of each of the two objects, of 6 x 6 pixels."""


def check(found: torch.Tensor, expected: torch.Tensor, tolerance: float = 1e-5) -> None:
    """To a part of the largest expected value."""
    assert found.shape == expected.shape
    assert float((found - expected).abs().max()) <= tolerance * float(expected.abs().max())


@pytest.fixture
def published_field():
    """The stored planes under the stored decoder, imported by the key map: (4, P, 3) to raw densities (4, P)."""
    net = decoder(DecoderConfig(hidden_layers=3, hidden=64), 15, 1)
    net.load_state_dict(convert(WEIGHTS, density_decoder(3, "decoder."), net.state_dict(), "fixture"))
    planes = FIXTURE["input/planes"].repeat_interleave(VIEWS, dim=0)
    return lambda points: net(sample_planes(planes, points))[..., 0] + RAW_ISO


@pytest.fixture
def published_rays():
    cameras = FIXTURE["input/cameras"].flatten(0, 1)  # (4, 25), intrinsics in parts of the image
    c2w, K = cameras[:, :16].view(-1, 4, 4), cameras[:, 16:].view(-1, 3, 3) * torch.tensor([6.0, 6.0, 1.0])[:, None]
    row, column = torch.meshgrid(torch.arange(6) + 0.5, torch.arange(6) + 0.5, indexing="ij")
    return pixel_rays(torch.stack([column, row], dim=-1).flatten(0, 1).expand(4, -1, -1), c2w, K)


def published_draws(case: str) -> Draws:
    quantile = FIXTURE[f"input/{case}/importance_u"].view(4, 36, 8)
    return Draws(FIXTURE[f"input/{case}/jitter"][..., 0], quantile)


def test_rays_and_their_way_through_the_box_equal_the_published_ones(published_rays):
    check(published_rays.origins, FIXTURE["output/fixed/ray_origins"])
    check(published_rays.directions, FIXTURE["output/fixed/ray_directions"])
    hits = FIXTURE["output/fixed/box_exit"][..., 0] > 0.0
    assert hits.any() and not hits.all()
    for found, name in zip(published_rays.box_span(), ("box_entry", "box_exit"), strict=True):
        check(found[hits], FIXTURE[f"output/fixed/{name}"][..., 0][hits])
        assert not found[~hits].any()


@torch.no_grad()
@pytest.mark.parametrize("case", ["random", "fixed"])
def test_samples_equal_the_published_ones(published_field, published_rays, case):
    """Of rays that meet the box; the others see nothing wherever they are sampled."""
    draws, hits = published_draws(case), FIXTURE[f"output/{case}/box_exit"][..., 0] > 0.0
    coarse = coarse_depths(*published_rays.box_span(), draws.jitter)
    check(coarse[hits], FIXTURE[f"output/{case}/depths_coarse"][..., 0][hits])
    weights = interval_weights(raw_in_box(published_field, published_rays.at(coarse)), coarse)
    check(weights[hits], FIXTURE[f"output/{case}/weights_coarse"][..., 0][hits], 5e-5)
    fine = fine_depths(coarse, weights, draws.quantile)
    check(fine[hits], FIXTURE[f"output/{case}/depths_fine"][..., 0][hits])


@torch.no_grad()
@pytest.mark.parametrize("case", ["random", "fixed"])
def test_pictures_equal_the_published_ones(published_field, published_rays, case):
    draws, expected = published_draws(case), {key: FIXTURE[f"output/{case}/{key}"] for key in PICTURES}
    _, weights = march(published_field, published_rays, draws)
    check(weights, expected["weights_final"][..., 0], 5e-5)
    picture = render(published_field, published_rays, draws, rays_at_once=10)
    check(picture.mask, expected["images_weight"].flatten(0, 1).flatten(1), 5e-5)
    check(picture.depth, expected["depth_before_clamp"][..., 0], 5e-5)
    # Theirs are clamped to the samples of the whole batch, those of rays that miss the box included.
    samples = torch.cat([FIXTURE[f"output/{case}/depths_{which}"].flatten() for which in ("coarse", "fine")])
    clamped = picture.depth.clamp(samples.min(), samples.max())
    check(clamped, expected["images_depth"].flatten(0, 1).flatten(1), 5e-5)


def test_the_marching_alone_equals_the_published_one():
    depths, raw, colors = (FIXTURE[f"input/march/{name}"] for name in ("depths", "sigma_raw", "colors"))
    weights = interval_weights(raw[..., 0], depths[..., 0])
    check(weights, FIXTURE["output/march/weights"][..., 0], 5e-5)
    between = 0.5 * (colors[:, :, 1:] + colors[:, :, :-1])
    color = (weights[..., None] * between).sum(dim=2) + 1.0 - weights.sum(dim=2)[..., None]
    check(color, FIXTURE["output/march/rgb"], 5e-5)


def toward_the_box(count: int = 5) -> Rays:
    """Rays along -z from z = 4, next to each other."""
    origins = torch.stack([torch.linspace(-0.5, 0.5, count), torch.zeros(count), torch.full((count,), 4.0)], dim=-1)
    return Rays(origins[None], torch.tensor([0.0, 0.0, -1.0]).expand(1, count, 3))


def raw_of(density: float) -> float:
    return 1.0 + math.log(math.expm1(density))


def test_a_homogeneous_box_absorbs_exponentially():
    """Up to the halves of an interval that jitter moves out of the box at its far side."""
    rays, density = toward_the_box(), 0.7
    config = SamplingConfig(coarse=200, fine=64)
    draws = draw(rays, config, torch.Generator().manual_seed(0))
    picture = render(lambda points: torch.full(points.shape[:-1], raw_of(density)), rays, draws, 3)
    opacity = 1.0 - math.exp(-2.0 * density)
    torch.testing.assert_close(picture.mask, torch.full((1, 5), opacity), atol=0.01, rtol=0.0)
    # Integral of t * density * exp(-density (t - 3)) over [3, 5].
    expected = 3.0 * opacity + (1.0 - (1.0 + 2.0 * density) * math.exp(-2.0 * density)) / density
    torch.testing.assert_close(picture.depth, torch.full((1, 5), expected), atol=0.05, rtol=0.0)


def test_a_ball_is_seen_where_it_is_with_its_normals():
    rays, radius = toward_the_box(9), 0.45
    draws = draw(rays, SamplingConfig(), torch.Generator().manual_seed(1))
    picture = render(lambda points: 4000.0 * (radius - points.norm(dim=-1)), rays, draws, 4096)
    x = rays.origins[0, :, 0]
    hit = x.abs() < radius - 0.02
    height = (radius**2 - x[hit].square()).sqrt()
    torch.testing.assert_close(picture.mask[0], (x.abs() < radius).float(), atol=1e-3, rtol=0.0)
    torch.testing.assert_close(picture.depth[0, hit], 4.0 - height, atol=2.0 / 63.0, rtol=0.0)
    normal = torch.stack([x[hit], torch.zeros_like(height), height], dim=-1) / radius
    assert float((picture.normal[0, hit] * normal).sum(dim=-1).min()) > 0.99


def test_pixel_rays_meet_what_unprojection_says():
    cameras = [orbit_camera(40.0, 20.0, 3.0, 40.0, 8, 8), orbit_camera(-70.0, -10.0, 2.5, 30.0, 8, 8)]
    pixels = 8.0 * torch.rand(2, 7, 2, generator=torch.Generator().manual_seed(0))
    rays = pixel_rays(pixels, torch.stack([c.c2w for c in cameras]), torch.stack([c.K for c in cameras]))
    for index, camera in enumerate(cameras):
        points = unproject(pixels[index], torch.full((7,), 2.0), camera)
        direction = functional.normalize(points - camera.center, dim=-1)
        torch.testing.assert_close(rays.directions[index], direction)


def test_a_ray_that_misses_or_starts_inside_or_runs_along_an_axis():
    origins = torch.tensor([[[3.0, 3.0, 3.0], [0.0, 0.0, 0.0], [0.5, 0.0, 4.0], [0.0, 0.0, -4.0]]])
    directions = torch.tensor([[[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, -1.0]]])
    entry, leave = Rays(origins, directions).box_span()
    torch.testing.assert_close(entry, torch.tensor([[0.0, 0.0, 3.0, 0.0]]))
    torch.testing.assert_close(leave, torch.tensor([[0.0, 1.0, 5.0, 0.0]]))


@pytest.mark.parametrize("raw", [1e4, -1e4, 0.0, 1e30, -1e30])
def test_opaque_and_empty_rays_have_finite_gradients(raw):
    """The same everywhere: no gradient has a direction either."""
    rays, level = toward_the_box(), torch.tensor(raw, requires_grad=True)
    draws = draw(rays, SamplingConfig(16, 16), torch.Generator().manual_seed(0))
    slope = torch.zeros(3, requires_grad=True)
    picture = render(lambda points: level + points @ slope, rays, draws, 2)
    (picture.mask.sum() + picture.depth.sum() + picture.normal.sum()).backward()
    assert level.grad.isfinite() and slope.grad.isfinite().all()
    opaque = float(raw > 100.0)
    if raw:
        torch.testing.assert_close(picture.mask, torch.full((1, 5), opaque), atol=1e-6, rtol=0.0)


def test_gradients_equal_differences():
    rays = toward_the_box(3)
    depths = coarse_depths(*rays.box_span(), torch.rand(1, 3, 12, generator=torch.Generator().manual_seed(0)))
    raw = torch.randn(1, 3, 12, generator=torch.Generator().manual_seed(1), dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda x: expected_depth(depths.double(), interval_weights(x, depths.double())), (raw,)
    )
