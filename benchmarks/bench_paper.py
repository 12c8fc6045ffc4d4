"""Seconds and peak memory of every stage of the `paper` preset, with random weights, from six views of 320².

python -m benchmarks.bench_paper float32|bfloat16|error [--shape-only] [--threads N]

Each fills its block of docs/paper-preset.md.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch.nn import functional as F

from arm_blender import networks, pipeline
from arm_blender.config import Settings
from arm_blender.graphics.color import srgb_from_linear
from arm_blender.machine.precision import running_in
from arm_blender.models.network_views import network_views
from arm_blender.report import Report
from arm_blender.structures import ViewSet
from arm_blender.uv import maps
from arm_blender.uv.backproject import backproject
from arm_blender.uv.blend import blend
from arm_blender.uv.decimate import decimate
from arm_blender.uv.texels import texel_map
from arm_blender.uv.unwrap import UnwrapConfig, unwrap
from arm_blender.views import load_views
from arm_blender.views.scene_frame import normalise
from training.documents import fill_block, markdown_table, paragraphs

from .measure import PeakMemory, cpu_seconds, machine
from .shapes import EXAMPLE, wavy_ball

DOCUMENT = Path(__file__).parents[1] / "docs" / "paper-preset.md"
SIDE = 320
"""Pixels a side of the views: those of the Zero123++ rig."""
TEXELS = 1024

SHAPE = ("GeoRM: reading the views", "Sampling the density")
"""The stages from views to the density around the surface."""

MEANING = {
    "GeoRM: loading": " (drawing random weights)",
    "InstantAlbedo: loading": " (drawing random weights)",
    "GlossyRM: loading": " (drawing random weights)",
    "cleaning the mesh": " and reducing it to 10,000 faces",
    "unwrapping": ": charts",
}
"""What a stage's message leaves out."""


@dataclass(frozen=True)
class Stage:
    """What one stage took.

    Attributes:
        name: the message that it began with.
        seconds: by the clock.
        cpu: seconds of all cores together, child processes included.
        gib: highest resident size of this process.
    """

    name: str
    seconds: float
    cpu: float
    gib: float


@dataclass
class Stages:
    """A `Progress` that measures from each new message to the next."""

    rows: list[Stage] = field(default_factory=list)
    memory: PeakMemory = field(default_factory=PeakMemory)
    message: str = "the views"
    start: float = field(default_factory=time.perf_counter)
    cpu: float = field(default_factory=cpu_seconds)

    def __call__(self, fraction: float, message: str) -> None:
        if message == self.message:
            return
        now, cpu = time.perf_counter(), cpu_seconds()
        self.rows.append(Stage(self.message, now - self.start, cpu - self.cpu, self.memory.gib()))
        print(self.rows[-1], file=sys.stderr, flush=True)
        self.memory.reset()
        self.message, self.start, self.cpu = message, now, cpu


def six_views() -> ViewSet:
    """The committed example's views at 320², in the box."""
    views = load_views(EXAMPLE)
    images = F.interpolate(views.images, size=(SIDE, SIDE), mode="area")
    cameras = tuple(camera.resized(SIDE, SIDE) for camera in views.cameras)
    return normalise(ViewSet(images, cameras, views.weights, views.name))[0]


@torch.inference_mode()
def run_stages(settings: Settings, stages: Stages, shape_only: bool) -> str:
    """All stages as `pipeline.generate` runs them, but for the atlas, which is larger than 320² views can fill.

    Returns the sizes of what was made, in words.
    """
    report = Report(settings.preset, settings.device, settings.seed)
    views = six_views()
    surface = decimate(pipeline.shape(views, settings, stages, report), settings.resolved.faces)
    if shape_only:
        stages(1.0, "end")
        return f"{len(surface.faces):,} faces"
    mesh = pipeline.atlas(surface, settings, report, stages)
    stages(0.0, "back-projecting the views")
    texels = texel_map(mesh, TEXELS)
    seen = backproject(mesh, texels, views)
    colors, weight = blend(seen, views.weights)
    base = maps.diffuse_fill(colors, (weight > 0.0) & texels.mask, texels)
    pipeline.paint(views, texels, seen, base, settings, report, stages)
    del seen, colors, weight, base
    pipeline.gloss(mesh, views, texels, settings, report, stages)
    stages(1.0, "end")
    return f"{len(mesh.faces):,} faces, {mesh.charts} charts, {TEXELS}² texels"


@torch.inference_mode()
def planes_error(settings: Settings) -> tuple[float, float]:
    """bfloat16 against float32: relative error of GeoRM's planes, and of its field over the field's deviation."""
    network = networks.load("georm", settings)
    views = network_views(six_views(), network.config)
    points = 2.0 * torch.rand(1, 2**14, 3, generator=torch.Generator().manual_seed(0)) - 1.0
    planes, fields = [], []
    for dtype in (torch.float32, torch.bfloat16):
        with running_in(dtype, settings.device):
            encoded = network.encode(views).float()
        planes.append(encoded.planes)
        fields.append(network.occupancy_logit(encoded, points))
    return (
        float((planes[1] - planes[0]).norm() / planes[0].norm()),
        float((fields[1] - fields[0]).square().mean().sqrt() / fields[0].std()),
    )


def block(precision: str, shape_only: bool) -> str:
    """The measured table as Markdown."""
    settings = Settings(preset="paper", precision=precision, random_weights=0)
    stages = Stages()
    made = run_stages(settings, stages, shape_only)
    rows = [
        [f"{stage.name}{MEANING.get(stage.name, '')}", f"{stage.seconds:.1f}", f"{stage.cpu:.1f}", f"{stage.gib:.2f}"]
        for stage in stages.rows
    ]
    rows.append(["**all stages**", *summed(stages.rows)])
    rows.append(["of these, from the views to the density around the surface", *summed(stages.rows, SHAPE)])
    table = markdown_table(["stage", "seconds", "CPU seconds", "peak GiB"], rows)
    return paragraphs(f"### {precision}", table, f"{made}. Machine: {machine()}.")


def summed(stages: list[Stage], names: Sequence[str] = ()) -> list[str]:
    """Seconds, CPU seconds and peak of some stages, or of all."""
    chosen = [stage for stage in stages if stage.name in names or not names]
    totals = sum(stage.seconds for stage in chosen), sum(stage.cpu for stage in chosen)
    return [*(f"{total:.1f}" for total in totals), f"{max(stage.gib for stage in chosen):.2f}"]


@torch.inference_mode()
def colors_error(settings: Settings) -> tuple[float, float]:
    """bfloat16 against float32: difference of InstantAlbedo's colours in sRGB, root mean square and at the worst."""
    views = six_views().only([0])
    mesh, _ = unwrap(wavy_ball(2000), UnwrapConfig())
    texels = texel_map(mesh, 256)
    seen = backproject(mesh, texels, views)
    network = networks.load("instant_albedo", settings)
    colors = []
    for dtype in (torch.float32, torch.bfloat16):
        with running_in(dtype, settings.device):
            both = network(views.images, texels, seen, torch.zeros(3, 256, 256))
        colors.append(srgb_from_linear(torch.cat(both))[:, texels.mask])
    difference = (colors[1] - colors[0]).abs()
    return float(difference.square().mean().sqrt()), float(difference.max())


def error_block() -> str:
    """How far bfloat16 is from float32, as Markdown."""
    settings = Settings(preset="paper", random_weights=0)
    planes, deviation = planes_error(settings)
    mean, worst = colors_error(settings)
    return (
        "bfloat16 against float32, with the same random weights. GeoRM: the planes differ by "
        f"{planes:.2%} (norm of the difference over the norm), the field by {deviation:.2%} of its standard deviation "
        "in the box (root mean square). InstantAlbedo, one view on 256²: its colours, in sRGB from 0 to 1, differ "
        f"by {mean:.4f} (root mean square), by {worst:.3f} at the worst texel."
    )


def main() -> int:
    """Measure one precision and write its table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bench_paper", description=__doc__.partition("\n")[0])
    parser.add_argument("what", choices=("float32", "bfloat16", "error"))
    parser.add_argument("--shape-only", action="store_true", help="stop when there is a mesh")
    parser.add_argument("--threads", type=int, default=2, help="of torch (default 2)")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    text = error_block() if args.what == "error" else block(args.what, args.shape_only)
    print(text)
    fill_block(DOCUMENT, f"paper-{args.what}", text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
