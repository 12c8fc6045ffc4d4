"""Reference attention (Zero123++, arXiv:2310.15110, section 2.2): every self-attention also sees the input picture."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor, nn

Inputs = tuple[tuple[Tensor, ...], dict[str, Any]]
"""What a layer is called with."""

Hook = Callable[[nn.Module, tuple[Tensor, ...], dict[str, Any]], Inputs | None]
"""Called before a layer, with it and its inputs; it may give others in their place."""

_SELF_ATTENTION = "attn1"
"""What diffusers calls the self-attention of a transformer block; `attn2` is the one to the prompt."""


def predict(unet: nn.Module, sample: Tensor, reference: Tensor, timestep: Tensor, prompt: Tensor) -> Tensor:
    """A UNet's prediction for `sample`, its self-attention extended by the tokens of `reference`.

    A first pass over the reference keeps what each self-attention takes in; in the second pass each one attends to
    its own tokens, followed by the kept ones.

    Args:
        unet: diffusers' UNet2DConditionModel.
        sample: (B, C, H, W), scaled to the network's input.
        reference: (B, C, h, w) with noise of the same level, scaled likewise.
        timestep: () the level, as the network was trained.
        prompt: (B, L, D) embedding, for both passes.
    Returns:
        (B, C, H, W).
    Raises:
        ValueError: the batches differ, or the network has no self-attention.
    """
    if not sample.shape[0] == reference.shape[0] == prompt.shape[0]:
        batches = f"{sample.shape[0]}, {reference.shape[0]}, {prompt.shape[0]}"
        raise ValueError(f"sample, reference and prompt must be of one batch, got {batches}")
    kept: dict[nn.Module, Tensor] = {}

    def keep(attention: nn.Module, args: tuple[Tensor, ...], kwargs: dict[str, Any]) -> None:
        kept[attention] = args[0]

    def extend(attention: nn.Module, args: tuple[Tensor, ...], kwargs: dict[str, Any]) -> Inputs:
        # Popped: the tokens of the layers behind us need no memory any more.
        context = torch.cat([args[0], kept.pop(attention)], dim=1)
        return args, kwargs | {"encoder_hidden_states": context}

    with _self_attention_hook(unet, keep):
        unet(reference, timestep, encoder_hidden_states=prompt, return_dict=False)
    with _self_attention_hook(unet, extend):
        return unet(sample, timestep, encoder_hidden_states=prompt, return_dict=False)[0]


@contextmanager
def _self_attention_hook(unet: nn.Module, hook: Hook) -> Iterator[None]:
    """Calls `hook` before each self-attention of `unet`, inside the block only."""
    layers = [layer for name, layer in unet.named_modules() if name.rpartition(".")[2] == _SELF_ATTENTION]
    if not layers:
        raise ValueError(f"{type(unet).__name__} has no {_SELF_ATTENTION}")
    handles = [layer.register_forward_pre_hook(hook, with_kwargs=True) for layer in layers]
    try:
        yield
    finally:
        for handle in handles:
            handle.remove()
