"""Several processes fit one network, each on its own samples: `torchrun --nproc_per_node N -m -- training fit ...`.

Data parallel by averaging gradients after each step: the networks are small, and parameters that a step leaves unused
need no special care. Without `torchrun` everything here stands aside.
"""

import os
from collections.abc import Iterable

import torch
import torch.distributed as dist
from torch import Tensor


def join() -> None:
    """Join the processes that `torchrun` started, if it did."""
    if int(os.environ.get("WORLD_SIZE", "1")) > 1 and not dist.is_initialized():
        dist.init_process_group("nccl" if torch.cuda.is_available() else "gloo")


def leave() -> None:
    """Leave them, once all are done."""
    if dist.is_initialized():
        dist.barrier()
        dist.destroy_process_group()


def rank() -> int:
    """Which of the processes this is; 0 alone writes files."""
    return int(os.environ.get("RANK", "0"))


def generator(seed: int, step: int) -> torch.Generator:
    """What a step draws from: its own in each process, and the same in a resumed run as in an unbroken one."""
    return torch.Generator().manual_seed((seed << 48) + (rank() << 32) + step)


def average_gradients(parameters: Iterable[Tensor], seconds: float) -> float:
    """Replace every gradient by its mean over the processes.

    Args:
        parameters: alike in all processes; one without a gradient counts as zero.
        seconds: what this process's step took.
    Returns:
        the mean of `seconds`: all processes must agree on when the time is spent.
    """
    if not dist.is_initialized():
        return seconds
    gradients = [torch.zeros_like(p) if p.grad is None else p.grad for p in parameters]
    flat = torch.cat([g.flatten() for g in gradients] + [gradients[0].new_tensor([seconds])])
    dist.all_reduce(flat)
    flat /= dist.get_world_size()
    *means, seconds = flat.split([g.numel() for g in gradients] + [1])
    for parameter, mean in zip(parameters, means, strict=True):
        parameter.grad = mean.view_as(parameter)
    return float(seconds)
