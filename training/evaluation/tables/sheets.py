"""Pictures of an evaluated object: input, prediction and truth side by side, every map, two lights."""

import shutil
from collections.abc import Sequence
from pathlib import Path

import torch
from PIL import Image
from torch import Tensor

from arm_blender.errors import ArmError
from arm_blender.graphics.color import composite, srgb_from_linear
from arm_blender.machine.files import whole_file

from ..trials.measure import HULL, MAPS, OURS, ObjectResult, Shown
from ..truth.truth import Appearance
from .contact_sheet import normal_picture, tiled

LARGE, ROWS = "large", "rows"
"""Folders of every object's pictures in full, and of its row on a front page."""

WORST = 3
"""Large pictures that are copied to where one sees them first."""

Cell = tuple[str, Tensor | None]


class Sheets:
    """Pictures on their way to a folder: `<id>.jpg`, `large/<id>.jpg`, and `rows/<id>.png` for a front page."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for part in (LARGE, ROWS):
            (folder / part).mkdir(parents=True, exist_ok=True)

    def add(self, name: str, shown: Shown) -> None:
        """The pictures of one object, at once."""
        _save(self.folder / f"{name}.jpg", object_sheet(shown))
        _save(self.folder / LARGE / f"{name}.jpg", large_sheet(shown))
        _save(self.folder / ROWS / f"{name}.png", front_row(shown))

    def has(self, name: str) -> bool:
        """Whether all pictures of an object are there."""
        places = (self.folder / f"{name}.jpg", self.folder / LARGE / f"{name}.jpg", self.folder / ROWS / f"{name}.png")
        return all(place.is_file() for place in places)

    def finish(self, results: Sequence[ObjectResult]) -> None:
        """Copies of the worst objects' large sheets."""
        for place, result in enumerate(sorted(results, key=lambda r: (quality(r), r.name))[:WORST], start=1):
            large = self.folder / LARGE / f"{result.name}.jpg"
            if large.is_file():
                shutil.copyfile(large, self.folder / f"worst-{place}.jpg")

    def front(self, names: Sequence[str], picture: Path) -> None:
        """The rows of some objects, one below the other.

        Raises:
            ArmError: there is no row of an object.
        """
        missing = [name for name in names if not (self.folder / ROWS / f"{name}.png").is_file()]
        if missing or not names:
            raise ArmError(
                f"--picture-of: no row of {', '.join(missing) or 'any object'}; evaluate what is named there"
            )
        rows = [Image.open(self.folder / ROWS / f"{name}.png").convert("RGB") for name in names]
        whole = Image.new("RGB", (rows[0].width, sum(row.height for row in rows)), "white")
        for place, row in enumerate(rows):
            whole.paste(row, (0, sum(above.height for above in rows[:place])))
        picture.parent.mkdir(parents=True, exist_ok=True)
        _save(picture, whole)


def quality(result: ObjectResult) -> float:
    """What objects are ranked by: dB of relighting inside of the object, or of albedo where nothing was lit."""
    maps = result.systems[OURS].maps
    return maps["relit" if "relit" in maps else "albedo"].psnr_in


def object_sheet(shown: Shown) -> Image.Image:
    """The inputs in the first row; then truth, ours and hull from two of the test views, a column per map."""
    count = len(shown.truth.tests.cameras)
    rows: list[list[Cell]] = [[(f"input {k}", picture) for k, picture in enumerate(_inputs(shown))]]
    rows[0] = _cropped(rows[0], shown)
    for view in (0, count // 2):
        rows += _rows(shown, view, ("truth", OURS, HULL))
    return tiled(rows, max(len(MAPS) + 1, len(rows[0])))


def large_sheet(shown: Shown) -> Image.Image:
    """Truth and ours from the test views, eight of them where there are more, at the views' own size."""
    tests = shown.truth.tests
    rows: list[list[Cell]] = []
    for view in range(0, len(tests.cameras), max(1, len(tests.cameras) // 8)):
        rows += _rows(shown, view, ("truth", OURS))
    return tiled(rows, len(MAPS) + 1, tests.cameras[0].width)


def front_row(shown: Shown, view: int = 0, tile: int = 128) -> Image.Image:
    """One input, then truth beside ours for every map."""
    row: list[Cell] = [("one of six inputs", _inputs(shown)[0])]
    for name in MAPS:
        for who, found in (("truth", shown.truth.tests), (OURS, shown.pictures.get(OURS))):
            row.append((f"{name}, {who}", _picture(found, name, view)))
    return tiled([_cropped(row, shown)], len(row), tile)


def _rows(shown: Shown, view: int, systems: Sequence[str]) -> list[list[Cell]]:
    """One row per system at one test view: its maps and its normals."""
    camera = shown.truth.tests.cameras[view]
    rows = []
    for name in systems:
        found = shown.truth.tests if name == "truth" else shown.pictures.get(name)
        shape = shown.shapes.get(name)
        row: list[Cell] = [(f"{name}, {what}, view {view}", _picture(found, what, view)) for what in MAPS]
        row.append((f"{name}, normals", None if shape is None else normal_picture(shape, camera)))
        rows.append(_cropped(row, shown))
    return rows


def _cropped(row: list[Cell], shown: Shown) -> list[Cell]:
    """The middle of the pictures, as large as any system's object in any view needs it."""
    side = shown.truth.tests.alpha.shape[-1]
    alphas = torch.cat([found.alpha for found in (shown.truth.tests, *shown.pictures.values())])
    alphas = torch.cat([alphas.amax(dim=(0, 1))[None], shown.views.images[:, 3]]).amax(dim=0)
    away = (torch.nonzero(alphas > 0.0) + 0.5 - side / 2).abs().amax() if bool((alphas > 0.0).any()) else side / 2
    half = min(side // 2, int(1.05 * float(away)) + 1)
    window = slice(side // 2 - half, side // 2 + half)
    return [(caption, None if picture is None else picture[:, window, window]) for caption, picture in row]


def _picture(found: Appearance | None, name: str, view: int) -> Tensor | None:
    """(3, N, N) on white; None where it was not rendered."""
    if found is None or (values := getattr(found, name)) is None:
        return None
    return composite(values[view].expand(3, -1, -1), found.alpha[view], 1.0)


def _inputs(shown: Shown) -> Tensor:
    """(V, 3, N, N) sRGB on white, at most six."""
    images = shown.views.images[:6]
    return composite(srgb_from_linear(images[:, :3]), images[:, 3:], 1.0)


def _save(path: Path, picture: Image.Image) -> None:
    with whole_file(path) as temporary:
        picture.save(temporary, quality=88)
