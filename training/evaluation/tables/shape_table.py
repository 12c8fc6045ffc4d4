"""`python -m training evaluate --views`: GeoRM's shapes alone against the truth, beside the hull of the same masks.

The hull knows nothing but silhouettes. A network that does not beat it has learned nothing worth its run time, and the
report says so in words.
"""

import argparse
import logging
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from arm_blender import pipeline
from arm_blender.commands.progress_line import Counted
from arm_blender.config import Settings
from arm_blender.errors import EmptyMeshError
from arm_blender.machine.files import check_output, whole_file, write_json
from arm_blender.structures import TriangleMesh, ViewSet
from arm_blender.uv.decimate import decimate
from arm_blender.views.scene_frame import normalise

from ...documents import fill_block, markdown_table, paragraphs, write_text
from ..scores.geometry import FAILED, LOWER_IS_BETTER, MEASURES, SAMPLES, GeometryScores, compare
from ..trials.hull_mesh import visual_hull
from ..trials.trial import trial_settings
from ..truth.objects import EvaluationObject, evaluation_objects
from .contact_sheet import contact_sheet
from .report_text import finite

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class ObjectResult:
    """What was measured on one object.

    Attributes:
        name: the object's id.
        ours: of the network's mesh as the pipeline hands it on: cleaned and decimated.
        hull: of the visual hull of the same masks on the same grid.
        seconds: of the network's geometry stage, from posed views to the mesh.
        faces: of the network's mesh.
    """

    name: str
    ours: GeometryScores
    hull: GeometryScores
    seconds: float
    faces: int


def run(args: argparse.Namespace) -> int:
    """Measure every object, then write `results.md`, `results.json` and a sheet per object."""
    settings = trial_settings(args)
    objects = evaluation_objects(args.views, args.data, tuple(args.set or ["gso"]), args.split)[: args.limit]
    check_output(args.output)
    args.output.mkdir(parents=True, exist_ok=True)
    results, count = [], Counted(len(objects), logger.info)
    for item in objects:
        results.append(measure(item, settings, args.seed, None if args.no_sheets else args.output))
        count(_summary(results[-1]))
    report = paragraphs(results_table(results, args.run_time), verdict(results), f"Made by `{args.command}`.")
    write_text(args.output / "results.md", report)
    write_json(args.output / "results.json", {"command": args.command, "seed": args.seed} | as_json(results, settings))
    if args.update_results:
        fill_block(args.update_results, "shapes", report)
    print(report)
    return 0


def measure(item: EvaluationObject, settings: Settings, seed: int, sheets: Path | None) -> ObjectResult:
    """Reconstruct one object both ways and compare both with the truth.

    Args:
        seed: of the points compared.
        sheets: where the object's contact sheet goes; none is made without.
    """
    views, truth = item.views(), item.truth()
    shapes = {"truth": truth, "hull": visual_hull(views, settings.resolved.grid)}
    start = time.perf_counter()
    try:
        shapes["ours"] = reconstruct(views, settings)
    except EmptyMeshError as error:
        logger.warning("%s: %s", item.name, error)
    seconds = time.perf_counter() - start
    if sheets is not None:
        order: dict[str, TriangleMesh] = {name: shapes[name] for name in ("ours", "hull", "truth") if name in shapes}
        with whole_file(sheets / f"{item.name}.png") as temporary:
            contact_sheet(views, order).save(temporary)
    return ObjectResult(
        name=item.name,
        ours=compare(shapes["ours"], truth, seed=seed) if "ours" in shapes else FAILED,
        hull=compare(shapes["hull"], truth, seed=seed),
        seconds=seconds,
        faces=len(shapes["ours"].faces) if "ours" in shapes else 0,
    )


@torch.inference_mode()
def reconstruct(views: ViewSet, settings: Settings) -> TriangleMesh:
    """The geometry stage as `generate` runs it: in the networks' box, then put back into the cameras' frame."""
    boxed, frame = normalise(views.to(settings.device))
    mesh = decimate(pipeline.shape(boxed, settings), settings.resolved.faces)
    return TriangleMesh(frame.restore(mesh.vertices).cpu(), mesh.faces.cpu())


def mean_scores(results: list[ObjectResult], which: str) -> GeometryScores:
    """The mean of every measure over the objects; `which` is "ours" or "hull"."""
    scores = [getattr(result, which) for result in results]
    return GeometryScores(**{name: sum(getattr(s, name) for s in scores) / len(scores) for name in MEASURES})


def results_table(results: list[ObjectResult], run_time: bool) -> str:
    """Markdown: a row per object and one of means, ours beside the hull's."""
    header = ["object", *(f"{text} {which}" for text in MEASURES.values() for which in ("ours", "hull"))]
    rows = [[result.name, *_pairs(result.ours, result.hull)] for result in results]
    rows.append(["**mean**", *_pairs(mean_scores(results, "ours"), mean_scores(results, "hull"))])
    if run_time:
        seconds = [result.seconds for result in results]
        header.append("seconds")
        rows = [[*row, value] for row, value in zip(rows, [*seconds, sum(seconds) / len(seconds)], strict=True)]
    return markdown_table(header, rows)


def verdict(results: list[ObjectResult]) -> str:
    """One sentence per measure: whether the network beats the hull in the mean, and on how many objects."""
    ours, hull = mean_scores(results, "ours"), mean_scores(results, "hull")
    sentences = []
    for name, text in MEASURES.items():
        sign = -1.0 if name in LOWER_IS_BETTER else 1.0
        wins = sum(sign * (getattr(r.ours, name) - getattr(r.hull, name)) > 0.0 for r in results)
        word = "beats" if sign * (getattr(ours, name) - getattr(hull, name)) > 0.0 else "does NOT beat"
        sentences.append(
            f"{text}: the network {word} the visual hull ({getattr(ours, name):.4f} against {getattr(hull, name):.4f}; "
            f"better on {wins} of {len(results)} objects)."
        )
    return "  \n".join(sentences)


def as_json(results: list[ObjectResult], settings: Settings) -> dict[str, Any]:
    """Everything that was measured; a distance that is infinite, where there was no surface, becomes null."""
    return {
        "settings": asdict(settings),
        "samples": SAMPLES,
        "mean": {which: finite(asdict(mean_scores(results, which))) for which in ("ours", "hull")},
        "objects": [finite(asdict(result)) for result in results],
    }


def _pairs(ours: GeometryScores, hull: GeometryScores) -> list[float]:
    return [getattr(scores, name) for name in MEASURES for scores in (ours, hull)]


def _summary(result: ObjectResult) -> str:
    return (
        f"{result.name}: F@0.1 {result.ours.f_coarse:.3f} (hull {result.hull.f_coarse:.3f}), "
        f"CD {result.ours.chamfer:.4f} (hull {result.hull.chamfer:.4f}), {result.seconds:.1f} s"
    )
