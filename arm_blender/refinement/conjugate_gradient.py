"""Sparse symmetric systems without a library: preconditioned conjugate gradients (Hestenes and Stiefel 1952)."""

from collections.abc import Callable

from torch import Tensor

MOST_STEPS = 1000
"""A system that needs more is too stiff for float32 anyway."""

TICK = 32
"""Steps between two looks at whether the user has stopped the run."""


def solved(
    product: Callable[[Tensor], Tensor],
    diagonal: Tensor,
    right: Tensor,
    start: Tensor,
    tolerance: float = 1e-4,
    tick: Callable[[], None] = lambda: None,
) -> Tensor:
    """(N,) x with `product`(x) = `right`.

    Args:
        product: of (N,) with a symmetric positive matrix.
        diagonal: (N,) of that matrix, all positive: what the residual is divided by.
        right: (N,).
        start: (N,) a guess.
        tolerance: of the residual, as a share of `right`; both measured with `diagonal` divided out.
        tick: called now and then; what it raises passes through.
    """
    x = start.clone()
    residual = right - product(x)
    scaled = residual / diagonal
    direction = scaled.clone()
    energy = float((residual * scaled).sum())
    enough = tolerance**2 * float((right * right / diagonal).sum())
    for step in range(MOST_STEPS):
        if not energy > enough:
            break
        if step % TICK == 0:
            tick()
        image = product(direction)
        length = energy / float((direction * image).sum())
        x += length * direction
        residual -= length * image
        scaled = residual / diagonal
        before, energy = energy, float((residual * scaled).sum())
        direction = scaled + (energy / before) * direction
    return x
