"""How far a solution is to be trusted: a wrong one looks as fine as a right one to the solver itself."""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor
from torch.nn.functional import normalize

from ...graphics.similarity import similarity
from ..masks.joint_hull import JointHull
from .solver import Solution

Level = Literal["good", "doubtful", "wrong"]

FEWEST = 5
"""Pictures with a camera: below it nothing contradicts anything."""

STRONG = 30
"""Matches of two pictures that cannot be there by chance."""

ALLOWED = 0.85, 0.7
"""Of all matches, the share that the cameras allow: below the first a solution is doubtful, below the second wrong."""

CONTRADICTED = 0.08, 0.25
"""Of the pairs with `STRONG` matches, the share of which the cameras allow less than half."""

AGREEMENT = 0.75, 0.55
"""Of the masks with their joint hull, the median. Cameras that are off by a tenth of the distance leave 0.6 of it."""

TOGETHER = 0.84
"""As `AGREEMENT`, of masks that were found by all pictures together: they know the cameras, and fit wrong ones too. On
five captures of training objects it is 0.80 to 0.89; with cameras that are off by a tenth of the distance 0.72 to 0.78,
by a twentieth 0.71 to 0.88."""

RATHER_MASKS = 0.65
"""As `AGREEMENT`: from here on bad masks are likelier than wrong cameras, where nothing else speaks against those. On
the same captures it is 0.76 to 0.88 with right cameras; with cameras that are off by a tenth of the distance it is 0.34
to 0.68, by a fifth 0.37 at most."""

MASKS_APART = "the masks of the object do not fit together"
"""What is said of an agreement that is low."""

REGISTERED = 0.8, 0.6
"""Of the pictures, the share that has a camera."""

SHARED = 0.03, 0.1
"""Of the distance to the object, how far two ways to solve may put a camera apart, the median."""


GRAZING = 0.2
"""Cosine between a side's normal and a camera's direction up to which the camera sees nothing of that side."""

UNSEEN = 0.2
"""Of an object's sides, the share that no camera sees from which on its pictures do not go around it."""

_SIDES = 72
"""That are asked for."""


@dataclass(frozen=True)
class Trust:
    """A judgement.

    Attributes:
        level: good; doubtful: to be used with a warning; wrong: not to be used.
        reasons: why it is not good, the worst first.
        measures: what was measured, by name.
    """

    level: Level
    reasons: tuple[str, ...]
    measures: dict[str, float]

    @property
    def doubts_masks_alone(self) -> bool:
        """Whether the masks, and nothing else, speak against it, and not much."""
        return self.level == "doubtful" and self.reasons == (MASKS_APART,)

    @property
    def needs_no_other(self) -> bool:
        """Whether another attempt could hardly be better: it is good, or what is doubtful is rather the masks."""
        return self.level == "good" or (self.doubts_masks_alone and self.measures["agreement"] >= RATHER_MASKS)

    @property
    def rank(self) -> tuple[int, float]:
        """The higher, the better."""
        for_it = self.measures["registered"] + self.measures["allowed"]
        against = self.measures["contradicted"] + self.measures.get("apart", 0.0)
        return ("wrong", "doubtful", "good").index(self.level), for_it - against


def judged(solution: Solution, count: int, hull: JointHull | None) -> Trust:
    """What speaks against a solution.

    Args:
        count: pictures that were given.
        hull: of the masks, where there are any.
    """
    pairs = solution.pairs
    strong = pairs[:, 2] >= STRONG
    measures = {
        "registered": len(solution.names) / count,
        "allowed": float(pairs[:, 3].sum() / pairs[:, 2].sum().clamp(min=1.0)),
        "contradicted": float((pairs[strong, 3] < 0.5 * pairs[strong, 2]).double().mean())
        if bool(strong.any())
        else 1.0,
        "error": solution.error,
    }
    found: list[tuple[Level, str]] = [
        _low(measures["registered"], REGISTERED, f"only {len(solution.names)} of {count} pictures have a camera"),
        _low(measures["allowed"], ALLOWED, "many matches contradict the cameras"),
        _low(-measures["contradicted"], (-CONTRADICTED[0], -CONTRADICTED[1]), "some pictures contradict each other"),
    ]
    if hull is None:
        found.append(("doubtful", "there are no masks to check the cameras by"))
    else:
        measures["agreement"] = float(hull.agreement.median()) if len(hull.points) else 0.0
        found.append(_low(measures["agreement"], AGREEMENT, MASKS_APART))
    if len(solution.names) < FEWEST and found[0][0] != "wrong":
        found.append(("wrong", f"only {len(solution.names)} pictures have a camera"))
    return _trust(found, measures)


def compared(trust: Trust, first: Solution, second: Solution | None) -> Trust:
    """The judgement after a second opinion: another solution of the same pictures."""
    apart = 1.0 if second is None else distance_apart(first, second)
    finding = _low(-apart, (-SHARED[0], -SHARED[1]), "two ways to solve the cameras disagree")
    if finding[0] == "wrong" and trust.measures.get("agreement", 0.0) >= AGREEMENT[0]:
        finding = "doubtful", finding[1]  # The masks, which neither knows, bear out this one.
    measures = trust.measures | {"apart": apart}
    return _trust([(trust.level, reason) for reason in trust.reasons] + [finding], measures)


def borne_out(trust: Trust, hull: JointHull | None) -> Trust:
    """The judgement of a solution that `doubts_masks_alone`, after all pictures were looked at together.

    Args:
        hull: of the masks that were found by that.
    """
    agreement = float(hull.agreement.median()) if hull is not None and len(hull.points) else 0.0
    measures = trust.measures | {"agreement together": agreement}
    if agreement < TOGETHER:
        return Trust(trust.level, trust.reasons, measures)
    return Trust("good", (), measures)


def seen_around(trust: Trust, centers: Tensor) -> Trust:
    """The judgement of an object's capture, which shows what its pictures show and no more.

    Args:
        centers: (V, 3) of the cameras; the object stands about the origin, Z is up.
    """
    azimuth = torch.arange(_SIDES) / _SIDES * 2.0 * math.pi
    side = torch.stack([azimuth.cos(), azimuth.sin(), torch.zeros_like(azimuth)]).to(centers)
    unseen = float((normalize(centers, dim=1) @ side <= GRAZING).all(dim=0).double().mean())
    measures = trust.measures | {"sides unseen": unseen}
    if unseen <= UNSEEN:
        return Trust(trust.level, trust.reasons, measures)
    reason = f"no picture shows {unseen:.0%} of the sides of the object"
    return _trust([(trust.level, why) for why in trust.reasons] + [("doubtful", reason)], measures)


def distance_apart(first: Solution, second: Solution) -> float:
    """How far two solutions put the same camera apart: the median, as a share of the distance between the cameras.

    1 where fewer than half of the cameras are in both.
    """
    both = [name for name in first.names if name in second.names]
    if 2 * len(both) < len(first.names) or len(both) < 3:
        return 1.0
    a, b = (one.centers[[one.names.index(name) for name in both]] for one in (first, second))
    scale, rotation, shift = similarity(b, a)
    off = (scale * b @ rotation.T + shift - a).norm(dim=1)
    return float(off.median() / (a - a.mean(dim=0)).norm(dim=1).median().clamp(min=1e-12))


def _low(value: float, limits: tuple[float, float], reason: str) -> tuple[Level, str]:
    """What a value says that should be high: the limits are those of doubtful and wrong."""
    level: Level = "wrong" if value < limits[1] else "doubtful" if value < limits[0] else "good"
    return level, reason


def _trust(found: list[tuple[Level, str]], measures: dict[str, float]) -> Trust:
    order: tuple[Level, ...] = ("wrong", "doubtful")
    reasons = [reason for level in order for found_level, reason in found if found_level == level]
    levels = {level for level, _ in found}
    worst: Level = "wrong" if "wrong" in levels else "doubtful" if "doubtful" in levels else "good"
    return Trust(worst, tuple(dict.fromkeys(reasons)), measures)
