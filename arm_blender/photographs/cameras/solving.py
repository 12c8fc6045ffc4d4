"""Photographs without cameras to a capture: several attempts, from cheap to thorough, until one bears its own check."""

import logging
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from ...errors import CameraError, InputImageError
from ...progress import Progress, part
from ...views.foreground import Heard, unheard
from ..capture import Capture, Lens, PosedPhotograph
from ..masks.joint_hull import JointHull, joint_hull
from .looking_again import looked_at_again
from .solver import Job, Solution, match, solve, solve_again
from .standing import Upright, upright
from .trust import FEWEST, Trust, apart, compared, judged
from .working_copies import WorkingCopy, lenses_of, working_copies, write_regions

logger = logging.getLogger(__name__)

BETTER = "give 20 pictures or more from all around, each showing most of what the one before it shows; "
BETTER += "put a sheet of newspaper under the object, leave it where it is, and do not zoom"
"""How to take pictures that can be solved."""

FACTORS = (None, 0.75, 1.0, 1.35)
"""Focal lengths that are tried, as shares of the longer side: 67°, 53° and 41° across. None leaves it to COLMAP."""

MOST_FOCAL_CHANGE, MOST_RADIAL = 0.15, 0.3
"""Of a lens that was set free, beside what its camera says: beyond it the lens is held."""

_MASKED = 0.7
"""Of the pictures, the share that must have a mask for masks to be used."""

_NEARLY_ALL = 0.9
"""Of the pictures, the share that has to have a camera for a good solution to be looked for no further."""

_SECOND_GROUP = 0.25
"""Of the pictures, the share in a second solution that stands for a second thing."""


@dataclass(frozen=True, kw_only=True)
class SolvingOptions:
    """Of solving cameras."""

    threads: int | None = None
    """Of the CPU; None takes those of torch."""
    seed: int = 0
    """Of whatever is drawn."""


@dataclass(frozen=True)
class Solved:
    """A capture and how it was come by.

    Attributes:
        capture: upright, the object in [-1, 1]^3, Z up.
        trust: how far it is to be trusted; good or doubtful.
        facts: for the report, as JSON types.
    """

    capture: Capture
    trust: Trust
    facts: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class _Found:
    """An attempt's solution with its judgement."""

    way: str
    job: Job
    solution: Solution
    hull: JointHull | None
    trust: Trust
    groups: list[list[str]]


def solved(
    paths: list[Path],
    where: Path,
    folder: Path,
    options: SolvingOptions,
    progress: Progress,
    heard: Heard = unheard,
) -> Solved:
    """Solves the cameras of photographs of one object.

    Args:
        paths: of the photographs.
        where: they are from, for messages.
        folder: for masks, which the capture names; exists.
        progress: told at least every second; what it raises ends the solver's process.
        heard: told by which way each picture was cut out.
    Raises:
        InputImageError: too few pictures, or too few can be read.
        CameraError: no solution can be trusted; the line says what to do better.
        ArmError: pycolmap is not there, or has failed.
    """
    if len(paths) < FEWEST:
        raise InputImageError(f"{where}: {len(paths)} pictures without cameras are too few; {BETTER}")
    with tempfile.TemporaryDirectory(prefix="arm-cameras-") as name:
        pictures, colors = Path(name, "pictures"), Path(name, "colors")
        pictures.mkdir()
        colors.mkdir()
        copies, left_out = working_copies(paths, pictures, colors, part(progress, 0.0, 0.25))
        if len(copies) < FEWEST:
            reason = next(iter(left_out.items()), ("", ""))
            raise InputImageError(f"{where}: {len(copies)} of {len(paths)} pictures do ({': '.join(reason)}); {BETTER}")
        found = _best(copies, Path(name), options, part(progress, 0.25, 0.85))
        if found is None or found.trust.level == "wrong":
            raise CameraError(f"{where}: {_why_not(found, copies)}; {BETTER}")
        progress(0.85, "looking for the ground")
        by_name = {copy.name: copy for copy in copies}
        own = [by_name[name] for name in found.solution.names]
        stand = _stand(found, own, options.seed)
        for share in (part(progress, 0.85, 0.92), part(progress, 0.92, 0.99)):
            own = looked_at_again(own, colors, found.solution, stand, share)
            # Better masks tell better how large the object is, where its ground is, and whether the cameras fit them:
            # with that, what the pictures say together is clearer still.
            found = _with_masks(found, own, len(copies))
            stand = _stand(found, own, options.seed)
        capture = _capture(found.solution, stand, own, copies, folder, left_out)
    for copy in own:
        for way in copy.told:
            heard(copy.photograph.path.name, way)
    return Solved(capture, found.trust, _facts(found, stand, copies))


def _best(copies: list[WorkingCopy], folder: Path, options: SolvingOptions, progress: Progress) -> _Found | None:
    """The first attempt that is good, with nearly all pictures, else the best one; None where none solved anything."""
    best: _Found | None = None
    jobs = list(_jobs(copies, folder, options))
    for index, (way, job) in enumerate(jobs):
        share = part(progress, index / len(jobs), (index + 1) / len(jobs))
        match(job, part(share, 0.0, 0.7))
        for number, factor in enumerate(FACTORS[:1] if job.focal_is_known else FACTORS):
            fits, groups = solve(job, f"try-{number}", factor, part(share, 0.7, 0.9))
            if not fits:
                continue
            solution = _chosen(fits, job.focal_is_known)
            hull = _hull(solution, copies)
            trust = judged(solution, len(copies), hull)
            if _are_split(groups, copies):
                trust = replace(trust, level="wrong")
            found = _Found(way, job, solution, hull, trust, groups)
            if found.trust.level != "wrong":
                again = solve_again(job, solution, part(share, 0.9, 1.0))
                found = _Found(way, job, solution, hull, compared(found.trust, solution, again), groups)
            logger.info("%s, focal %s: %s", way, factor, found.trust)
            if best is None or found.trust.rank > best.trust.rank:
                best = found
            if found.trust.level == "good" and found.trust.measures["registered"] >= _NEARLY_ALL:
                return found
        if best is not None and best.trust.level == "doubtful" and best.hull is None:
            return best  # Without masks there is nothing that would tell the next one from it.
    return best


def _jobs(copies: list[WorkingCopy], folder: Path, options: SolvingOptions) -> Iterator[tuple[str, Job]]:
    """Where features are looked for, the likeliest first, each as a job with a folder of its own."""
    masked = sum(copy.mask is not None for copy in copies) >= _MASKED * len(copies)
    ways = ["object and ground", "whole picture", "object"] if masked else ["whole picture"]
    for index, way in enumerate(ways):
        own = folder / f"way-{index}"
        own.mkdir()
        regions = None if way == "whole picture" else write_regions(copies, own / "regions", way != "object")
        threads = options.threads or torch.get_num_threads()
        yield way, Job(own, folder / "pictures", regions, lenses_of(copies), threads, options.seed)


def _chosen(fits: list[Solution], focal_is_known: bool) -> Solution:
    """The solution whose lenses were set free, where they are still plausible; else the one where they were held."""
    held, free = fits[0], fits[-1]
    for before, after in zip(held.lenses, free.lenses, strict=True):
        change = abs(after.parameters[0] / before.parameters[0] - 1.0)
        if (focal_is_known and change > MOST_FOCAL_CHANGE) or abs(after.parameters[3]) > MOST_RADIAL:
            return held
    return free if len(free.points) >= 0.8 * len(held.points) else held


def _hull(solution: Solution, copies: list[WorkingCopy]) -> JointHull | None:
    """Of the masks of the pictures that have one; None where too few have."""
    masks = {copy.name: copy.mask for copy in copies if copy.mask is not None}
    rows = [row for row, name in enumerate(solution.names) if name in masks]
    if len(rows) < max(3, _MASKED * len(solution.names)):
        return None
    lenses = tuple(solution.lenses[row] for row in rows)
    return joint_hull(solution.w2c[rows], lenses, [masks[solution.names[row]] for row in rows])


def _with_masks(found: _Found, own: list[WorkingCopy], count: int) -> _Found:
    """What was found with the masks of `own` and their hull; of `count` pictures."""
    hull = _hull(found.solution, own)
    trust = judged(found.solution, count, hull)
    if "apart" in found.trust.measures:
        trust = apart(trust, found.trust.measures["apart"])
    # Masks that know the cameras cannot speak against them.
    return replace(found, hull=hull, trust=trust if trust.rank > found.trust.rank else found.trust)


def _stand(found: _Found, own: list[WorkingCopy], seed: int) -> Upright:
    masks = None
    if found.hull is not None:
        masks = [torch.zeros(copy.height, copy.width) if copy.mask is None else copy.mask for copy in own]
    return upright(found.solution, masks, found.hull, seed)


def _why_not(found: _Found | None, copies: list[WorkingCopy]) -> str:
    """What is wrong, in words."""
    if found is None:
        return "the pictures have nothing in common that could be matched; are they sharp, and of one object?"
    if _are_split(found.groups, copies):
        by_name = {copy.name: copy.photograph.path.name for copy in copies}
        first, second = (by_name[group[0]] for group in found.groups[:2])
        return f"the pictures fall into groups that do not match, as {first} and {second}; are they of one object?"
    return f"the cameras cannot be trusted: {'; '.join(found.trust.reasons)}"


def _are_split(groups: list[list[str]], copies: list[WorkingCopy]) -> bool:
    """Whether many pictures that the largest solution lacks make up another one."""
    return len(groups) > 1 and len(set(groups[1]) - set(groups[0])) >= _SECOND_GROUP * len(copies)


def _capture(
    solution: Solution,
    stand: Upright,
    own: list[WorkingCopy],
    copies: list[WorkingCopy],
    folder: Path,
    left_out: dict[str, str],
) -> Capture:
    """The solution in its upright frame, with the lenses of the photographs themselves."""
    posed = []
    for copy, lens, c2w in zip(own, solution.lenses, stand.c2w(solution.w2c), strict=True):
        mask = None
        if copy.mask is not None:
            mask = folder / copy.name
            Image.fromarray((copy.mask.clamp(0.0, 1.0) * 255.0).round().numpy().astype(np.uint8)).save(mask)
        way = copy.told[0] if copy.told else ""
        posed.append(PosedPhotograph(copy.photograph.path, c2w, _full_size(lens, copy), mask, way))
    without = {copy.photograph.path.name for copy in copies} - {copy.photograph.path.name for copy in own}
    reasons = dict.fromkeys(sorted(without), "its camera could not be solved: too little in common with the others")
    return Capture(tuple(posed), stand.moved(solution.points), left_out | reasons, stand.ground, solved=True)


def _full_size(lens: Lens, copy: WorkingCopy) -> Lens:
    """The lens of a copy at the size of its photograph."""
    width, height = copy.photograph.width, copy.photograph.height
    focal, x, y, *bend = lens.parameters
    across, down = width / lens.width, height / lens.height
    return Lens(lens.model, (focal * (across + down) / 2.0, x * across, y * down, *bend), width, height)


def _facts(found: _Found, stand: Upright, copies: list[WorkingCopy]) -> dict[str, Any]:
    """What report.json says of it."""
    return {
        "trust": found.trust.level,
        "doubts": list(found.trust.reasons),
        "pictures": len(copies),
        "solved": len(found.solution.names),
        "features": found.way,
        "up": "the mean of the cameras' own" if stand.ground is None else "the ground's plane",
        **{name: round(value, 4) for name, value in found.trust.measures.items()},
    }
