"""The finish's read-outs, fitted in closed form: ridge regression, and the odds that a score of metal is worth."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from arm_blender.errors import ArmError
from arm_blender.models.small.finish import Finish, FinishConfig, Readout, summary

from ..datasets.finish_samples import FinishSample

STIFF = (1.0, 0.3)
"""Weights of the ridge for roughness and for metal, where each number has a mean square of about 1. In the folds
roughness is best at 1 to 3, metal at 0.1 to 0.3."""

POINTS = 256
"""Of a sample that are fitted; the summary is of all."""

LEAST_SHARE = 0.02
"""Of all points: so many of the highest scores are counted at least to tell how often they are right."""

LEAST_OBJECTS = 3
"""Fewer have no deviation worth the name."""


@dataclass(frozen=True)
class Rows:
    """Samples as a read-out sees them; S of them, K points each.

    Attributes:
        samples: where they come from.
        found: (S, K, N). summary: (S, 5 N). truth: (S, K, 2).
        weight: (S,) in which every object counts the same; 1 in all.
    """

    samples: list[FinishSample]
    found: Tensor
    summary: Tensor
    truth: Tensor
    weight: Tensor

    def only(self, chosen: Tensor) -> "Rows":
        """Those samples where a mask (S,) is true."""
        kept = [sample for sample, keep in zip(self.samples, chosen.tolist(), strict=True) if keep]
        weight = self.weight[chosen] / self.weight[chosen].sum()
        return Rows(kept, self.found[chosen], self.summary[chosen], self.truth[chosen], weight)


def rows(known: list[FinishSample], model: Finish, readout: Readout) -> Rows:
    """Those samples that a read-out of the model reads.

    Raises:
        ArmError: they are of too few objects.
    """
    kept = [sample for sample in known if model.readout(sample.views) is readout]
    if len({sample.name for sample in kept}) < LEAST_OBJECTS:
        raise ArmError(f"{len(kept)} samples of finish: give --shards of {LEAST_OBJECTS} measured objects or more")
    objects = [sample.name for sample in kept]
    found, summaries, truth = [], [], []
    for sample in kept:
        index = torch.linspace(0, len(sample.found) - 1, POINTS).long()
        found.append(sample.found[index])
        summaries.append(summary(sample.found))
        truth.append(sample.truth[index])
    weight = torch.tensor([1.0 / objects.count(name) for name in objects])
    return Rows(kept, torch.stack(found), torch.stack(summaries), torch.stack(truth), weight / weight.sum())


@torch.no_grad()
def fit_readout(readout: Readout, data: Rows, config: FinishConfig, stiff: tuple[float, float] = STIFF) -> None:
    """Set a read-out to what fits the samples best, its odds excepted."""
    for standard, x in ((readout.point, data.found.flatten(0, 1)), (readout.object, data.summary)):
        standard.mean.copy_(x.mean(dim=0))
        standard.scale.copy_(1.0 / (x.std(dim=0) + 1e-4))
    told = _told(readout, data, config).flatten(0, 1).double()
    truth = data.truth.flatten(0, 1).double()
    weight = (data.weight.double() / data.truth.shape[1]).repeat_interleave(data.truth.shape[1])[:, None]
    usual_told, usual = (weight * told).sum(dim=0), (weight * truth).sum(dim=0)
    told, truth = told - usual_told, truth - usual
    square, product = told.T @ (weight * told), told.T @ (weight * truth)
    plain = torch.eye(len(square), dtype=torch.float64)
    solved = [torch.linalg.solve(square + ridge * plain, product[:, k]) for k, ridge in enumerate(stiff)]
    readout.answer.weight.copy_(torch.stack(solved))
    readout.answer.bias.copy_(usual)  # A number is 0 where it is usual; so little as that is off is left out.


@torch.no_grad()
def answers(model: Finish, readout: Readout, data: Rows) -> Tensor:
    """(S, K, 2) roughness and score of metal, before both are bounded."""
    return torch.stack([model.answer(readout, x, s)[0] for x, s in zip(data.found, data.summary, strict=True)])


def fit_odds(readout: Readout, score: Tensor, truth: Tensor, weight: Tensor) -> None:
    """Set the odds so that a score (S, K) tells the probability of metal, from scores of objects that were left out.

    Where the highest scores are right less often than the odds say, that is the ceiling.

    Args:
        truth: (S, K) true metallic. weight: (S,).
    """
    metal, odds = (truth > 0.5).float(), nn.Parameter(torch.tensor([4.0, -2.0]))
    optimizer = torch.optim.LBFGS([odds], max_iter=100, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimizer.zero_grad()
        each = functional.binary_cross_entropy_with_logits(odds[0] * score + odds[1], metal, reduction="none")
        value = (weight * each.mean(dim=1)).sum() + 1e-4 * odds.square().sum()
        value.backward()
        return value

    optimizer.step(loss)
    with torch.no_grad():
        readout.odds.weight.copy_(odds[:1, None].detach())
        readout.odds.bias.copy_(odds[1:].detach())
        order = score.flatten().argsort(descending=True)
        share = (weight[:, None] / score.shape[1]).expand_as(score).flatten()[order].cumsum(0)
        right = (weight[:, None] * metal / score.shape[1]).flatten()[order].cumsum(0)
        readout.ceiling.copy_((right / share)[share >= LEAST_SHARE * share[-1]].max())


def _told(readout: Readout, data: Rows, config: FinishConfig) -> Tensor:
    pairs = zip(data.found, data.summary, strict=True)
    return torch.stack([readout.told(x, whole, config.bound) for x, whole in pairs])
