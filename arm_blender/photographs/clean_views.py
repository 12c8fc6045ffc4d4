"""From posed photographs to a folder of clean views: the best of them, without distortion, cut out, around the object.

`views.load_views` reads the folder. Photographs are held in memory one at a time.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from ..errors import InputImageError
from ..graphics.cameras import Camera
from ..knobs import MOST_VIEWS, USUAL_VIEWS
from ..machine.files import distinct, replace_folder, staging
from ..progress import Progress, part, silent
from ..views import LeaveOut
from ..views.foreground import Heard, unheard
from ..views.image_io import write_png
from ..views.preprocess import MAXIMUM_SIDE, MINIMUM_SIDE
from ..views.transforms_json import TRANSFORMS, write_transforms
from .capture import Capture, PosedPhotograph
from .cut_out import CutOut, PaintedMask, cut_out, quick_look
from .framing import Window
from .masks.comparing import compare
from .painted import PHOTOGRAPH, UNUSED, begin
from .selection import (
    BLURRED,
    ENOUGH,
    Candidate,
    beside_neighbours,
    directions_from,
    next_view,
    object_center,
    sharpness,
)
from .solved import write_solved
from .undistort import RayTable, place_of, ray_tables

PIXELS = 2**24
"""Of all views together: 16 of 1024 pixels a side, 256 MiB in memory, and the pipeline holds them more than once."""

KNOWN = "known"
"""Field of a frame: left, top, right, bottom of the pixels that its photograph has; beyond, nothing is known."""


@dataclass(frozen=True)
class CleaningOptions:
    """Of the views that are made."""

    views: int = USUAL_VIEWS
    """At most. Fewer leave parts unseen; more than `MOST_VIEWS` no pipeline reads."""
    side: int | None = None
    """Pixels of each; None takes as many as `PIXELS` allows and the photographs have, at most `MAXIMUM_SIDE`."""

    def __post_init__(self) -> None:
        if not 1 <= self.views <= MOST_VIEWS or (
            self.side is not None and not MINIMUM_SIDE <= self.side <= MAXIMUM_SIDE
        ):
            raise ValueError(f"1 to {MOST_VIEWS} views of {MINIMUM_SIDE} to {MAXIMUM_SIDE} pixels, got {self}")

    def side_of(self, count: int, largest: int) -> int:
        """Pixels a side of the views of `count` photographs, whose shorter sides are at most `largest`."""
        allowed = int((PIXELS / min(count, self.views)) ** 0.5)
        return self.side or max(MINIMUM_SIDE, min(MAXIMUM_SIDE, allowed, largest) // 8 * 8)


def clean_views(
    capture: Capture,
    folder: Path,
    options: CleaningOptions | None = None,
    progress: Progress = silent,
    left_out: LeaveOut = unheard,
    heard: Heard = unheard,
) -> Path:
    """Writes the views of a capture: PNGs with alpha and transforms.json, whole or not at all.

    Args:
        capture: at least one photograph.
        folder: is made where it is missing. Views that were made here before go; what else is in it stays. A mask that
            was painted on such a view and lies here as `masks/NAME.png` goes before every other way to find the object.
            So may one be on a picture that became no view because of its mask; `UNUSED` has those.
        options: how many, and how large.
        progress: is told each photograph; what it raises leaves `folder` as it was.
        left_out: is told each picture that became no view, and why.
        heard: is told how each view was cut out.
    Returns:
        `folder`.
    Raises:
        InputImageError: no photograph can be read, or in none an object is found; or a painted mask does not fit.
        CameraError: a lens sees nothing.
        ArmError: a lens bends, and pycolmap is not there.
        OutputError: the folder cannot be written.
    """
    if not capture.photographs:
        raise InputImageError(f"{folder}: none of the pictures has a camera; give pictures that were posed")
    options = options or CleaningOptions()
    for name, reason in capture.left_out.items():
        left_out(name, reason)
    tables = ray_tables((photograph.lens for photograph in capture.photographs), part(progress, 0.0, 0.05))
    names = distinct(photograph.path.stem for photograph in capture.photographs)
    with staging(folder.parent) as stage:
        made = stage / folder.name
        older = begin(folder, made)
        cleaning = _Cleaning(capture.photographs, names, tables, made, options, older)
        cleaning.examine(part(progress, 0.05, 0.35))
        chosen = cleaning.choose(part(progress, 0.35, 0.95))
        if capture.solved:  # Only then the object is known to lie in the box.
            chosen = cleaning.compare(chosen, capture.ground, left_out, part(progress, 0.95, 1.0))
        cleaning.write(chosen, capture)
        sharp = {capture.photographs[index].path.name: one.sharpness for index, one in cleaning.candidates.items()}
        write_solved(capture, made, sharp)
        for index in chosen:
            heard(capture.photographs[index].path.name, cleaning.made[index].way)
        for index, reason in sorted(cleaning.reasons.items()):
            left_out(capture.photographs[index].path.name, reason)
        replace_folder(folder, made, stage / "older")
    return folder


@dataclass(frozen=True)
class _Made:
    """What is kept of a view once its picture is in its file; as `CutOut`."""

    window: Window
    known: tuple[int, int, int, int]
    cut: bool
    way: str


@dataclass
class _Cleaning:
    """The work on one capture.

    Attributes:
        photographs: of the capture.
        names: of their views, without suffix.
        tables: of their lenses.
        folder: where the views go.
        options: how many, and how large.
        painted: masks by the names of views.
        candidates: of photographs that can be read, by their index.
        made: of views, by the index of the photograph.
        reasons: why a photograph is no view, by its index.
        side: pixels of a view, once the photographs have been examined.
    """

    photographs: tuple[PosedPhotograph, ...]
    names: list[str]
    tables: dict[Any, RayTable]
    folder: Path
    options: CleaningOptions
    painted: dict[str, PaintedMask]
    candidates: dict[int, Candidate] = field(default_factory=dict)
    made: dict[int, _Made] = field(default_factory=dict)
    reasons: dict[int, str] = field(default_factory=dict)
    side: int = 0

    def examine(self, progress: Progress) -> None:
        """Measures how sharp each photograph shows the object, and from where.

        Raises:
            InputImageError: none can be read; that of the first.
        """
        c2ws = torch.stack([photograph.c2w for photograph in self.photographs])
        center = object_center(c2ws)
        measured: dict[int, float] = {}
        largest = 0
        first: InputImageError | None = None
        for index, photograph in enumerate(self.photographs):
            progress(index / len(self.photographs), f"looking at {photograph.path.name}")
            try:
                image = quick_look(photograph.path, photograph.lens)
            except InputImageError as error:
                first, self.reasons[index] = first or error, str(error)
                continue
            largest = max(largest, min(photograph.lens.width, photograph.lens.height))
            measured[index] = sharpness(image, place_of(center, photograph.c2w, self.tables[photograph.lens]))
        if not measured and first is not None:
            raise first
        self.side = self.options.side_of(len(measured), largest)
        directions = directions_from(center, c2ws[list(measured)])
        compared = beside_neighbours(list(measured.values()), directions)
        for index, direction, sharp in zip(measured, directions, compared, strict=True):
            self.candidates[index] = Candidate(direction, sharp)

    def choose(self, progress: Progress) -> list[int]:
        """The photographs that become views; their pictures are written.

        Raises:
            InputImageError: in none an object is found; that of the first.
        """
        count, chosen = self.options.views, list[int]()
        sharp = [index for index, candidate in self.candidates.items() if candidate.sharpness >= BLURRED]
        blurred = [index for index in self.candidates if index not in sharp]
        cut: list[int] = []
        first: InputImageError | None = None
        while (sharp and len(chosen) < count) or (blurred and len(chosen) + len(cut) < min(ENOUGH, count)):
            pool = sharp or blurred
            index = next_view(self.candidates, chosen, pool)
            pool.remove(index)
            share = 1.0 / count
            done = min(len(self.made), count - 1) * share
            try:
                self._make(index, part(progress, done, done + share))
            except InputImageError as error:
                first, self.reasons[index] = first or error, str(error)
                continue
            (cut if self.made[index].cut else chosen).append(index)
        while cut and len(chosen) < count:  # Better than nothing: what is beyond the border is unknown, not empty.
            chosen.append(next_view(self.candidates, chosen, cut))
            cut.remove(chosen[-1])
        if not chosen:
            raise first or InputImageError(f"{self.photographs[0].path}: no view came of it")
        self.reasons |= dict.fromkeys(cut, "the border of the picture cuts the object")
        self.reasons |= dict.fromkeys(sharp, f"{len(chosen)} others see the object from all around")
        for index in blurred:
            self.reasons[index] = f"blurred: {self.candidates[index].sharpness:.2f} of the sharpness of those beside it"
        return sorted(chosen)

    def _make(self, index: int, progress: Progress) -> None:
        """Writes the view of a photograph."""
        photograph, name = self.photographs[index], self.names[index]
        view: CutOut = cut_out(photograph, self.tables[photograph.lens], self.side, self.painted.get(name), progress)
        write_png(self.folder / f"{name}.png", view.image, srgb=True)
        self.made[index] = _Made(view.window, view.known, view.cut, view.way)

    def compare(self, chosen: list[int], ground: float | None, left_out: LeaveOut, progress: Progress) -> list[int]:
        """The chosen photographs less those whose masks the others refuse; masks are mended, with a word."""
        pictures = [self.folder / f"{self.names[index]}.png" for index in chosen]
        made = [self.made[index] for index in chosen]
        known, ways = [view.known for view in made], [view.way for view in made]
        words, dropped = compare(pictures, self._cameras(chosen), known, ways, progress, ground)
        for place, why in words.items():
            if place in dropped:
                self.reasons[chosen[place]] = why
            else:
                left_out(f"the mask of {self.photographs[chosen[place]].path.name} as it was found", why)
        return [index for place, index in enumerate(chosen) if place not in dropped]

    def _cameras(self, chosen: list[int]) -> list[Camera]:
        return [
            Camera(self.photographs[index].c2w.float(), self.made[index].window.K.float(), self.side, self.side)
            for index in chosen
        ]

    def write(self, chosen: list[int], capture: Capture) -> None:
        """Writes transforms.json of the `chosen` views, and `UNUSED` of the others whose pictures were made."""
        others = sorted(self.made.keys() - set(chosen))
        for name, indices in ((TRANSFORMS, chosen), (UNUSED, others)) if others else ((TRANSFORMS, chosen),):
            fields = [
                {KNOWN: list(self.made[index].known), PHOTOGRAPH: self.photographs[index].path.name}
                for index in indices
            ]
            pictures, cameras = [f"{self.names[index]}.png" for index in indices], self._cameras(indices)
            ground, exposed = capture.ground, capture.varying_exposure
            write_transforms(self.folder / name, pictures, cameras, None, fields, ground, exposed)
