"""The bars that the shipped preset is held to, and where it stands."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from ...documents import markdown_table
from ..scores.image_scores import best_constant
from ..trials.measure import BLEND, HULL, ONE_VIEW, OURS, PICTURE, ObjectResult, SystemResult

Reader = Callable[[SystemResult], float | None]


@dataclass(frozen=True)
class Bar:
    """One number that has to be reached.

    Attributes:
        title: in the table.
        kinds: sets of objects that it is a mean over; () for all.
        system: whose number counts.
        read: it, from a system's result; None where it was not measured.
        must, aim: thresholds.
        lower: whether less is better.
        over: a system that has to be beaten besides, by `must` or `aim` as a difference.
    """

    title: str
    kinds: tuple[str, ...]
    system: str
    read: Reader
    must: float
    aim: float
    lower: bool = False
    over: str | None = None


def geometry_score(name: str, frame: Literal["geometry", "aligned"] = "geometry") -> Reader:
    """Reads a measure of the shape in the cameras' own frame, or of the aligned one."""
    return lambda result: getattr(getattr(result, frame), name, None)


def map_score(name: str, score: str) -> Reader:
    """Reads a score of a map's pictures."""
    return lambda result: getattr(result.maps[name], score) if name in result.maps else None


SCANS, MEASURED = ("gso",), ("pbr",)
BARS = (
    Bar("GSO F-score@0.1", SCANS, OURS, geometry_score("f_coarse"), 0.98, 0.99),
    Bar("GSO F-score@0.02", SCANS, OURS, geometry_score("f_fine"), 0.76, 0.85),
    Bar("GSO Chamfer distance", SCANS, OURS, geometry_score("chamfer"), 0.034, 0.025, lower=True),
    Bar("PBR set F-score@0.1", MEASURED, OURS, geometry_score("f_coarse"), 0.955, 0.98),
    Bar("PBR set F-score@0.02", MEASURED, OURS, geometry_score("f_fine"), 0.66, 0.75),
    Bar("PBR set Chamfer distance", MEASURED, OURS, geometry_score("chamfer"), 0.050, 0.035, lower=True),
    Bar("normals, mean angle in degrees, all objects", (), OURS, geometry_score("angle"), 19.3, 14.3, lower=True),
    Bar("mask IoU, all objects", (), OURS, lambda result: result.overlap, 0.955, 0.97),
    Bar("GSO lit colour PSNR in", SCANS, OURS, map_score("lit", "psnr_in"), 21.0, 24.0),
    Bar("GSO lit colour PSNR full", SCANS, OURS, map_score("lit", "psnr_full"), 27.5, 30.0),
    Bar("GSO albedo PSNR in", SCANS, OURS, map_score("albedo", "psnr_in"), 20.5, 23.0),
    Bar("PBR set albedo PSNR in", MEASURED, OURS, map_score("albedo", "psnr_in"), 19.5, 22.0),
    Bar("PBR set albedo PSNR full", MEASURED, OURS, map_score("albedo", "psnr_full"), 23.0, 25.0),
    Bar("albedo PSNR in, above plain blending", MEASURED, OURS, map_score("albedo", "psnr_in"), 1.5, 1.5, over=BLEND),
    Bar("PBR set roughness PSNR in", MEASURED, OURS, map_score("roughness", "psnr_in"), 16.0, 19.0),
    Bar("PBR set metallic PSNR in", MEASURED, OURS, map_score("metallic", "psnr_in"), 19.5, 22.0),
    Bar("GSO relit PSNR in", SCANS, OURS, map_score("relit", "psnr_in"), 20.3, 23.0),
    Bar("PBR set relit PSNR in", MEASURED, OURS, map_score("relit", "psnr_in"), 19.0, 22.0),
    Bar("PBR set relit PSNR full", MEASURED, OURS, map_score("relit", "psnr_full"), 24.0, 25.1),
    Bar("one true view, GSO F-score@0.1", SCANS, ONE_VIEW, geometry_score("f_coarse"), 0.81, 0.85),
    Bar("bare picture, GSO F-score@0.1, aligned", SCANS, PICTURE, geometry_score("f_coarse", "aligned"), 0.84, 0.89),
    Bar("one true view, albedo of the seen side PSNR in", (), ONE_VIEW, map_score("albedo", "psnr_in"), 19.0, 22.0),
)
SECONDS_COLD, SECONDS_WARM, WEIGHTS_MIB = (20.0, 10.0), (10.0, 4.0), (25.0, 20.0)
"""Must and aim of what is no mean over objects."""

ABOVE_CONSTANT = {"roughness": (0.6, 2.0), "metallic": (0.0, 0.0)}
"""Must and aim, dB: the best constant has to be known, and a map beats it."""


@dataclass(frozen=True)
class Cost:
    """What a user pays.

    Attributes:
        cold: seconds from starting the program on six views to its last file.
        warm: seconds from the files of the views to the asset, once everything has been loaded.
        weights: MiB of the networks' files.
    """

    cold: float
    warm: float
    weights: float


def mean(results: Sequence[ObjectResult], kinds: Sequence[str], system: str, read: Reader) -> float | None:
    """Over the objects of some sets (all for ()); None where no object has the number."""
    found = [read(r.systems[system]) for r in results if (not kinds or r.kind in kinds) and system in r.systems]
    numbers = [number for number in found if number is not None]
    return sum(numbers) / len(numbers) if numbers else None


def bars_table(results: Sequence[ObjectResult], cost: Cost | None) -> str:
    """Markdown: what must be, what is aimed at, and ours beside the hull with blended vertex colours."""
    rows = []
    for bar in BARS:
        ours = mean(results, bar.kinds, bar.system, bar.read)
        hull = mean(results, bar.kinds, HULL, bar.read) if bar.system == OURS and bar.over is None else None
        if bar.over is not None and ours is not None:
            theirs = mean(results, bar.kinds, bar.over, bar.read)
            ours = None if theirs is None else ours - theirs
        rows.append(_row(bar.title, hull, ours, bar.must, bar.aim, bar.lower))
        if bar.title.endswith(("roughness PSNR in", "metallic PSNR in")):
            name = bar.title.split()[2]
            seen = [r.moments[name] for r in results if r.moments.get(name)]
            if seen and ours is not None:
                constant, score = best_constant(seen)
                title = f"{name} PSNR in, above the best constant ({constant:.2f}: {score:.1f} dB)"
                rows.append(_row(title, None, ours - score, *ABOVE_CONSTANT[name], False))
    if cost is not None:
        rows.append(_row("seconds from six views to the asset, cold", None, cost.cold, *SECONDS_COLD, True))
        rows.append(_row("seconds from six views to the asset, warm", None, cost.warm, *SECONDS_WARM, True))
        rows.append(_row("shipped weights, MiB", None, cost.weights, *WEIGHTS_MIB, True))
    return markdown_table(["", "hull", "must", "aim", "ours", "reached"], rows)


def _row(title: str, hull: float | None, ours: float | None, must: float, aim: float, lower: bool) -> list[str]:
    sign = -1.0 if lower else 1.0
    reached = "not measured"
    if ours is not None and not math.isnan(ours):
        reached = "aim" if sign * (ours - aim) >= 0.0 else "must" if sign * (ours - must) >= 0.0 else "**no**"
    return [title, _number(hull, must), _number(must, must), _number(aim, must), _number(ours, must), reached]


def _number(value: float | None, scale: float) -> str:
    """As many digits as the bar means: scores below 1 have three."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:.3f}" if 0.0 < scale < 1.0 else f"{value:.1f}"
