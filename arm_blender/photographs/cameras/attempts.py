"""Attempts to solve the cameras of photographs, from cheap to thorough, until one bears its own check."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from ...progress import Progress, part
from ..masks.joint_hull import JointHull, joint_hull
from .looking_again import looked_at_again
from .solver import Job, Solution, match, solve, solve_again
from .standing import Upright, upright
from .trust import AGREEMENT, SHARED, Trust, borne_out, compared, judged
from .working_copies import WorkingCopy, lenses_of, write_regions

logger = logging.getLogger(__name__)

PICTURES, COLORS = "pictures", "colors"
"""Folders of the working copies: as grey levels, and with their colours."""

FACTORS = (None, 0.75, 1.0, 1.35)
"""Focal lengths that are tried, as shares of the longer side: 67°, 53° and 41° across. None leaves it to COLMAP."""

MOST_FOCAL_CHANGE, MOST_RADIAL = 0.15, 0.3
"""Of a lens that was set free, beside what its camera says: beyond it the lens is held."""

_MASKED = 0.7
"""Of the pictures, the share that must have a mask for masks to be used."""

_NEARLY_ALL = 0.9
"""Of the pictures, the share that has to have a camera for a good solution to be looked for no further."""

_OBJECT_ALONE = "object"
"""Where features are looked for if the thing was turned before a background that stands."""

_SECOND_GROUP = 0.25
"""Of the pictures, the share in a second solution that stands for a second thing."""


@dataclass(frozen=True)
class Attempt:
    """A solution with its judgement.

    Attributes:
        way: where features were looked for.
        solution: of the cameras.
        copies: of the pictures that have a camera, in the solution's order.
        hull: of their masks; None where too few have one.
        trust: how far the solution is to be trusted.
        groups: names of the pictures of this and of every smaller solution that was found beside it.
        looks: how often all pictures were looked at together for its masks.
    """

    way: str
    solution: Solution
    copies: list[WorkingCopy]
    hull: JointHull | None
    trust: Trust
    groups: list[list[str]]
    looks: int = 0

    @property
    def stands_still(self) -> bool:
        """Whether the object did not turn before its surroundings: nearly all cameras were found with those, its masks
        fit them, and a second way to solve finds the same."""
        measures = self.trust.measures
        found, fits = measures["registered"] >= _NEARLY_ALL, measures.get("agreement", 0.0) >= AGREEMENT[0]
        return found and fits and measures.get("apart", 1.0) <= SHARED[0]

    def standing(self, seed: int) -> Upright:
        """Where the object stands."""
        masks = None
        if self.hull is not None:
            masks = [torch.zeros(copy.height, copy.width) if copy.mask is None else copy.mask for copy in self.copies]
        return upright(self.solution, masks, self.hull, seed)

    def looked_again(self, folder: Path, seed: int, progress: Progress) -> "Attempt":
        """With the masks that all pictures together tell, now that their cameras are known.

        Args:
            folder: of the work; holds the copies in `COLORS`.
            seed: of whatever is drawn.
            progress: told each picture.
        """
        stand = self.standing(seed)
        copies = looked_at_again(self.copies, folder / COLORS, self.solution, stand, progress)
        return replace(self, copies=copies, hull=_hull(self.solution, copies), looks=self.looks + 1)


def best_attempt(
    copies: list[WorkingCopy], folder: Path, threads: int, seed: int, progress: Progress
) -> Attempt | None:
    """The first attempt that is good, with nearly all pictures, else the best one; None where none solved anything.

    Args:
        copies: of all pictures.
        folder: of the work; holds the copies in `PICTURES` and `COLORS`.
        threads: of the CPU.
        seed: of whatever is drawn.
        progress: told at least every second; what it raises ends the solver's process.
    Raises:
        ArmError: pycolmap is not there, or has failed.
    """
    best: Attempt | None = None
    jobs = list(_jobs(copies, folder, threads, seed))
    for index, (way, job) in enumerate(jobs):
        if way == _OBJECT_ALONE and best is not None and best.stands_still:
            continue
        share = part(progress, index / len(jobs), (index + 1) / len(jobs))
        match(job, part(share, 0.0, 0.6))
        for number, factor in enumerate(FACTORS[:1] if job.focal_is_known else FACTORS):
            fits, groups = solve(job, f"try-{number}", factor, part(share, 0.6, 0.8))
            if not fits:
                continue
            found = _judged(way, _chosen(fits, job.focal_is_known), groups, copies)
            if found.trust.level != "wrong":
                again = solve_again(job, found.solution, part(share, 0.8, 0.9))
                found = replace(found, trust=compared(found.trust, found.solution, again))
            if found.trust.doubts_masks_alone:
                # One bad mask is like another to the first look: what all pictures say together tells more.
                looked = found.looked_again(folder, seed, part(share, 0.9, 1.0))
                found = replace(looked, trust=borne_out(looked.trust, looked.hull))
            logger.info("%s, focal %s: %s", way, factor, found.trust)
            if best is None or found.trust.rank > best.trust.rank:
                best = found
            if found.trust.needs_no_other and found.trust.measures["registered"] >= _NEARLY_ALL:
                return found
        if best is not None and best.trust.level == "doubtful" and best.hull is None:
            return best  # Without masks there is nothing that would tell the next one from it.
    return best


def _jobs(copies: list[WorkingCopy], folder: Path, threads: int, seed: int) -> Iterator[tuple[str, Job]]:
    """Where features are looked for, the likeliest first, each as a job with a folder of its own."""
    masked = sum(copy.mask is not None for copy in copies) >= _MASKED * len(copies)
    ways = ["object and ground", "whole picture", _OBJECT_ALONE] if masked else ["whole picture"]
    for index, way in enumerate(ways):
        own = folder / f"way-{index}"
        own.mkdir()
        regions = None if way == "whole picture" else write_regions(copies, own / "regions", way != _OBJECT_ALONE)
        yield way, Job(own, folder / PICTURES, regions, lenses_of(copies), threads, seed)


def _judged(way: str, solution: Solution, groups: list[list[str]], copies: list[WorkingCopy]) -> Attempt:
    """A solution before it is compared with a second one."""
    by_name = {copy.name: copy for copy in copies}
    own = [by_name[name] for name in solution.names]
    hull = _hull(solution, own)
    trust = judged(solution, len(copies), hull)
    if are_split(groups, len(copies)):
        trust = replace(trust, level="wrong")
    return Attempt(way, solution, own, hull, trust, groups)


def _chosen(fits: list[Solution], focal_is_known: bool) -> Solution:
    """The solution whose lenses were set free, where they are still plausible; else the one where they were held."""
    held, free = fits[0], fits[-1]
    for before, after in zip(held.lenses, free.lenses, strict=True):
        change = abs(after.parameters[0] / before.parameters[0] - 1.0)
        if (focal_is_known and change > MOST_FOCAL_CHANGE) or abs(after.parameters[3]) > MOST_RADIAL:
            return held
    return free if len(free.points) >= 0.8 * len(held.points) else held


def _hull(solution: Solution, copies: list[WorkingCopy]) -> JointHull | None:
    """Of the masks of the pictures that have one; None where too few have.

    Args:
        copies: of the pictures of the solution.
    """
    rows = [row for row, copy in enumerate(copies) if copy.mask is not None]
    if len(rows) < max(3, _MASKED * len(copies)):
        return None
    masks = [copy.mask for copy in copies if copy.mask is not None]
    return joint_hull(solution.w2c[rows], tuple(solution.lenses[row] for row in rows), masks)


def are_split(groups: list[list[str]], count: int) -> bool:
    """Whether many of `count` pictures that the largest solution lacks make up another one."""
    return len(groups) > 1 and len(set(groups[1]) - set(groups[0])) >= _SECOND_GROUP * count
