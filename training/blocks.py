"""How the blocks that a network repeats are run in training: with their activations kept or not, compiled or not."""

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from arm_blender.models.image_encoder import ModulatedBlock
from arm_blender.models.transformer import TransformerBlock
from arm_blender.models.triplane import ResidualDenseBlock
from arm_blender.models.vit import Block

REPEATED = (ModulatedBlock, TransformerBlock, ResidualDenseBlock, Block)
"""Most of a network's activations are made in these, and they are alike: what is compiled once serves all."""


def repeated(model: nn.Module) -> list[nn.Module]:
    """The blocks of a network, in order."""
    return [module for module in model.modules() if isinstance(module, REPEATED)]


def recompute(model: nn.Module) -> None:
    """Keep a block's input only, and run it again for the gradient (Chen et al. 2016, arXiv 1604.06174).

    In place; a copy of the model made before is not touched, one made afterwards would run the original's blocks.
    """
    for block in repeated(model):
        block.forward = partial(_again, block.forward)


def _again(forward: Callable[..., Tensor], *inputs: Tensor) -> Tensor:
    if not torch.is_grad_enabled():
        return forward(*inputs)
    return checkpoint(forward, *inputs, use_reentrant=False)


def compile_blocks(model: nn.Module, backend: str = "inductor") -> None:
    """Compile each block by `torch.compile` when it first runs; its parameters keep their names.

    Args:
        backend: torch's own needs a C++ compiler.
    """
    for block in repeated(model):
        block.compile(dynamic=False, backend=backend)
