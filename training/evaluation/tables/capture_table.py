"""`python -m training evaluate --captures`: photographs of known objects, from their pictures to the table."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageOps

from arm_blender.machine.files import whole_file, write_json

from ...documents import markdown_table, paragraphs, write_text
from ..trials.capture_trial import DOUBTFUL, REFUSED, CaptureResult
from ..trials.measure import SystemResult
from ..truth.captured import CapturedObject
from ..truth.truth import Appearance
from .contact_sheet import CAPTION, TILE, tiled
from .report_text import finite

SHOWN = 4
"""Photographs of a capture on its sheet."""

SHEET_ROWS = 4
"""Of a sheet: photographs, albedo, lit and relit."""

ABREAST = 12
"""Captures side by side in an overview."""

MOSTLY = 0.9
"""Of the pictures, the share that has to be right for a capture to count as solved."""


def summary(results: Sequence[CaptureResult], command: str) -> str:
    """Markdown: what captures reach together, and each of them."""
    sound = [result for result in results if result.spoilt is None]
    made = [result for result in sound if result.system is not None]
    right = [result.good / result.pictures for result in sound]
    rows = [
        ("pictures with a right camera, mean", f"{np.mean(right):.1%}" if right else "-"),
        (
            f"captures with {MOSTLY:.0%} right cameras or more",
            f"{sum(share >= MOSTLY for share in right)} of {len(sound)}",
        ),
        ("wrong solutions passed off as right", f"{sum(r.wrong_in_silence for r in results)} of {len(results)}"),
        ("F@0.1", _mean([_shape(r.system)[0] for r in made], 3)),
        ("F@0.02", _mean([_shape(r.system)[1] for r in made], 3)),
        ("Chamfer distance", _mean([_shape(r.system)[2] for r in made], 3)),
        ("albedo inside, dB", _mean([_albedo(r.system) for r in made], 1)),
        ("the same from six true views, dB", _mean([_albedo(r.posed) for r in made], 1)),
        ("seconds, the longest", f"{max((r.answer.seconds for r in results), default=0.0):.0f}"),
        ("peak memory, the highest, MiB", f"{max((r.answer.memory for r in results), default=0.0):,.0f}"),
    ]
    return paragraphs(
        f"{len(sound)} captures and {len(results) - len(sound)} that are spoilt on purpose; shapes are brought onto "
        "the true ones by the cameras' centres alone.",
        markdown_table(("what", "found"), rows),
        markdown_table(
            ("capture", "pictures", "right cameras", "worst centre", "F@0.1", "F@0.02", "albedo dB", "s", "said"),
            [_row(result) for result in results],
        ),
        f"Made by `{command}`.",
    )


def write_results(folder: Path, results: Sequence[CaptureResult], command: str) -> None:
    """`captures.md` and `captures.json`."""
    write_text(folder / "captures.md", paragraphs("# Captures", summary(results, command)))
    write_json(folder / "captures.json", {"command": command, "captures": [finite(asdict(r)) for r in results]})


def save_sheet(path: Path, capture: CapturedObject, found: Appearance | None) -> None:
    """Some of the photographs; below, where there is an asset, its albedo and what it is lit and relit."""
    rows: list[list[tuple[str, torch.Tensor | None]]] = [[("photograph", image) for image in _photographs(capture)]]
    if found is not None:
        for name in ("albedo", "lit", "relit"):
            images = getattr(found, name)
            if images is not None:
                white = images * found.alpha + 1.0 - found.alpha
                rows.append([(name, image) for image in white[:SHOWN]])
    with whole_file(path) as temporary:
        tiled(rows, SHOWN).save(temporary, format="JPEG", quality=90)


def save_overview(path: Path, sheets: Sequence[Path]) -> None:
    """A column of each of the `sheets`, as `save_sheet` writes them, side by side: half as large, a dozen in a row."""
    rows = -(-len(sheets) // ABREAST)
    width, height = TILE // 2, (TILE + CAPTION) * SHEET_ROWS // 2
    found = Image.new("RGB", (ABREAST * width, rows * height), "white")
    for index, sheet in enumerate(sheets):
        with Image.open(sheet) as image:
            column = image.crop((TILE, 0, 2 * TILE, image.height))
        column = column.resize((width, column.height // 2), Image.Resampling.LANCZOS)
        found.paste(column, (index % ABREAST * width, index // ABREAST * height))
    with whole_file(path) as temporary:
        found.save(temporary, format="JPEG", quality=88)


def _photographs(capture: CapturedObject) -> list[torch.Tensor]:
    """(3, TILE, TILE) sRGB of some pictures from all around, cropped to squares."""
    paths = sorted(capture.photographs.iterdir())
    chosen = [paths[index * len(paths) // SHOWN] for index in range(min(SHOWN, len(paths)))]
    squares = [np.array(ImageOps.fit(Image.open(path).convert("RGB"), (TILE, TILE))) for path in chosen]
    return [torch.from_numpy(square).permute(2, 0, 1).float() / 255.0 for square in squares]


def _row(result: CaptureResult) -> tuple[object, ...]:
    said = result.answer.said + (f": {result.answer.words}" if result.answer.said in (DOUBTFUL, REFUSED) else "")
    worst = f"{max(result.centers.values()):.2%}" if result.centers else "-"
    scores: tuple[object, ...] = ("-", "-", "-")
    if result.system is not None:
        scores = (*(f"{value:.3f}" for value in _shape(result.system)[:2]), f"{_albedo(result.system):.1f}")
    seconds = f"{result.answer.seconds:.0f}"
    return (result.name, result.pictures, result.good, worst, *scores, seconds, said)


def _shape(system: SystemResult | None) -> tuple[float, float, float]:
    assert system is not None and system.geometry is not None
    return system.geometry.f_coarse, system.geometry.f_fine, system.geometry.chamfer


def _albedo(system: SystemResult | None) -> float:
    assert system is not None
    return system.maps["albedo"].psnr_in


def _mean(values: Sequence[float], digits: int) -> str:
    return f"{np.mean(values):.{digits}f}" if values else "-"
