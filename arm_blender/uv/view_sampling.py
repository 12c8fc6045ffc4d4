"""Reading a view at texels: bilinear where the atlas is denser than the view, area-filtered where it is coarser."""

import torch
from torch import Tensor
from torch.nn import functional


def footprint(pixels: Tensor, mask: Tensor) -> Tensor:
    """How many pixels of a view a step of one texel crosses, along the atlas axis where that is more.

    Args:
        pixels: (T, T, 2) where the texels lie in the view.
        mask: (T, T) bool, covered texels.
    Returns:
        (T, T) pixels per texel; 1 for a texel without a covered neighbour, meaningless where not covered.
    """
    squares = []
    for axis in (0, 1):
        x, y = (pixels.narrow(axis, 1, len(mask) - 1) - pixels.narrow(axis, 0, len(mask) - 1)).unbind(dim=2)
        step = x.square() + y.square()
        valid = mask.narrow(axis, 1, len(mask) - 1) & mask.narrow(axis, 0, len(mask) - 1)
        step = torch.where(valid, step, torch.inf)
        edge = step.new_full((1, len(mask)) if axis == 0 else (len(mask), 1), torch.inf)
        # Of the two neighbours the nearer: the other may belong to a chart that touches this one.
        squares.append(torch.minimum(torch.cat([edge, step], dim=axis), torch.cat([step, edge], dim=axis)))
    longest = torch.maximum(*(torch.where(torch.isinf(square), 0.0, square) for square in squares))
    return torch.where(longest > 0, longest, 1.0).sqrt()


def sample_view(image: Tensor, pixels: Tensor, step: Tensor, min_alpha: float) -> tuple[Tensor, Tensor]:
    """Colours of the opaque pixels around points of a view; no other pixel has a share in them.

    Args:
        image: (4, H, W) linear Rec.709, straight alpha.
        pixels: (P, 2).
        step: (P,) pixels per texel; above 1 a mip level of that size is read (trilinear).
        min_alpha: pixels of less alpha are background.
    Returns:
        (3, P) linear colour, and (P,) bool: at least half of the bilinear weight lies on opaque pixels.
    """
    opaque = (image[3:] >= min_alpha).to(image.dtype)
    # A colour under alpha 0 may be anything, NaN included.
    level = torch.cat([torch.where(opaque > 0, image[:3], 0.0), opaque])
    height, width = image.shape[1:]
    grid = pixels / pixels.new_tensor([width, height]) * 2.0 - 1.0
    found = _bilinear(level, grid)[3] >= 0.5
    levels = max(1, min(height, width).bit_length())
    wanted = step.clamp(min=1.0).log2().clamp(max=levels - 1.0)
    total = image.new_zeros(4, len(pixels))
    for index in range(levels):
        share = (1.0 - (wanted - index).abs()).clamp(min=0.0)
        chosen = ((share > 0) & found).nonzero()[:, 0]
        if len(chosen):
            taps = _bilinear(level, grid[chosen])
            # Each level by itself, so that a level's share does not depend on how much of it is background.
            total[:, chosen] += share[chosen] * taps / taps[3:].clamp(min=1e-6)
        if bool((wanted > index).any()):
            level = _halved(level)
    return total[:3] / total[3:].clamp(min=1e-6), found


def _bilinear(image: Tensor, grid: Tensor) -> Tensor:
    """(C, P) of an image (C, H, W) at (P, 2) in [-1, 1]; nothing lies beyond the border."""
    return functional.grid_sample(
        image[None], grid[None, None], mode="bilinear", padding_mode="border", align_corners=False
    )[0, :, 0]


def _halved(level: Tensor) -> Tensor:
    """The next mip level. Windows of an odd side overlap, as a level is addressed by the share of its side."""
    size = [max(1, (side + 1) // 2) for side in level.shape[1:]]
    return functional.interpolate(level[None], size=size, mode="area")[0]
