"""The object of any photograph by the small network that ships: a few looks, then edges along those of the colours.

The first look finds where the object is, closer ones see it larger. All are coarse; the guided filter (He et al. 2013,
in its fast form of 2015, arXiv 1505.00996) carries them to the picture's own edges.
"""

import functools
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate, pad

from ..graphics.color import srgb_from_linear
from ..models.small.cutout import Cutout, CutoutConfig
from ..weight_files import checkpoints
from .masks import Unsure, parts, sees_something, without_specks

WEIGHTS = "small.cutout"
"""The name under which the network is registered."""

_MAYBE = 0.4
"""Probability from which on a pixel counts for where a closer look goes."""

_CERTAIN, _CERTAIN_SHARE = 0.9, 0.1
"""Probability that noise does not reach, and how much of an object does."""

_ROOM = 0.72
"""Share of a closer look's window that the object takes along its longer side."""

_CLOSER = 2
"""Closer looks: where the first one was misled by clutter, the next has less of it."""

_NOTHING = -20.0
"""Logit outside of a closer look's window."""

_MAIN_SHARE = 0.3
"""Of the largest part's pixels, how many another part needs to be looked at with it."""

_LARGE = 0.75
"""Share of the picture from which on a window around the object is no closer look."""

_FILTERED_SIDE = 512
"""Pixels of the longer side at which the filter's coefficients are found; they are smooth, and are enlarged."""

_SMOOTHNESS = 1e-3
"""Variance of sRGB below which the filter takes colours for one. Larger blurs the edge, smaller copies the texture."""


def cut_out(image: Tensor) -> Tensor:
    """(H, W) alpha in [0, 1] of an opaque picture (4, H, W), linear Rec.709; between 0 and 1 where it is not certain.

    Raises:
        Unsure: the network is not installed, or sees nothing.
        CheckpointError: its weights are damaged.
    """
    path = checkpoints.shipped(WEIGHTS)
    if not path.is_file():
        raise Unsure("the small network is not installed")
    network = load_cutout(path, path.stat().st_mtime_ns)
    srgb = srgb_from_linear(image[:3].cpu().float())
    found = _looks(network, srgb)
    if not sees_something(found) or int((found > _CERTAIN).sum()) < _CERTAIN_SHARE * int((found > 0.5).sum()):
        raise Unsure("the small network sees no object")
    alpha = along_edges(srgb, found)
    opaque = alpha > 0.5
    return alpha * ~(opaque & ~without_specks(opaque))


@functools.lru_cache(maxsize=2)  # This look's, and that of `photographs.masks.joint_look`.
def load_cutout(path: Path, changed: int) -> Cutout:
    """The network; `changed` is when its file was, so that another one under the same name is read anew."""
    config, state = checkpoints.load(path, CutoutConfig)
    network = Cutout(config).eval().requires_grad_(False)
    checkpoints.restore(network, state, path)
    return network


def _looks(network: Cutout, srgb: Tensor) -> Tensor:
    """(h, w) probability at about twice the network's resolution, of a picture (3, H, W)."""
    height, width = srgb.shape[1:]
    scale = min(1.0, 2.0 * network.config.closer_side / max(height, width))
    size = max(1, round(scale * height)), max(1, round(scale * width))
    logits = interpolate(_look(network, srgb, network.config.side), size, mode="bicubic", align_corners=False)[0, 0]
    for _ in range(_CLOSER):
        window = _window(logits.sigmoid())
        if window is None:
            break
        top, bottom, left, right = _pixels(window, *size)
        rows, columns = slice(*_pixels(window, height, width)[:2]), slice(*_pixels(window, height, width)[2:])
        closer = _look(network, srgb[:, rows, columns], network.config.closer_side)
        closer = interpolate(closer, (bottom - top, right - left), mode="bicubic", align_corners=False)[0, 0]
        before, logits = logits, torch.full_like(logits, _NOTHING)
        # What was seen before knows the surroundings, the closer look the outline.
        logits[top:bottom, left:right] = (before[top:bottom, left:right] + 2.0 * closer) / 3.0
    return logits.sigmoid()


def _look(network: Cutout, srgb: Tensor, longest: int) -> Tensor:
    """(1, 1, h, w) logits of a picture (3, H, W) at `longest` pixels; the mean with its mirror image's."""
    multiple = network.config.multiple
    scale = longest / max(srgb.shape[1:])
    size = [max(1, round(scale * side / multiple)) * multiple for side in srgb.shape[1:]]
    small = interpolate(srgb[None], size, mode="bilinear", antialias=True, align_corners=False).clamp(0.0, 1.0)
    plain, mirrored = network(torch.cat([small, small.flip(-1)])).split(1)
    return 0.5 * (plain + mirrored.flip(-1))


def _window(probability: Tensor) -> tuple[float, float, float, float] | None:
    """Top, bottom, left and right, in [0, 1], of a look around the object; None where that is the whole picture."""
    maybe = _main_parts(probability > _MAYBE)
    if not bool(maybe.any()):
        return None
    spans = []
    for dim in (1, 0):
        near = torch.nonzero(maybe.any(dim=dim))[:, 0]
        spans.append((float(near[0]), float(near[-1]) + 1.0))
    sides = probability.shape
    half = max(high - low for low, high in spans) / _ROOM / 2.0
    window = []
    for (low, high), side in zip(spans, sides, strict=True):
        middle = (low + high) / 2.0
        window += [max(middle - half, 0.0) / side, min(middle + half, float(side)) / side]
    top, bottom, left, right = window
    return None if (bottom - top) * (right - left) > _LARGE else (top, bottom, left, right)


def _main_parts(mask: Tensor) -> Tensor:
    """`mask` (H, W) bool without what is small beside its largest part: clutter that lies elsewhere."""
    part = parts(mask)
    areas = torch.bincount(part.flatten())
    areas[0] = 0
    return mask & (areas >= _MAIN_SHARE * areas.max())[part]


def _pixels(window: tuple[float, float, float, float], height: int, width: int) -> tuple[int, int, int, int]:
    top, bottom, left, right = window
    return round(top * height), round(bottom * height), round(left * width), round(right * width)


def along_edges(srgb: Tensor, probability: Tensor) -> Tensor:
    """(H, W) alpha whose edges are those of a picture (3, H, W), near the ones of `probability` (h, w)."""
    scale = min(1.0, _FILTERED_SIDE / max(srgb.shape[1:]))
    size = [max(1, round(scale * side)) for side in srgb.shape[1:]]
    guide = interpolate(srgb[None], size, mode="bilinear", antialias=True, align_corners=False)
    mask = interpolate(probability[None, None], size, mode="bilinear", align_corners=False)
    radius = max(1, round(max(size) / 100.0))
    slope, offset = _guided(guide, mask, radius)
    full = [int(side) for side in srgb.shape[1:]]
    slope, offset, near = (
        interpolate(values, full, mode="bilinear", align_corners=False)[0]
        for values in (slope, offset, _mean(mask, 2 * radius))
    )
    alpha = ((slope * srgb).sum(dim=0) + offset[0]).clamp(0.0, 1.0)
    # Far from an edge the network's word counts: the filter would let the texture through.
    solid, empty = near[0] > 0.97, near[0] < 0.03
    return torch.where(solid, 1.0, torch.where(empty, 0.0, (2.0 * (alpha - 0.5) + 0.5).clamp(0.0, 1.0)))


def _guided(guide: Tensor, mask: Tensor, radius: int) -> tuple[Tensor, Tensor]:
    """Slope (1, 3, H, W) and offset (1, 1, H, W) by which colours (1, 3, H, W) tell a mask (1, 1, H, W) best nearby."""
    mean, level = _mean(guide, radius), _mean(mask, radius)
    pairs = torch.cat([guide * guide[:, k : k + 1] for k in range(3)], dim=1)
    variance = _mean(pairs, radius).unflatten(1, (3, 3)) - mean[:, None] * mean[:, :, None]  # (1, 3, 3, H, W)
    variance = variance + _SMOOTHNESS * torch.eye(3)[None, :, :, None, None]
    together = _mean(guide * mask, radius) - mean * level
    rows = variance.unbind(dim=1)
    # The inverse of a symmetric matrix by the cross products of its rows.
    crossed = [rows[(k + 1) % 3].cross(rows[(k + 2) % 3], dim=1) for k in range(3)]
    determinant = (rows[0] * crossed[0]).sum(dim=1, keepdim=True).clamp(min=1e-12)
    slope = torch.stack([crossed[k] * together[:, k : k + 1] for k in range(3)]).sum(dim=0) / determinant
    offset = level - (slope * mean).sum(dim=1, keepdim=True)
    return _mean(slope, radius), _mean(offset, radius)


def _mean(values: Tensor, radius: int) -> Tensor:
    """Of (1, C, H, W), in squares that reach `radius` to each side; at the border of what is inside."""
    side = 2 * radius + 1
    for kernel, margin in (((side, 1), (0, 0, radius, radius)), ((1, side), (radius, radius, 0, 0))):
        values = avg_pool2d(pad(values, margin, mode="replicate"), kernel, stride=1)
    return values
