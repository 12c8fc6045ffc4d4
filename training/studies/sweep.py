"""`python -m training sweep`: error against run time, each knob in turn, and the Pareto front of all that was run.

Each point runs the whole pipeline on the same objects; around the quality level `balanced` one knob is turned at a
time, and the quality levels themselves are points as well. `python -m training quality-levels` hands those on to
Blender's panel.
"""

import argparse
import csv
import io
import logging
import math
from collections.abc import Iterator
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path
from typing import get_args

import torch

from arm_blender import pipeline
from arm_blender.commands.progress_line import Counted
from arm_blender.config import QUALITIES, Settings
from arm_blender.errors import ArmError, EmptyMeshError
from arm_blender.knobs import QualityName
from arm_blender.quality_levels import STAGES

from ..documents import markdown_table, paragraphs, write_text
from ..evaluation.scores.geometry import FAILED, compare
from ..evaluation.scores.rerender import rerender_psnr
from ..evaluation.trials.trial import add_object_arguments
from ..evaluation.truth.objects import EvaluationObject, evaluation_objects
from .figures import panels

logger = logging.getLogger(__name__)

GRIDS, FACES, TEXTURES, VIEWS = (48, 64, 128, 192, 256), (2_000, 5_000, 20_000, 40_000), (256, 512, 2048), (1, 2, 4)
ROUNDS = (0, 1, 3)
INPUTS = 6

REPEATS = 2
"""Runs of each point on each object, of which the shortest time of each stage counts."""

SECONDS_NOISE, CHAMFER_NOISE, PSNR_NOISE = 0.15, 5e-4, 0.1
"""Differences between two points that mean nothing: a share of the seconds, of which a busy machine takes more or
less, Chamfer distance, dB. `balanced` is run a second time at the end, to be compared with."""


@dataclass(frozen=True)
class Point:
    """One combination of knobs. `label` says which quality level it is, or which knob is turned."""

    label: str
    settings: Settings
    views: int = INPUTS


@dataclass(frozen=True)
class SweepRow:
    """Means over the objects at one point; the field names are the columns of the CSV.

    Attributes:
        rounds: of the refinement.
        psnr: dB, of the baked colour rendered into all six views, those that were not given among them.
        shape_seconds, unwrap_seconds, appearance_seconds: of the pipeline's stages.
    """

    label: str
    grid: int
    face_budget: int
    texture_size: int
    rounds: int
    views: int
    faces: float
    f_coarse: float
    f_fine: float
    chamfer: float
    angle: float
    psnr: float
    shape_seconds: float
    unwrap_seconds: float
    appearance_seconds: float

    @property
    def seconds(self) -> float:
        """Of all stages."""
        return self.shape_seconds + self.unwrap_seconds + self.appearance_seconds


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training sweep`."""
    add_object_arguments(parser)
    parser.add_argument("--grids", type=int, nargs="*", default=GRIDS, help="samples a side")
    parser.add_argument("--faces", type=int, nargs="*", default=FACES, help="face budgets")
    parser.add_argument("--textures", type=int, nargs="*", default=TEXTURES, help="largest texels a side")
    parser.add_argument("--rounds", type=int, nargs="*", default=ROUNDS, help="of the refinement")
    parser.add_argument("--counts", type=int, nargs="*", default=VIEWS, help="numbers of views")
    parser.add_argument("--output", type=Path, default=Path("docs/error-and-time.md"), help="the CSV goes beside it")
    parser.add_argument("--plot", type=Path, default=Path("docs/images/error-and-time.png"))


def run(args: argparse.Namespace) -> int:
    """Run every point, and write the table, the CSV and the plot; the CSV grows with every point."""
    objects = evaluation_objects(args.views, args.data, tuple(args.set or ["gso"]), args.split)[: args.limit]
    chosen = list(points(args))
    measure(objects[:1], chosen[0], args.seed)  # Loads the weights, untimed.
    rows, count = list[SweepRow](), Counted(len(chosen), logger.info)
    for point in chosen:
        rows.append(measure(objects, point, args.seed))
        count(str(rows[-1]))
        write_text(args.output.with_suffix(".csv"), csv_text(rows))
    write_text(args.output, document(rows, len(objects), args.command, args.plot.relative_to(args.output.parent)))
    plot(rows, args.plot)
    print(args.output)
    return 0


def points(args: argparse.Namespace) -> Iterator[Point]:
    """The quality levels, every knob of `balanced` turned by itself, and `balanced` once more."""
    base = Settings(preset=args.preset, device=args.device, seed=args.seed)
    for level in get_args(QualityName):
        yield Point(level, replace(base, quality=level))
    for name, values in (
        ("grid", args.grids),
        ("faces", args.faces),
        ("texture_size", args.textures),
        ("refinement", args.rounds),
    ):
        yield from (Point(name.replace("_", " "), replace(base, **{name: value})) for value in values)
    yield from (Point("views", base, count) for count in args.counts)
    yield Point(f"{base.quality} again", base)


def measure(objects: list[EvaluationObject], point: Point, seed: int) -> SweepRow:
    """Means over the objects at one point; an object without a surface counts as failed."""
    totals = torch.zeros(6 + len(STAGES), dtype=torch.float64)
    for item in objects:
        views = item.views()
        if len(views.cameras) != INPUTS:
            raise ArmError(f"{item.folder}: {len(views.cameras)} views; a sweep takes {INPUTS}")
        try:
            runs = [pipeline.generate(views.only(spread(point.views)), point.settings) for _ in range(REPEATS)]
        except EmptyMeshError as error:
            logger.warning("%s: %s", item.name, error)
            totals += torch.tensor([0.0, *astuple(FAILED), math.nan, *([0.0] * len(STAGES))], dtype=torch.float64)
            continue
        asset = runs[0][0]
        scores = compare(asset.mesh, item.truth(), seed=seed)
        seconds = [min(report.seconds[stage] for _, report in runs) for stage in STAGES]
        numbers = [len(asset.mesh.faces), *astuple(scores), rerender_psnr(asset, views), *seconds]
        totals += torch.tensor(numbers, dtype=torch.float64)
    level = point.settings.resolved
    return SweepRow(
        point.label,
        level.grid,
        level.faces,
        level.texture_size,
        level.refinement,
        point.views,
        *(totals / len(objects)).tolist(),
    )


def spread(count: int) -> list[int]:
    """Indices of `count` of the six views, as far around the object from one another as can be."""
    return sorted({round(i * INPUTS / count) for i in range(count)})


def pareto(rows: list[SweepRow], error: str) -> list[SweepRow]:
    """The rows that no other row beats both in seconds and in `error` (a field, smaller is better), fastest first."""
    front: list[SweepRow] = []
    for row in sorted(rows, key=lambda r: (r.seconds, getattr(r, error))):
        if not front or getattr(row, error) < getattr(front[-1], error):
            front.append(row)
    return front


def unbeaten(rows: list[SweepRow]) -> list[SweepRow]:
    """The Pareto front of seconds, Chamfer distance and PSNR at once, but for noise; fastest first.

    A row beats another that is worse in one of them, and better in none, by more than two runs of one point differ.
    """

    def gains(a: SweepRow, b: SweepRow) -> tuple[bool, bool, bool]:
        """In which of the three `a` is better."""
        return (
            a.seconds < (1.0 - SECONDS_NOISE) * b.seconds,
            a.chamfer < b.chamfer - CHAMFER_NOISE,
            a.psnr > b.psnr + PSNR_NOISE,
        )

    return sorted(
        (b for b in rows if not any(any(gains(a, b)) and not any(gains(b, a)) for a in rows)), key=lambda r: r.seconds
    )


def csv_text(rows: list[SweepRow]) -> str:
    """The rows as CSV, with a header."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow([field.name for field in fields(SweepRow)])
    writer.writerows([astuple(row) for row in rows])
    return file.getvalue()


def document(rows: list[SweepRow], objects: int, command: str, picture: Path) -> str:
    """The Markdown document: what was measured, the table, the plot, and the command that made it."""
    header = ["turned", "grid", "face budget", "texels", "rounds", "views", "faces", "F@0.1", "F@0.02", "CD"]
    header += ["normals °", "PSNR", "shape s", "unwrap s", "appearance s", "sum s"]
    table = []
    for r in rows:
        knobs = [r.label, r.grid, r.face_budget, r.texture_size, r.rounds, r.views, round(r.faces)]
        seconds = (r.shape_seconds, r.unwrap_seconds, r.appearance_seconds, r.seconds)
        scores = [r.f_coarse, r.f_fine, f"{r.chamfer:.4f}", f"{r.angle:.1f}", f"{r.psnr:.1f}"]
        table.append([*knobs, *scores, *(f"{s:.1f}" for s in seconds)])
    front = unbeaten(rows)
    beaten = [_name(row) for row in rows if row.label in QUALITIES and row not in front]
    gains = f" Not on it: {', '.join(beaten)}; what they add, these measures do not see." if beaten else ""
    return paragraphs(
        "# Error against run time",
        f"Means over {objects} object{'s' * (objects > 1)}, on {torch.get_num_threads()} CPU threads. The first "
        "rows are the quality levels; in the others one knob of *balanced* is turned. F-scores and the Chamfer "
        "distance (CD) compare "
        "100,000 points of each surface with the truth, whose longest side is 2; *rounds* are those of the refinement, "
        "*normals* the mean angle between normals. *PSNR*: the baked colour rendered "
        "into all six views, in dB. Seconds are those of the stages of `generate`, without files, the "
        f"shorter of {REPEATS} runs.",
        f"![Error against run time]({picture.as_posix()})",
        markdown_table(header, table),
        f"The Pareto front of seconds, Chamfer distance and PSNR, fastest first: {', '.join(map(_name, front))}."
        f"{gains} Of two points one beats the "
        f"other only by more than {SECONDS_NOISE:.0%} of the seconds, {CHAMFER_NOISE:g} or {PSNR_NOISE:g} dB: about "
        "what two runs of one point differ by.",
        f"Made by `{command}`; the same numbers stand in the CSV beside this file.",
    )


def plot(rows: list[SweepRow], path: Path) -> None:
    """Two panels: Chamfer distance and PSNR against the seconds of all stages, with their Pareto fronts."""
    losses = [replace(row, psnr=-row.psnr) for row in rows]
    with panels(path, 2, 11.0, 4.2) as axes:
        for panel, name, title, sign in (
            (axes[0], "chamfer", "Chamfer distance (smaller is better)", 1.0),
            (axes[1], "psnr", "PSNR of the baked colour, dB (larger is better)", -1.0),
        ):
            front = pareto(losses, name)
            panel.plot([r.seconds for r in front], [sign * getattr(r, name) for r in front], color="0.6", label="front")
            for label in dict.fromkeys(row.label for row in rows):
                group = [row for row in losses if row.label == label]
                marker = "*" if label in QUALITIES else "o"
                panel.plot(
                    [r.seconds for r in group],
                    [sign * getattr(r, name) for r in group],
                    marker,
                    markersize=13 if marker == "*" else 6,
                    label=label,
                )
            panel.set(xlabel="seconds", title=title)
            panel.grid(alpha=0.3)
        axes[1].legend(fontsize=8)


def _name(row: SweepRow) -> str:
    if row.label in QUALITIES:
        return f"*{row.label}*"
    values = {"grid": row.grid, "faces": row.face_budget, "texture size": row.texture_size}
    values |= {"refinement": row.rounds, "views": row.views}
    return f"{row.label} {values.get(row.label, '')}".strip()
