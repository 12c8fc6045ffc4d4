"""Six views: published scalings, progress at each step, a stop inside every block, seeds."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from arm_blender.errors import ArmError, Cancelled
from arm_blender.views.zero123plus import sampling
from arm_blender.views.zero123plus.sampling import Zero123PlusConfig, six_views
from arm_blender.views.zero123plus.view_noise import ViewNoise

FIXTURE = load_file(Path(__file__).parents[2] / "data/parity/zero123plus_scaling.safetensors")
CONFIG = Zero123PlusConfig(Path("weights"), Path("views"), steps=3, side=16)


def drawn(networks, picture, seeds=(0,) * 6, config=CONFIG, **more) -> torch.Tensor:
    return six_views(networks, picture, config, ViewNoise(seeds), **more)


def same(found: torch.Tensor, name: str) -> bool:
    expected = FIXTURE[f"output/{name}"]
    return bool((found - expected).abs().max() <= 1e-5 * expected.abs().max())


def test_scalings_guidance_and_ramping_equal_the_published_ones():
    inputs = {key.removeprefix("input/"): tensor for key, tensor in FIXTURE.items() if key.startswith("input/")}
    assert same(sampling.unscaled_latents(inputs["latents"]), "unscaled_latents")
    assert same(sampling.unscaled_image(inputs["image"]), "unscaled_image")
    assert same(sampling.guided(torch.cat([inputs["noise_uncond"], inputs["noise_cond"]]), 4.0), "guided_g4")
    prompt, embedding, ramp = (inputs[name] for name in ("prompt", "global_embedding", "ramping_coefficients"))
    assert same(sampling.ramped_prompt(prompt, embedding, ramp), "prompt_embedding")
    for name in ("latents", "image"):  # What the networks were taught is undone.
        undone = getattr(sampling, f"unscaled_{name}")(FIXTURE[f"output/scaled_{name}"])
        torch.testing.assert_close(undone, inputs[name], rtol=1e-5, atol=1e-5)


def test_the_views_are_pictures(networks, picture):
    views = drawn(networks, picture)
    assert views.shape == (6, 3, 16, 16) and views.dtype == torch.float32
    assert float(views.min()) >= 0.0 and float(views.max()) <= 1.0 and float(views.std()) > 0.05


def test_progress_hears_of_every_step_once_in_order(networks, picture):
    heard = []
    drawn(networks, picture, progress=lambda fraction, message: heard.append((fraction, message)))
    fractions, messages = zip(*heard, strict=True)
    assert list(fractions) == sorted(fractions) and 0.0 <= fractions[0] and fractions[-1] <= 1.0
    steps = [message for message in dict.fromkeys(messages) if "step" in message]
    assert steps == [f"Zero123++: step {k} of 3" for k in (1, 2, 3)]


BLOCKS = {"CLIPEncoderLayer", "ResnetBlock2D", "BasicTransformerBlock", "Downsample2D", "Upsample2D"}
"""Classes of the libraries that compute something; none of them is inside another."""


def computing(*networks: torch.nn.Module) -> list[torch.nn.Module]:
    return [module for network in networks for module in network.modules() if type(module).__name__ in BLOCKS]


@pytest.mark.parametrize("name", ["text_encoder", "vision_encoder", "vae", "unet"])
@pytest.mark.parametrize("place", [0.0, 0.3, 0.6])
def test_a_stop_inside_a_block_ends_the_run_before_the_next_one(networks, picture, name, place):
    """The user stops while the first layer of a block runs: that block may end, and nothing after it begins."""
    candidates = computing(getattr(networks, name))
    target = candidates[int(place * len(candidates))]
    inner = next(module for module in target.modules() if not list(module.children()))
    stopped, ended = [], []

    def progress(fraction, message):
        if stopped:
            raise Cancelled("stopped by the user")

    def note(block, *_):
        if stopped:
            ended.append(block)

    handles = [inner.register_forward_hook(lambda *_: stopped.append(True))]
    handles += [block.register_forward_hook(note) for block in computing(*networks.modules)]
    try:
        with pytest.raises(Cancelled):
            drawn(networks, picture, progress=progress)
    finally:
        for handle in handles:
            handle.remove()
    assert stopped == [True] and ended in ([], [target])
    left = [module for network in networks.modules for module in network.modules() if module._forward_pre_hooks]
    assert not left  # The next run is not watched by this one.


def test_the_same_seed_gives_the_same_views_and_another_one_others(networks, picture):
    first = drawn(networks, picture)
    torch.rand(3)  # The caller's own random numbers have no part in it.
    assert torch.equal(drawn(networks, picture), first)
    other = drawn(networks, picture, seeds=(1,) * 6)
    assert ((other - first).abs().flatten(1).mean(dim=1) > 0.01).all()


def test_a_seed_of_its_own_changes_its_view_most(networks, picture):
    change = (drawn(networks, picture, seeds=(0, 0, 0, 5, 0, 0)) - drawn(networks, picture)).abs().flatten(1).mean(1)
    assert int(change.argmax()) == 3 and float(change[3]) > 2.0 * float(change.sum() - change[3]) / 5.0


def test_without_guidance_the_views_know_nothing_of_the_picture(networks, picture):
    """The first row of every pass: the empty prompt, and a reference of nothing."""
    other = picture.flip(1)
    blind = replace(CONFIG, guidance=0.0)
    torch.testing.assert_close(drawn(networks, other, config=blind), drawn(networks, picture, config=blind))
    assert not torch.allclose(drawn(networks, other), drawn(networks, picture), atol=1e-3)


def test_the_background_is_what_the_network_was_trained_on(networks, picture):
    """Under alpha 0 nothing of the picture's own colour is seen; with another background something else is."""
    loud = picture.clone()
    loud[:3, picture[3] == 0.0] = 1.0
    assert torch.equal(drawn(networks, loud), drawn(networks, picture))
    assert not torch.equal(
        drawn(networks, picture, config=replace(CONFIG, background="white")), drawn(networks, picture)
    )


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ({"steps": 0}, "--multiview-steps 0"),
        ({"steps": 1001}, "--multiview-steps 1001"),
        ({"guidance": float("nan")}, "--multiview-guidance nan"),
        ({"background": "black"}, "--multiview-background black"),
        ({"reseed": (1, 6)}, "--reseed 1,6"),
    ],
)
def test_settings_out_of_range_are_refused(wrong, word):
    with pytest.raises(ArmError, match=word):
        replace(CONFIG, **wrong)
