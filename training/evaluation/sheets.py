"""Pictures of an evaluated object: input, prediction and truth side by side, every map, two lights."""

from collections.abc import Sequence

from PIL import Image
from torch import Tensor

from arm_blender.graphics.color import composite, srgb_from_linear

from .contact_sheet import normal_picture, tiled
from .measure import HULL, MAPS, OURS, Shown
from .truth import Appearance

Cell = tuple[str, Tensor | None]


def object_sheet(shown: Shown) -> Image.Image:
    """The inputs in the first row; then truth, ours and hull from two of the test views, a column per map."""
    count = len(shown.truth.tests.cameras)
    rows: list[list[Cell]] = [[(f"input {k}", picture) for k, picture in enumerate(_inputs(shown))]]
    for view in (0, count // 2):
        rows += _rows(shown, view, ("truth", OURS, HULL))
    return tiled(rows, max(len(MAPS) + 1, len(rows[0])))


def large_sheet(shown: Shown) -> Image.Image:
    """Truth and ours from every test view, at the views' own size."""
    tests = shown.truth.tests
    rows: list[list[Cell]] = []
    for view in range(len(tests.cameras)):
        rows += _rows(shown, view, ("truth", OURS))
    return tiled(rows, len(MAPS) + 1, tests.cameras[0].width)


def front_sheet(shown: Sequence[Shown], view: int = 0, tile: int = 128) -> Image.Image:
    """A row per object for the front page: one input, then truth beside ours for every map."""
    rows: list[list[Cell]] = []
    for item in shown:
        row: list[Cell] = [("one of six inputs", _inputs(item)[0])]
        for name in MAPS:
            row += [
                (f"{name}, {who}", _picture(found, name, view))
                for who, found in (("truth", item.truth.tests), (OURS, item.pictures.get(OURS)))
            ]
        rows.append(row)
    return tiled(rows, 1 + 2 * len(MAPS), tile)


def _rows(shown: Shown, view: int, systems: Sequence[str]) -> list[list[Cell]]:
    """One row per system at one test view: its maps and its normals."""
    camera = shown.truth.tests.cameras[view]
    rows = []
    for name in systems:
        found = shown.truth.tests if name == "truth" else shown.pictures.get(name)
        shape = shown.shapes.get(name)
        row: list[Cell] = [(f"{name}, {what}, view {view}", _picture(found, what, view)) for what in MAPS]
        rows.append([*row, (f"{name}, normals", None if shape is None else normal_picture(shape, camera))])
    return rows


def _picture(found: Appearance | None, name: str, view: int) -> Tensor | None:
    """(3, N, N) on white; None where it was not rendered."""
    values = None if found is None else getattr(found, name)
    if values is None:
        return None
    return composite(values[view].expand(3, -1, -1), found.alpha[view], 1.0)


def _inputs(shown: Shown) -> Tensor:
    """(V, 3, N, N) sRGB on white, at most six."""
    images = shown.views.images[:6]
    return composite(srgb_from_linear(images[:, :3]), images[:, 3:], 1.0)
