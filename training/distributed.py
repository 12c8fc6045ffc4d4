"""Several processes fit one network, each on its own samples: `torchrun --nproc_per_node N -m -- training fit ...`.

Data parallel by averaging gradients after each step: the networks are small, and parameters that a step leaves unused
need no special care. Without `torchrun` everything here stands aside.
"""

import os
import struct
import zlib
from collections.abc import Iterable

import torch
import torch.distributed as dist
from torch import Tensor

from arm_blender.errors import ArmError


def join() -> None:
    """Join the processes that `torchrun` started, if it did."""
    if int(os.environ.get("WORLD_SIZE", "1")) > 1 and not dist.is_initialized():
        dist.init_process_group("cpu:gloo,cuda:nccl" if torch.cuda.is_available() else "gloo")


def leave() -> None:
    """Leave them, once all are done."""
    if dist.is_initialized():
        dist.barrier()
        dist.destroy_process_group()


def rank() -> int:
    """Which of the processes this is; 0 alone writes files."""
    return int(os.environ.get("RANK", "0"))


def device(name: str) -> torch.device:
    """Where this process computes: the one of its number, where there are several.

    Args:
        name: cpu or cuda.
    Raises:
        ArmError: torch finds none.
    """
    if name == "cpu":
        return torch.device("cpu")
    if name != "cuda" or not torch.cuda.is_available():
        raise ArmError(f"--device {name}: torch finds none here; choose cpu")
    found = torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0")))
    torch.cuda.set_device(found)
    return found


def step_seed(seed: int, step: int) -> int:
    """Of what a step draws: its own in each process, and the same in a resumed run as in an unbroken one."""
    return _mixed(seed, rank(), step)


def _mixed(*numbers: int) -> int:
    # Torch's generator on the CPU takes 32 bits, and drops those above without a word.
    return zlib.crc32(struct.pack(f"<{len(numbers)}q", *numbers))


def generator(seed: int, step: int) -> torch.Generator:
    """On the CPU, seeded by `step_seed`."""
    return torch.Generator().manual_seed(step_seed(seed, step))


_ORDER = -1
"""No process has this number: what orders the samples is drawn apart from what the steps draw."""


def share(count: int, seed: int, step: int, batch: int) -> list[int]:
    """Indices of the samples that this process takes in a step.

    All processes together take each of `count` samples once, then each once more in another order, and so on.

    Args:
        batch: samples a step of one process.
    """
    processes = int(os.environ.get("WORLD_SIZE", "1"))
    first = (step * processes + rank()) * batch
    chosen = []
    for place in range(first, first + batch):
        epoch, index = divmod(place, count)
        order = torch.randperm(count, generator=torch.Generator().manual_seed(_mixed(seed, _ORDER, epoch)))
        chosen.append(int(order[index]))
    return chosen


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
