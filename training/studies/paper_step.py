"""`python -m training paper-step`: what a training step of each stage costs at the paper's sizes.

What a pass keeps is counted of tensors that have shapes and no content; GeoRM's and GlossyRM's steps, forward and
backward, are also run on the processor, with random weights on a made-up object, each in a process of its own.
"""

import argparse
import json
import logging
import multiprocessing
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial, reduce
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Tensor, nn
from torch._subclasses.fake_tensor import FakeTensorMode

from arm_blender.commands.progress_line import Counted
from arm_blender.graphics.cameras import orbit_camera
from arm_blender.machine.files import write_json
from arm_blender.models.network_views import NetworkViews
from arm_blender.models.paper.georm import RAW_ISO, GeoRM
from arm_blender.models.paper.glossyrm import GlossyRM
from arm_blender.models.paper.instant_albedo import PAPER as PAPER_ALBEDO
from arm_blender.models.paper.instant_albedo import PaperInstantAlbedo
from arm_blender.models.paper.reconstruction import PAPER, EncodedPlanes, ReconstructionConfig
from arm_blender.report import own_peak_mib
from arm_blender.structures import TexelMap, TexelViews, stack_cameras

from .. import blocks
from ..datasets.gloss_samples import GlossSample
from ..datasets.view_samples import ViewSample
from ..documents import fill_block, markdown_table, paragraphs
from ..kept_memory import kept_by
from ..losses import SurfaceMaps
from ..stages import georm_surface, georm_volume, glossyrm
from ..surface_rendering import iso_surface

logger = logging.getLogger(__name__)

GIB = 2**30
DOCUMENT = Path("docs/training-cost.md")
BALL = 0.6
"""Radius of the made-up object; a third of a view is its."""

Network = TypeVar("Network", bound=nn.Module)
Loss = Callable[[Network], Tensor]
"""Of a model, on a made-up sample."""


@dataclass(frozen=True)
class Run:
    """What a step on the processor took.

    Attributes:
        seconds: forward and backward.
        gib: highest resident size of the process, weights and gradients among it.
        kept: bytes that the forward pass kept, blocks computed again.
        what: what was left out.
    """

    seconds: float
    gib: float
    kept: int
    what: str


class WithBall(GeoRM):
    """GeoRM with a ball added to its density: random weights alone have no surface of a usual size."""

    def occupancy_logit(self, encoded: EncodedPlanes, points: Tensor) -> Tensor:
        return super().occupancy_logit(encoded, points) + ball(points)


def ball(points: Tensor) -> Tensor:
    """Over the iso value, whatever a network of random weights adds."""
    return RAW_ISO + 100.0 * (BALL - points.norm(dim=-1))


def inputs() -> NetworkViews:
    """Six views of 320²."""
    c2w, K = stack_cameras(tuple(orbit_camera(60.0 * i, (20.0, -10.0)[i % 2], 4.0, 30.0, 320, 320) for i in range(6)))
    return NetworkViews(torch.rand(1, 6, 4, 320, 320), torch.rand(1, 6, 2, 320, 320), c2w[None], K[None])


def sample() -> ViewSample:
    """Ten views of 512² with a disc for the truth."""
    size = 512
    c2w, K = stack_cameras(tuple(orbit_camera(36.0 * i, 20.0, 4.0, 30.0, size, size) for i in range(10)))
    pixels = torch.arange(size) + 0.5 - size / 2
    disc = (pixels.square() + pixels[:, None].square()).sqrt() < BALL / 4.0 * float(K[0, 0, 0])
    depth = torch.where(disc, 4.0 - BALL, torch.inf).expand(10, -1, -1)
    truth = SurfaceMaps(disc.float().expand(10, -1, -1), depth, torch.ones(10, 3, size, size) / 3.0**0.5)
    return ViewSample(inputs(), c2w, K, truth, torch.zeros(1, 3))


def volume_loss(side: int) -> Loss[GeoRM]:
    """Stage 1 with windows of `side` pixels."""
    made_up, draws = sample(), torch.Generator().manual_seed(0)
    config = replace(georm_volume.VolumeConfig(), window=side)
    return lambda model: reduce(torch.add, georm_volume.sample_loss(model, made_up, config, draws).values())


def surface_loss() -> Loss[GeoRM]:
    """Stage 2, whole."""
    made_up, draws = sample(), torch.Generator().manual_seed(0)
    config = georm_surface.SurfaceConfig()
    return lambda model: reduce(torch.add, georm_surface.sample_loss(model, made_up, config, draws).values())


def glossy_loss() -> Loss[GlossyRM]:
    """GlossyRM's on a ball as fine as GeoRM's shapes."""
    made_up, draws, config = sample(), torch.Generator().manual_seed(0), glossyrm.GlossyConfig()
    shape = iso_surface(ball, config.grid, torch.device("cpu"))
    assert shape is not None  # A ball has a surface.
    gloss = torch.rand(10, 2, 512, 512)
    whole = GlossSample(made_up.inputs, made_up.c2w, made_up.K, made_up.truth, shape.vertices, shape.faces, gloss)
    return lambda model: reduce(torch.add, glossyrm.sample_loss(model, whole, config, draws).values())


RUNS: dict[str, tuple[Callable[[ReconstructionConfig], nn.Module], Callable[[], Loss[Any]], str]] = {
    "georm-volume": (GeoRM, lambda: volume_loss(32), "windows of 32² instead of 192²"),
    "georm-surface": (WithBall, surface_loss, "nothing left out"),
    "glossyrm": (GlossyRM, glossy_loss, "nothing left out"),
}
"""What is run on the processor, and what of it is left out."""


def run_step(name: str) -> Run:
    """Forward and backward of one stage, in this process."""
    torch.manual_seed(0)
    network, prepare, what = RUNS[name]
    model, loss = network(PAPER), prepare()
    blocks.recompute(model)
    started = time.perf_counter()
    with kept_by(model) as kept:
        value = loss(model)
    size = kept.bytes
    del kept
    value.backward()
    seconds = time.perf_counter() - started
    gradients = {key: parameter.grad for key, parameter in model.named_parameters()}
    lost = [key for key, grad in gradients.items() if grad is None or not bool(grad.isfinite().all())]
    if lost:
        raise ValueError(f"{name}: gradients missing or not finite: {lost}")
    return Run(seconds, (own_peak_mib() or 0.0) / 1024.0, size, what)


def in_own_process(name: str) -> Run:
    """`run_step` where no other step has used memory before."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(run_step, (name,))


def kept_without_memory(network: Callable[[], Network], prepare: Callable[[], Loss[Network]], recompute: bool) -> int:
    """Bytes that a step keeps, of tensors that have shapes and no content; its backward pass is followed as well."""
    with torch.device("meta"):
        model = network()
    # Of the processor, not of the meta device: there attention would keep its whole matrix, which no device does.
    with FakeTensorMode(allow_non_fake_inputs=True):
        model.to_empty(device="cpu")
        loss = prepare()
    if recompute:
        blocks.recompute(model)
    with kept_by(model) as kept:
        value = loss(model)
    size = kept.bytes
    value.backward()
    return size


def encoding() -> Loss[GeoRM]:
    """What GeoRM and GlossyRM make of the views."""
    views = unposed()
    return lambda model: model.encode(views).planes.sum()


def unposed() -> NetworkViews:
    """Six views of 320², their cameras of no matter."""
    return NetworkViews(
        torch.rand(1, 6, 4, 320, 320), torch.rand(1, 6, 2, 320, 320), torch.rand(1, 6, 4, 4), torch.rand(1, 6, 3, 3)
    )


def whole_volume_loss() -> Loss[GeoRM]:
    """Stage 1 whole, cameras of no matter."""
    draws, config = torch.Generator(), georm_volume.VolumeConfig()
    maps = SurfaceMaps(torch.rand(10, 512, 512), torch.rand(10, 512, 512), torch.rand(10, 3, 512, 512))
    made_up = ViewSample(unposed(), torch.rand(10, 4, 4), torch.rand(10, 3, 3), maps, torch.rand(4, 3))
    return lambda model: reduce(torch.add, georm_volume.sample_loss(model, made_up, config, draws).values())


def albedo_loss(size: int) -> Loss[PaperInstantAlbedo]:
    """InstantAlbedo on six views of 320² and an atlas of `size` texels; the comparison of colours is left out."""
    texels = TexelMap(torch.rand(3, size, size), torch.rand(3, size, size), torch.ones(size, size, dtype=torch.bool))
    seen = TexelViews(
        torch.rand(6, 3, size, size), torch.ones(6, size, size, dtype=torch.bool), torch.rand(6, 3),
        torch.rand(6, size, size), torch.rand(6, size, size, 2),
    )  # fmt: skip
    images, base = torch.rand(6, 4, 320, 320), torch.rand(3, size, size)
    return lambda model: sum(colors.sum() for colors in model(images, texels, seen, base))


def state_gib(parameters: int) -> float:
    """Weights, gradient, both moments of Adam, and the average, in float32."""
    return 5 * 4 * parameters / GIB


def measured(path: Path) -> dict[str, Run]:
    """The runs of a file, and those that it lacks: these are made one after the other, and written there at once."""
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    path.parent.mkdir(parents=True, exist_ok=True)
    waiting = [name for name in RUNS if name not in known]
    count = Counted(len(waiting), logger.info)
    for name in waiting:
        known[name] = asdict(in_own_process(name))
        write_json(path, known)
        count(name)
    return {name: Run(**known[name]) for name in RUNS}


def table(runs: dict[str, Run]) -> str:
    """Markdown: a row per stage."""
    rows = []

    def row(name: str, network: Callable[[], nn.Module], kept: list[int], run: str) -> None:
        with torch.device("meta"):
            count = sum(parameter.numel() for parameter in network().parameters())
        sizes = [f"{size / GIB:.2f}" for size in kept]
        rows.append([name, f"{count / 1e6:.1f} M", f"{state_gib(count):.1f}", *sizes, run])

    def georm() -> GeoRM:
        return GeoRM(PAPER)

    def albedo() -> PaperInstantAlbedo:
        return PaperInstantAlbedo(PAPER_ALBEDO)

    encoded, again = (kept_without_memory(georm, encoding, recompute) for recompute in (False, True))
    for name, run in runs.items():
        kept = [run.kept + encoded - again, run.kept]
        if name == "georm-volume":
            kept = [kept_without_memory(georm, whole_volume_loss, recompute) for recompute in (False, True)]
        row(name, georm, kept, f"{run.seconds:.0f} s, {run.gib:.1f} GiB, {run.what}")
    for size in (512, 1024):
        kept = [kept_without_memory(albedo, partial(albedo_loss, size), recompute) for recompute in (False, True)]
        row(f"instant-albedo, atlas {size}²", albedo, kept, "not run: shapes alone")
    header = ["stage", "parameters", "state, GiB", "kept, GiB", "kept with --recompute, GiB", "run on the processor"]
    return markdown_table(header, rows)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training paper-step`."""
    parser.add_argument("--update-document", action="store_true", help=f"write {DOCUMENT}")
    parser.add_argument(
        "--runs", type=Path, default=Path("out/paper-step.json"), help="keeps what was run; each is run once"
    )


def run(args: argparse.Namespace) -> int:
    """Print the table; write the document where it is asked for."""
    text = table(measured(args.runs))
    print(text)
    if args.update_document:
        fill_block(DOCUMENT, "steps", paragraphs(text, _MADE))
    return 0


_MADE = "Made by `python -m training paper-step --update-document`."
