"""Relighting by the paper's count: many views under several environments, of which one is in memory at a time."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from torch import Tensor

from arm_blender.graphics.cameras import Camera

from ...losses import Perceptual
from ..truth.truth import Appearance, Relighting, Truth, relit_pictures
from .image_scores import ImageScores, compare_pictures, mean_scores

Render = Callable[[Sequence[Camera], Sequence[Path]], list[Tensor]]
"""(V, 3, N, N) sRGB of one system from V cameras, for each of the lights."""


def relighting_scores(
    relighting: Relighting, show: Callable[[Path], tuple[Tensor, Tensor]], perceptual: Perceptual | None
) -> ImageScores:
    """Means over all views and lights: the paper's PSNR-A, SSIM-A and LPIPS-A.

    Args:
        show: what a system shows from the cameras under a light: (V, 3, N, N) sRGB and (V, 1, N, N) coverage.
        perceptual: as of `compare_pictures`.
    """
    found = []
    for path, light in zip(relighting.files, relighting.lights, strict=True):
        picture, alpha = show(light)
        truth, true_alpha = relit_pictures(path)
        found.append(compare_pictures(picture, truth, alpha, true_alpha, perceptual))
    return mean_scores(found)


def under_lights(
    found: Appearance,
    show: Callable[[Sequence[Camera]], Appearance],
    render: Render,
    truth: Truth,
    perceptual: Perceptual | None,
) -> tuple[Appearance, dict[str, ImageScores]]:
    """A system under the lights of the truth.

    Args:
        found: its maps in the test views.
        show: its maps from other cameras.
        render: its lit pictures.
    Returns:
        `found` with lit colours, and with relit ones where it is the test views that are relit; otherwise the scores
        of relighting, by the name of the map.
    """
    if truth.relighting is None:
        lit, relit = render(found.cameras, (truth.input_light, truth.other_light))
        return replace(found, lit=lit, relit=relit), {}
    (lit,) = render(found.cameras, (truth.input_light,))
    cameras = truth.relighting.cameras
    alpha = show(cameras).alpha
    scores = relighting_scores(truth.relighting, lambda light: (render(cameras, (light,))[0], alpha), perceptual)
    return replace(found, lit=lit), {"relit": scores}
