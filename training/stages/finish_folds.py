"""What the finish's read-outs know of objects whose whole families were left out of the fit."""

import zlib
from dataclasses import dataclass

import torch
from torch import Tensor

from arm_blender.models.small.finish import Finish, Readout

from ..datasets.finish_samples import family
from ..documents import markdown_table, paragraphs
from .finish_readout import Rows, answers, fit_odds, fit_readout

FOLDS = 5

METAL = 0.3
"""Mean metallic from which on an object counts as one of metal."""

HEADER = (
    "points on", "views", "roughness, r of objects", "r of texels", "dB over constant", "metal, AUC of objects",
    "AUC of texels", "marked", "right of them",
)  # fmt: skip


@dataclass(frozen=True)
class LeftOut:
    """What was said of S samples, K points each, by read-outs that knew nothing of their families.

    Attributes:
        answer: (S, K, 2) roughness and score of metal.
        metal: (S, K) probability of it, with odds from the other folds.
    """

    answer: Tensor
    metal: Tensor


def folds(names: list[str]) -> Tensor:
    """(S,) which fold each object is in: whole families, so many in each that the folds are about alike."""
    members: dict[str, set[str]] = {}
    for name in names:
        members.setdefault(family(name), set()).add(name)
    sizes, chosen = [0] * FOLDS, {}
    for one in sorted(members, key=lambda x: (-len(members[x]), zlib.crc32(x.encode()))):
        chosen[one] = sizes.index(min(sizes))
        sizes[chosen[one]] += len(members[one])
    return torch.tensor([chosen[family(name)] for name in names])


def left_out(model: Finish, readout: Readout, data: Rows) -> LeftOut:
    """What is said of each sample when its fold is left out of the fit; `readout` is used for it."""
    fold = folds([sample.name for sample in data.samples])
    answer = torch.zeros_like(data.truth)
    for k in range(FOLDS):
        if bool((fold == k).any()) and bool((fold != k).any()):
            fit_readout(readout, data.only(fold != k), model.config)
            answer[fold == k] = answers(model, readout, data.only(fold == k))
    metal = torch.zeros_like(answer[..., 1])
    for k in range(FOLDS):
        others = fold != k
        if bool((~others).any()) and bool(others.any()):
            fit_odds(readout, answer[others][..., 1], data.truth[others][..., 1], data.weight[others])
            metal[~others] = readout.metal(answer[~others][..., 1])
    return LeftOut(answer, metal)


def table_rows(model: Finish, data: Rows, found: LeftOut) -> list[list[object]]:
    """A row of numbers for each kind of shape and number of views, in the order of `HEADER`."""
    result = []
    for views in sorted({sample.views for sample in data.samples}, reverse=True):
        for true_shape in (True, False):
            kept = [s.views == views and s.true_shape == true_shape for s in data.samples]
            if any(kept):
                chosen = torch.tensor(kept)
                numbers = _numbers(found.answer[chosen], found.metal[chosen], data.truth[chosen], model.config.sure)
                result.append(["the true shape" if true_shape else "GeoRM's", views, *numbers])
    return result


def document(table: list[list[object]], objects: int, families: int, command: str) -> str:
    """What was measured, as Markdown."""
    return paragraphs(
        f"{objects} measured objects in {families} families, {FOLDS} folds; every number is of objects whose family "
        "was left out.",
        markdown_table(HEADER, table),
        f"Made by `{command}`.",
    )


def _numbers(answer: Tensor, metal: Tensor, truth: Tensor, sure: float) -> list[object]:
    """The columns of `HEADER` but the first two; answers and truths (S, K, 2), probabilities (S, K)."""
    rough, true = answer[..., 0].clamp(0.0, 1.0), truth[..., 0]
    gain = 10.0 * torch.log10((true - true.mean()).square().mean() / (rough - true).square().mean())
    is_metal, marked = truth[..., 1] > 0.5, metal > sure
    right = f"{float(is_metal[marked].float().mean()):.2f}" if bool(marked.any()) else "-"
    return [
        correlation(rough.mean(dim=1), true.mean(dim=1)),
        correlation(rough.flatten(), true.flatten()),
        float(gain),
        area_under_curve(metal.mean(dim=1), truth[..., 1].mean(dim=1) > METAL),
        area_under_curve(metal.flatten(), is_metal.flatten()),
        f"{100.0 * float(marked.float().mean()):.1f} %",
        right,
    ]


def correlation(x: Tensor, y: Tensor) -> float:
    """Of two lists of numbers, Pearson's."""
    return float(torch.corrcoef(torch.stack([x, y]))[0, 1])


def area_under_curve(score: Tensor, positive: Tensor) -> float:
    """How often a positive has a higher score than a negative, ties counting half; NaN where one kind is missing."""
    _, index, count = score.double().unique(return_inverse=True, return_counts=True)
    rank = (count.cumsum(0) - (count - 1) / 2.0)[index]  # Of ties the mean; from 1.
    positives = int(positive.sum())
    pairs = positives * (len(score) - positives)
    return float((rank[positive].sum() - positives * (positives + 1) / 2.0) / pairs) if pairs else float("nan")
