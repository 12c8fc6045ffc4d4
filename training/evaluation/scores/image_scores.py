"""How alike two sets of pictures are: PSNR over all of a picture and inside of the object, SSIM, LPIPS.

Over a whole picture on white, as papers state it, the background flatters; over the intersection of both masks only the
object counts, and how well the masks agree stands beside it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from arm_blender.graphics.color import srgb_from_linear

from ...losses import Perceptual, similarity

PSNR_CAP = 50.0
"""dB of a view at most: nearly equal pictures would outweigh all others in a mean."""


@dataclass(frozen=True)
class ImageScores:
    """Means over the views.

    Attributes:
        psnr_in: dB over the intersection of both masks; 0 of a view where they do not meet.
        psnr_full: dB over the whole picture on white.
        ssim: of the whole picture on white, in [-1, 1].
        lpips: the same, at least 0; None where no weights are at hand.
    """

    psnr_in: float
    psnr_full: float
    ssim: float
    lpips: float | None = None


MISSED = ImageScores(0.0, 0.0, 0.0)
"""Of an object that was not reconstructed: it stays in the means."""


def compare_pictures(
    found: Tensor, truth: Tensor, found_alpha: Tensor, true_alpha: Tensor, perceptual: Perceptual | None = None
) -> ImageScores:
    """Scores of pictures against the truth.

    Args:
        found: (V, C, N, N) in [0, 1], colours encoded as sRGB, one channel of linear values; straight alpha.
        truth: the same shape.
        found_alpha: (V, 1, N, N) coverage. A pixel more than half covered belongs to the mask.
        true_alpha: the same shape.
        perceptual: LPIPS of pictures (V, 3, N, N).
    Raises:
        ValueError: shapes differ.
    """
    if found.shape != truth.shape or found_alpha.shape != true_alpha.shape:
        raise ValueError(f"found {tuple(found.shape)}, truth {tuple(truth.shape)}, alphas of {tuple(true_alpha.shape)}")
    both = ((found_alpha > 0.5) & (true_alpha > 0.5)).expand_as(found)
    squared = (found - truth).square()
    inside = [
        float(error[where].mean()) if bool(where.any()) else 1.0 for error, where in zip(squared, both, strict=True)
    ]
    x, y = (image * alpha + 1.0 - alpha for image, alpha in ((found, found_alpha), (truth, true_alpha)))
    whole = (x - y).square().flatten(1).mean(dim=1).tolist()
    distance = None
    if perceptual is not None:
        # One view after the other: a network's features of all of them would fill the memory.
        pairs = zip(*(image.expand(-1, 3, -1, -1).split(1) for image in (x, y)), strict=True)
        distance = sum(float(perceptual(a, b)) for a, b in pairs) / len(x)
    return ImageScores(_mean_psnr(inside), _mean_psnr(whole), float(similarity(x, y).mean()), distance)


def mean_scores(scores: Sequence[ImageScores]) -> ImageScores:
    """The mean of scores of as many views each."""
    distances = [score.lpips for score in scores if score.lpips is not None]
    names = ("psnr_in", "psnr_full", "ssim")
    always = {name: sum(getattr(score, name) for score in scores) / len(scores) for name in names}
    return ImageScores(**always, lpips=sum(distances) / len(distances) if len(distances) == len(scores) else None)


def mask_overlap(found_alpha: Tensor, true_alpha: Tensor) -> float:
    """Intersection over union of the masks of alphas (V, 1, N, N), the mean over the views; 1 where both are empty."""
    a, b = (found_alpha > 0.5).flatten(1), (true_alpha > 0.5).flatten(1)
    union = (a | b).sum(dim=1)
    return float(torch.where(union > 0, (a & b).sum(dim=1) / union.clamp(min=1), 1.0).mean())


def psnr(squared_error: float) -> float:
    """dB of a mean squared error in pictures of range 1, at most `PSNR_CAP`."""
    return PSNR_CAP if squared_error <= 10.0 ** (-PSNR_CAP / 10.0) else -10.0 * math.log10(squared_error)


def psnr_inside(found: Tensor, truth: Tensor, inside: Tensor) -> float:
    """dB of the colours of two linear pictures (3 or 4, H, W), compared as sRGB over the pixels (H, W) of a mask."""
    difference = srgb_from_linear(found[:3]) - srgb_from_linear(truth[:3])
    return psnr(float(difference[:, inside].square().mean()))


def _mean_psnr(errors: Sequence[float]) -> float:
    return sum(map(psnr, errors)) / len(errors)


@dataclass(frozen=True)
class ViewMoments:
    """Of the true values in one view, inside of the intersection of both masks: what any constant would score there.

    Attributes:
        mean: of the values. square: mean of their squares.
    """

    mean: float
    square: float

    def psnr(self, constant: float) -> float:
        """dB that a constant scores."""
        return psnr(max(0.0, self.square - 2.0 * constant * self.mean + constant * constant))


def moments(truth: Tensor, found_alpha: Tensor, true_alpha: Tensor) -> list[ViewMoments]:
    """Of each view of `truth` (V, 1, N, N) in which the masks meet."""
    both = (found_alpha > 0.5) & (true_alpha > 0.5)
    views = [image[where].double() for image, where in zip(truth, both, strict=True)]
    return [ViewMoments(float(v.mean()), float(v.square().mean())) for v in views if len(v)]


def constant_score(objects: Sequence[Sequence[ViewMoments]], constant: float) -> float:
    """dB of one constant over a set: the mean over views, then over objects."""
    return sum(sum(view.psnr(constant) for view in views) / len(views) for views in objects) / len(objects)


def best_constant(objects: Sequence[Sequence[ViewMoments]]) -> tuple[float, float]:
    """The one constant that scores best over a set, to a hundredth, and its dB."""
    candidates = [step / 100.0 for step in range(101)]
    best = max(candidates, key=lambda constant: constant_score(objects, constant))
    return best, constant_score(objects, best)
