"""`python -m training sweep`: error against run time over grids and face budgets.

Each combination is run on the same objects. The seconds of the unwrapping stand beside those of the geometry, because
that is what a larger face budget really costs.
"""

import argparse
import csv
import io
import itertools
import logging
import time
from contextlib import suppress
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import torch

from arm_blender.config import QUALITIES, Settings
from arm_blender.errors import EmptyMeshError
from arm_blender.uv.unwrap import UnwrapConfig, unwrap

from .evaluate import FAILED, add_object_arguments, reconstruct
from .geometry import compare
from .objects import EvaluationObject, evaluation_objects
from .results import markdown_table, paragraphs, write_text

logger = logging.getLogger(__name__)

GRIDS = (64, 96, 128, 192, 256)
FACES = (5_000, 10_000, 20_000, 40_000)


@dataclass(frozen=True)
class SweepRow:
    """Means over the objects of one combination; the field names are the columns of the CSV."""

    grid: int
    face_budget: int
    faces: float
    f_coarse: float
    f_fine: float
    chamfer: float
    shape_seconds: float
    unwrap_seconds: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training sweep`."""
    add_object_arguments(parser)
    parser.add_argument("--grids", type=int, nargs="*", default=GRIDS, help="samples a side")
    parser.add_argument("--faces", type=int, nargs="*", default=FACES, help="face budgets")
    parser.add_argument("--output", type=Path, default=Path("docs/error-and-time.md"), help="the CSV goes beside it")


def run(args: argparse.Namespace) -> int:
    """Run every combination, and those of the quality levels, and write the table and the CSV."""
    objects = evaluation_objects(args.views, args.data, tuple(args.set), args.split)[: args.limit]
    chosen = set(itertools.product(args.grids, args.faces)) | {
        (level.grid, level.faces) for level in QUALITIES.values()
    }
    with suppress(EmptyMeshError):
        reconstruct(objects[0].views(), _settings(args, *min(chosen)))  # Loads the weights, untimed.
    rows = []
    for grid, faces in sorted(chosen):
        rows.append(combination(objects, _settings(args, grid, faces), args.seed))
        logger.info("%s", rows[-1])
    write_text(args.output.with_suffix(".csv"), csv_text(rows))
    write_text(args.output, document(rows, len(objects), args.command))
    print(args.output)
    return 0


def combination(objects: list[EvaluationObject], settings: Settings, seed: int) -> SweepRow:
    """Means over the objects at one grid and one face budget, which `settings` hold; without a surface one fails."""
    totals = torch.zeros(6, dtype=torch.float64)
    for item in objects:
        views = item.views()
        start = time.perf_counter()
        try:
            mesh = reconstruct(views, settings)
        except EmptyMeshError as error:
            logger.warning("%s: %s", item.name, error)
            totals += torch.tensor([0.0, *astuple(FAILED), time.perf_counter() - start, 0.0], dtype=torch.float64)
            continue
        shaped = time.perf_counter()
        unwrap(mesh, UnwrapConfig())
        unwrapped = time.perf_counter()
        scores = compare(mesh, item.truth(), seed=seed)
        totals += torch.tensor(
            [len(mesh.faces), *astuple(scores), shaped - start, unwrapped - shaped], dtype=torch.float64
        )
    return SweepRow(settings.grid, settings.faces, *(totals / len(objects)).tolist())


def csv_text(rows: list[SweepRow]) -> str:
    """The rows as CSV, with a header."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow([field.name for field in fields(SweepRow)])
    writer.writerows([astuple(row) for row in rows])
    return file.getvalue()


def document(rows: list[SweepRow], objects: int, command: str) -> str:
    """The Markdown document: what was measured, the table, and the command that made it."""
    levels = {(level.grid, level.faces): name for name, level in QUALITIES.items()}
    header = ["quality", "grid", "face budget", "faces", "F@0.1", "F@0.02", "CD", "geometry s", "unwrap s", "sum s"]
    table = markdown_table(
        header,
        [
            [
                levels.get((r.grid, r.face_budget), ""),
                r.grid,
                r.face_budget,
                round(r.faces),
                r.f_coarse,
                r.f_fine,
                f"{r.chamfer:.4f}",
            ]
            + [f"{seconds:.1f}" for seconds in (r.shape_seconds, r.unwrap_seconds, r.shape_seconds + r.unwrap_seconds)]
            for r in rows
        ],
    )
    return paragraphs(
        "# Error against run time",
        f"Means over {objects} objects, on {torch.get_num_threads()} CPU threads. *Grid*: samples a side of the "
        "density. *Face budget*: what the mesh is decimated to. F-scores and the Chamfer distance (CD) compare 100,000 "
        "points of each surface with the truth, whose longest side is 2. *Geometry*: from posed views to the decimated "
        "mesh; *unwrap*: the atlas of that mesh.",
        table,
        f"Made by `{command}`; the same numbers stand in the CSV beside this file.",
    )


def _settings(args: argparse.Namespace, grid: int, faces: int) -> Settings:
    return Settings(preset=args.preset, device=args.device, grid=grid, faces=faces)
