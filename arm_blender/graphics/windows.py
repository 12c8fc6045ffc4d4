"""What is around each pixel, in a square that reaches some pixels to each side."""

from torch import Tensor
from torch.nn.functional import max_pool2d


def highest_around(image: Tensor, radius: int) -> Tensor:
    """(H, W) maximum of `image` over the square of `radius` pixels around each pixel; beyond the border is nothing."""
    # Two passes of one dimension: a square maximum costs the radius, not its square.
    rows = max_pool2d(image[None, None], (2 * radius + 1, 1), stride=1, padding=(radius, 0))
    return max_pool2d(rows, (1, 2 * radius + 1), stride=1, padding=(0, radius))[0, 0]


def lowest_around(image: Tensor, radius: int) -> Tensor:
    """(H, W) minimum, as `highest_around`."""
    return -highest_around(-image, radius)
