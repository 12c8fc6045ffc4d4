"""Photographs without cameras to a capture: the object stands upright in a box, its masks are those of all pictures."""

import tempfile
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
from .attempts import COLORS, PICTURES, Attempt, are_split, best_attempt
from .standing import Upright
from .trust import FEWEST, Trust, seen_around
from .working_copies import WorkingCopy, working_copies

BETTER = "give 20 pictures or more from all around, each showing most of what the one before it shows; "
BETTER += "put a sheet of newspaper under the object, leave it where it is, and do not zoom"
"""How to take pictures that can be solved."""

_LOOKS = 2
"""At all pictures together: the first tells better where the object is, and what is its ground."""


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
        work = Path(name)
        pictures, colors = work / PICTURES, work / COLORS
        pictures.mkdir()
        colors.mkdir()
        copies, left_out = working_copies(paths, pictures, colors, part(progress, 0.0, 0.25))
        if len(copies) < FEWEST:
            reason = next(iter(left_out.items()), ("", ""))
            raise InputImageError(f"{where}: {len(copies)} of {len(paths)} pictures do ({': '.join(reason)}); {BETTER}")
        threads = options.threads or torch.get_num_threads()
        found = best_attempt(copies, work, threads, options.seed, part(progress, 0.25, 0.85))
        if found is None or found.trust.level == "wrong":
            raise CameraError(f"{where}: {_why_not(found, copies)}; {BETTER}")
        for look in range(found.looks, _LOOKS):
            share = part(progress, 0.85 + 0.14 * look / _LOOKS, 0.85 + 0.14 * (look + 1) / _LOOKS)
            found = found.looked_again(work, options.seed, share)
        stand = found.standing(options.seed)
        trust = seen_around(found.trust, stand.c2w(found.solution.w2c)[:, :3, 3])
        found = replace(found, trust=trust)
        capture = _capture(found, stand, copies, folder, left_out)
    for copy in found.copies:
        for way in copy.told:
            heard(copy.photograph.path.name, way)
    return Solved(capture, found.trust, _facts(found, stand, copies))


def _why_not(found: Attempt | None, copies: list[WorkingCopy]) -> str:
    """What is wrong, in words."""
    if found is None:
        return "the pictures have nothing in common that could be matched; are they sharp, and of one object?"
    if are_split(found.groups, len(copies)):
        by_name = {copy.name: copy.photograph.path.name for copy in copies}
        first, second = (by_name[group[0]] for group in found.groups[:2])
        return f"the pictures fall into groups that do not match, as {first} and {second}; are they of one object?"
    return f"the cameras cannot be trusted: {'; '.join(found.trust.reasons)}"


def _capture(
    found: Attempt, stand: Upright, copies: list[WorkingCopy], folder: Path, left_out: dict[str, str]
) -> Capture:
    """The solution in its upright frame, with the lenses of the photographs themselves."""
    own, solution = found.copies, found.solution
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


def _facts(found: Attempt, stand: Upright, copies: list[WorkingCopy]) -> dict[str, Any]:
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
