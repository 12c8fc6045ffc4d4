"""Reference attention gives the published network's numbers."""

from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from arm_blender.views.zero123plus.attention import predict
from arm_blender.views.zero123plus.schedule import NoiseConfig, schedule

diffusers = pytest.importorskip("diffusers")

FIXTURE = load_file(Path(__file__).parents[2] / "data/parity/zero123plus_reference_unet.safetensors")
INPUT = {key.removeprefix("input/"): tensor for key, tensor in FIXTURE.items() if key.startswith("input/")}
SHAPE = {
    "sample_size": 8,
    "block_out_channels": (16, 32),
    "layers_per_block": 1,
    "down_block_types": ("CrossAttnDownBlock2D", "DownBlock2D"),
    "up_block_types": ("UpBlock2D", "CrossAttnUpBlock2D"),
    "cross_attention_dim": 12,
    "attention_head_dim": (2, 4),
    "norm_num_groups": 8,
    "use_linear_projection": True,
}


@pytest.fixture(scope="module")
def unet():
    network = diffusers.UNet2DConditionModel(**SHAPE).eval().requires_grad_(False)
    prefix = "weights/unet."
    weights = {key.removeprefix(prefix): tensor for key, tensor in FIXTURE.items() if key.startswith(prefix)}
    network.load_state_dict(weights)
    return network


def predicted(unet, k: int, **changes: torch.Tensor) -> torch.Tensor:
    """The prediction at level k of 28, with some of the inputs changed."""
    values = INPUT | changes
    levels = schedule(NoiseConfig(), 28)
    reference = levels.noised(values["condition_latents"], values["condition_noise"], k)
    timestep = torch.tensor(levels.timesteps[k])
    sample = levels.scaled(values["sample"], k)
    return predict(unet, sample, levels.scaled(reference, k), timestep, values["encoder_hidden_states"])


@pytest.mark.parametrize("k", [0, 14, 27])
def test_the_prediction_equals_the_published_one(unet, k):
    expected = FIXTURE[f"output/out_step{k}"]
    assert (predicted(unet, k) - expected).abs().max() <= 1e-5 * expected.abs().max()


def test_each_row_sees_its_own_reference_only(unet):
    other = INPUT["condition_latents"].clone()
    other[1] += 1.0
    changed = predicted(unet, 27, condition_latents=other) != predicted(unet, 27)
    assert changed.flatten(1).any(dim=1).tolist() == [False, True]


def test_the_network_is_left_as_it_was(unet):
    def plain() -> torch.Tensor:
        return unet(INPUT["sample"], 5, encoder_hidden_states=INPUT["encoder_hidden_states"]).sample

    before = plain()
    predicted(unet, 14)
    assert torch.equal(plain(), before)


def test_another_batch_or_network_is_refused(unet):
    with pytest.raises(ValueError, match="one batch, got 2, 1, 2"):
        predict(unet, INPUT["sample"], torch.zeros(1, 4, 8, 8), torch.tensor(5), INPUT["encoder_hidden_states"])
    with pytest.raises(ValueError, match="Linear has no attn1"):
        predict(torch.nn.Linear(1, 1), *[torch.zeros(1)] * 4)
