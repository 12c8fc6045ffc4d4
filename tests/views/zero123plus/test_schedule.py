"""The sampler gives the numbers of diffusers' one, and takes a perfect prediction to the picture."""

from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from arm_blender.views.zero123plus.schedule import NoiseConfig, schedule

FIXTURE = load_file(Path(__file__).parents[2] / "data/parity/zero123plus_scheduler.safetensors")


def same(found: torch.Tensor, name: str) -> bool:
    expected = FIXTURE[f"output/{name}"]
    return bool((found - expected).abs().max() <= 1e-5 * expected.abs().max())


def test_the_shares_of_the_picture_equal_the_published_ones():
    assert same(NoiseConfig().alphas_cumprod(), "alphas_cumprod")


@pytest.mark.parametrize("steps", [28, 75])
def test_the_levels_equal_the_published_ones(steps):
    levels = schedule(NoiseConfig(), steps)
    assert levels.timesteps == tuple(FIXTURE[f"output/timesteps_{steps}"].int().tolist())
    assert same(torch.tensor(levels.sigmas), f"sigmas_{steps}")
    assert levels.initial_sigma == pytest.approx(float(FIXTURE[f"output/init_noise_sigma_{steps}"]), rel=1e-5)


@pytest.mark.parametrize(("steps", "k"), [(28, 0), (28, 14), (28, 27), (75, 0), (75, 37), (75, 74)])
def test_a_step_equals_the_published_one(steps, k):
    levels = schedule(NoiseConfig(), steps)
    clean, noise, v = (FIXTURE[f"input/{name}"] for name in ("sample", "noise", "model_output"))
    noised = levels.noised(clean, noise, k)
    sample = clean * levels.sigmas[k]
    assert same(noised, f"noised_condition_{steps}_step{k}")
    assert same(levels.scaled(noised, k), f"noised_condition_scaled_{steps}_step{k}")
    assert same(levels.scaled(sample, k), f"scaled_input_{steps}_step{k}")
    assert same(levels.picture(sample, v, k), f"pred_original_{steps}_step{k}")
    assert same(levels.step(sample, v, noise, k), f"prev_sample_{steps}_step{k}")


@pytest.mark.parametrize("beta_schedule", ["linear", "scaled_linear"])
def test_a_perfect_prediction_ends_in_the_picture(beta_schedule):
    """v = a * noise - s * picture, where a² + s² = 1 are the shares at a level (Salimans and Ho)."""
    levels = schedule(NoiseConfig(beta_schedule=beta_schedule), 9)
    generator = torch.Generator().manual_seed(0)
    picture, sample = torch.rand(2, 50, generator=generator, dtype=torch.float64)
    sample = sample * levels.initial_sigma
    for k, sigma in enumerate(levels.sigmas[:-1]):
        noise = (sample - picture) / sigma
        v = (noise - sigma * picture) / (sigma**2 + 1.0) ** 0.5
        torch.testing.assert_close(levels.picture(sample, v, k), picture)
        sample = levels.step(sample, v, torch.randn(50, generator=generator, dtype=torch.float64), k)
    torch.testing.assert_close(sample, picture)


@pytest.mark.parametrize("steps", [0, 1001])
def test_steps_that_no_training_had_are_refused(steps):
    with pytest.raises(ValueError, match="steps"):
        schedule(NoiseConfig(), steps)
