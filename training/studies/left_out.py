"""`python -m training left-out`: what the pipeline skips where a scene does not need it: as its own reports say, and
where it does not sample the density."""

import argparse
import logging
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import torch

from arm_blender import pipeline
from arm_blender.commands.progress_line import Counted
from arm_blender.config import PRESETS, Settings
from arm_blender.graphics.surface.isosurface import extract
from arm_blender.graphics.surface.sample_grid import IsosurfaceConfig
from arm_blender.report import Report
from arm_blender.structures import TriangleMesh, ViewSet
from arm_blender.views.scene_frame import normalise

from ..documents import markdown_table, paragraphs, write_text
from ..evaluation.truth.objects import EvaluationObject, evaluation_objects

logger = logging.getLogger(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training left-out`."""
    parser.add_argument("--views", type=Path, required=True, help="folder written by `render --layout views`")
    parser.add_argument("--preset", default="small", choices=PRESETS)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--output", type=Path, default=Path("docs/left-out.md"))


def run(args: argparse.Namespace) -> int:
    """Generate from every variant of the first object's views and write what each report left out."""
    items = evaluation_objects(args.views)
    item = items[0]
    views, settings = item.views(), Settings(preset=args.preset, device=args.device)
    pipeline.generate(views, settings)  # Loads the weights, so that no variant is charged for it.
    tried = list(variants(views))
    count, rows = Counted(len(tried) + 1 + len(items), logger.info), []
    for title, variant in tried:
        rows.append(row(title, variant, settings))
        count(title)
    rows.append(row("six views, and a mesh of the user's own", views, settings, item.truth()))
    count("a mesh")
    samples = []
    for other in items:
        samples.append(sampling(other, settings))
        count(f"the density of {other.name}")
    text = paragraphs(
        "# What is left out",
        "The report of every run says which work was skipped and why. These are variants of one object's six views "
        f"(`{views.name}`).",
        markdown_table(["views", "left out", "seconds", "texels a side"], rows),
        f"The density is sampled where its surface can be. On a grid of {settings.resolved.grid}³, for each evaluation "
        "object's six views, beside every sample (`--dense`):",
        markdown_table(["object", "samples", "of all", "faces", "missed faces"], samples),
        f"Made by `{args.command}`.",
    )
    write_text(args.output, text)
    print(text)
    return 0


def row(title: str, views: ViewSet, settings: Settings, mesh: TriangleMesh | None = None) -> list[object]:
    """One line of the table: what a run's report says."""
    asset, report = pipeline.generate(views, settings, mesh=mesh)
    reasons = "<br>".join(f"{left.what}: {left.why}" for left in report.left_out) or "nothing"
    return [title, reasons, f"{sum(report.seconds.values()):.1f}", asset.maps.albedo.shape[-1]]


def sampling(item: EvaluationObject, settings: Settings) -> list[object]:
    """One line of the second table: samples taken, and faces of the dense surface that the sparse one has not."""
    views, _ = normalise(item.views())
    faces: list[int] = []
    asked: list[int] = []
    with torch.inference_mode():
        field = pipeline.density(views, settings, Report(settings.preset, settings.device, settings.seed))

        def counted(points: torch.Tensor) -> torch.Tensor:
            asked[-1] += len(points)
            return field(points)

        for dense in (False, True):
            asked.append(0)
            chunk = pipeline.POINTS_AT_ONCE[settings.device]
            config = IsosurfaceConfig(settings.resolved.grid, iso=0.0, dense=dense, chunk=chunk)
            faces.append(len(extract(counted, config, device=settings.device).faces))
    missed = f"{1.0 - faces[0] / faces[1]:.3%}"
    return [item.name, f"{asked[0]:,}", f"{asked[0] / asked[1]:.1%}", f"{faces[1]:,}", missed]


def variants(views: ViewSet) -> Iterator[tuple[str, ViewSet]]:
    """Scenes that need less, each with its description."""
    yield "six views", views
    yield "the first three", views.only(range(3))
    yield "the first alone", views.only(range(1))
    grey = views.images.clone()
    grey[:, :3] = 0.2
    yield "six views of one flat grey", replace(views, images=grey)
    yield "six views, the last two of weight 0", replace(views, weights=torch.tensor([1.0] * 4 + [0.0] * 2))
    small = torch.nn.functional.interpolate(views.images, scale_factor=0.25, mode="area")
    cameras = tuple(camera.resized(small.shape[-1], small.shape[-2]) for camera in views.cameras)
    yield f"six views of {small.shape[-1]}²", ViewSet(small, cameras, views.weights, views.name)
