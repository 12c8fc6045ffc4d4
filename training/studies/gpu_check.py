"""`python -m training check-gpu`: whether a device computes what the processor does, trains, and renders.

The demo's density and maps are compared with the processor's; each stage takes a step in bfloat16 and a second one
after a resume, on made-up balls; Cycles renders on the graphics device, where it finds one. Each part runs in a process
of its own: one that fails is told, and the others still run.
"""

import argparse
import logging
import multiprocessing
import platform
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from arm_blender import pipeline
from arm_blender.commands.progress_line import Counted
from arm_blender.config import Settings
from arm_blender.errors import ArmError
from arm_blender.report import Report, own_peak_mib
from arm_blender.structures import MaterialMaps, ViewSet
from arm_blender.views import load_views
from arm_blender.views.scene_frame import normalise

from .. import distributed
from ..datasets import atlases, gloss_samples
from ..documents import fill_block, markdown_table, paragraphs
from ..evaluation.scores.image_scores import psnr
from ..rendering import shards
from ..rendering.made_up_ball import write_ball
from ..stages import georm_surface, georm_volume, glossyrm, instant_albedo, material_prior
from .paper_step import DOCUMENT, GIB

logger = logging.getLogger(__name__)

DENSITY = 1e-3
"""Largest difference of the occupancy, between 0 and 1, that is the same density."""
MAPS = 40.0
"""dB, at least, that a map on the device has of the processor's."""
GRID = 64
"""Points a side at which densities are compared."""

STAGES: dict[str, tuple[Any, str]] = {
    "georm-volume": (georm_volume, "tiny"),
    "georm-surface": (georm_surface, "tiny"),
    "glossyrm": (glossyrm, "tiny"),
    "material-prior": (material_prior, "small"),
    "instant-albedo": (instant_albedo, "small"),
}
"""Module of each stage, and its preset for `--sizes small`, as `make test-train` has it."""

Result = dict[str, Any]
"""Of a part: "found" in words, "passed", and where they were measured "seconds" and "gib"; or "skipped": why."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training check-gpu`."""
    parser.add_argument("--device", choices=("cuda", "cpu"), default="cuda", help="what is checked")
    parser.add_argument("--sizes", choices=("paper", "small"), help="of what is trained; paper on cuda, small on cpu")
    parser.add_argument("--views", type=Path, default=Path("arm_blender/examples/barrel"), help="of the demo")
    parser.add_argument("--quality", choices=("draft", "balanced", "final"), default="balanced", help="of the demo")
    parser.add_argument("--output", type=Path, default=Path("out/check-gpu"), help="folder; begun anew")
    parser.add_argument("--parts", nargs="*", choices=PARTS, help="all of them unless some are named")
    parser.add_argument("--update", action="store_true", help=f"fill the block `gpu` of {DOCUMENT}")


def run(args: argparse.Namespace) -> int:
    """Check every part; 1 where one failed.

    Raises:
        ArmError: there is no such device.
    """
    distributed.device(args.device)
    args.sizes = args.sizes or ("paper" if args.device == "cuda" else "small")
    if args.output.exists():
        if not (args.output / MADE).exists():
            raise ArmError(f"{args.output}: is not a folder of check-gpu; give another --output")
        shutil.rmtree(args.output)
    args.output.mkdir(parents=True)
    (args.output / MADE).touch()
    chosen = args.parts or list(PARTS)
    count, results = Counted(len(chosen), logger.info), dict[str, Result]()
    for name in chosen:
        results[name] = in_own_process(PARTS[name], Check(args))
        count(f"{name}: {verdict(results[name])}, {results[name].get('skipped') or results[name]['found']}")
    text = paragraphs(table(results), f"{machine(args.device)} Made by `{args.command}`.")
    print(text)
    if args.update:
        fill_block(DOCUMENT, "gpu", text)
    return int(any(not result.get("passed", True) for result in results.values()))


MADE = ".check-gpu"


class Check:
    """What the parts need of the words; it is sent to other processes."""

    def __init__(self, args: argparse.Namespace) -> None:
        self.device, self.sizes, self.quality = args.device, args.sizes, args.quality
        self.views, self.output = args.views.resolve(), args.output.resolve()


def in_own_process(part: Callable[[Check], Result], check: Check) -> Result:
    """A part where no other has used memory before; an error becomes its result."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        try:
            return pool.apply(part, (check,))
        except Exception as error:  # Whatever it is, it says that the device does not do.
            logger.exception("check-gpu")
            lines = str(error).strip().splitlines() or [""]
            return {"found": f"{type(error).__name__}: {lines[0][:200]}", "passed": False}


def peak_gib(device: str) -> float:
    """Highest memory so far: of the device, or of this process where it is the processor."""
    return torch.cuda.max_memory_allocated() / GIB if device == "cuda" else (own_peak_mib() or 0.0) / 1024.0


def demo(check: Check) -> Result:
    """The demo's whole run on the device, then density and maps beside the processor's, on the same mesh."""
    views = load_views(check.views)
    on_device = Settings(device=check.device, quality=check.quality, precision="float32")
    on_cpu = replace(on_device, device="cpu")
    mesh = pipeline.generate(views, on_cpu)[0].mesh
    started = time.perf_counter()
    pipeline.generate(views, on_device)
    seconds, gib = time.perf_counter() - started, peak_gib(check.device)
    difference = float((occupancy(views, on_device) - occupancy(views, on_cpu)).abs().max())
    found, wanted = (pipeline.generate(views, settings, mesh=mesh)[0].maps for settings in (on_device, on_cpu))
    scores = alike(found, wanted)
    said = ", ".join(f"{name} {score:.1f} dB" for name, score in scores.items())
    passed = difference <= DENSITY and min(scores.values()) >= MAPS
    return {"found": f"density within {difference:.1e}, {said}", "passed": passed, "seconds": seconds, "gib": gib}


@torch.inference_mode()
def occupancy(views: ViewSet, settings: Settings) -> Tensor:
    """(GRID**3,) in [0, 1] of the points of a grid over the box, on the processor."""
    framed, _ = normalise(views.chosen().to(settings.device))
    side = torch.linspace(-1.0, 1.0, GRID)
    points = torch.cartesian_prod(side, side, side).to(settings.device)
    field = pipeline.density(framed, settings, Report(settings.preset, settings.device, settings.seed))
    chunks = points.split(pipeline.POINTS_AT_ONCE[settings.device])
    return torch.cat([field(chunk).float().sigmoid().cpu() for chunk in chunks])


def alike(found: MaterialMaps, wanted: MaterialMaps) -> dict[str, float]:
    """dB of each map; of a colour in linear light."""
    scores = {}
    for name in ("albedo", "baked", "roughness", "metallic"):
        one, other = (torch.as_tensor(getattr(maps, name)).float().cpu() for maps in (found, wanted))
        scores[name] = psnr(float((one - other).square().mean()))
    return scores


def stage(name: str, check: Check) -> Result:
    """A step in bfloat16, and a second one by a run that goes on from the first."""
    module, small = STAGES[name]
    paper = check.sizes == "paper"
    words = {"preset": "paper" if paper else small, "device": check.device}
    folder = prepared(check.output / name, 512 if paper else 160)
    extra = inputs_of(name, words, folder)
    output, spent, gib = folder / "weights.safetensors", [0.0], 0.0
    for steps in (1, 2):
        parser = argparse.ArgumentParser()
        module.add_arguments(parser)
        base = ["--output", str(output), "--steps", str(steps), "--average", "0", "--bfloat16", "--log-every", "1"]
        taken = module.run(parser.parse_args([*base, *options_of(words), *extra]))
        state = torch.load(output.with_suffix(".resume"), weights_only=True, map_location="cpu")
        if taken or (state["step"], state["skipped"]) != (steps, 0):
            return {"found": f"step {steps} was not taken, or had no finite gradient", "passed": False}
        spent.append(state["spent"])
        gib = peak_gib(check.device)
    found = f"preset {words['preset']}: a step, and one more after a resume"
    return {"found": found, "passed": True, "seconds": spent[2] - spent[1], "gib": gib}


def options_of(words: Mapping[str, str]) -> list[str]:
    """As they are typed."""
    return [text for name, value in words.items() for text in (f"--{name}", value)]


def prepared(folder: Path, size: int) -> Path:
    """A folder with `shards` of two balls, seen in views of `size` pixels a side."""
    for name, radius in (("ball", 0.6), ("bead", 0.4)):
        write_ball(folder / "shards" / name, radius, (0.1, 0.0, -0.1), size)
    return folder


def inputs_of(name: str, words: Mapping[str, str], folder: Path) -> list[str]:
    """What a stage is given beside the words of all."""
    own = ["--shards", str(folder / "shards")]
    if name == "glossyrm":
        return [*own, *balls_as_shapes(words["preset"], folder)]
    if name == "material-prior":
        return [*own, "--cache", str(folder / "cache")]
    if name == "instant-albedo":
        paper = words["preset"] == "paper"
        cache = folder / "cache"
        atlases.prepare(folder / "shards", cache, atlases.AtlasConfig(size=1024 if paper else 128))
        return ["--cache", str(cache)]
    return own


def balls_as_shapes(preset: str, folder: Path) -> list[str]:
    """A GeoRM of random weights, which has no surface of a usual size, and the balls themselves for its shapes."""
    from arm_blender.models.paper.georm import GeoRM
    from arm_blender.weight_files import checkpoints

    from ..stages.rendered_views import CONFIGS

    config = CONFIGS[preset]
    georm, shapes = folder / "georm.safetensors", folder / "shapes"
    checkpoints.save(georm, GeoRM(config).state_dict(), config, f"{preset}.georm", {})
    grid = glossyrm.TINY_GLOSSY.grid if preset == "tiny" else glossyrm.GlossyConfig().grid
    shapes.mkdir()
    for path in shards.rigs(folder / "shards"):
        target = shapes / gloss_samples.kept_as(path, gloss_samples.mark(georm, grid))
        shutil.copyfile(path.with_name("mesh.npz"), target)
    return ["--georm", str(georm), "--shapes", str(shapes)]


def cycles(check: Check) -> Result:
    """A picture by Cycles on the graphics device beside the processor's."""
    if check.device == "cpu":
        return {"skipped": "--device cpu"}
    try:
        from .gpu_render_blender import rendered_alike
    except ImportError:
        return {"skipped": "no bpy in this Python"}
    found = rendered_alike(512, 256)
    if "skipped" in found:
        return found
    said = f"{found['kind']}, {found['psnr']:.1f} dB of the processor's picture"
    return {"found": said, "passed": found["psnr"] >= 30.0, "seconds": found["seconds"]}


PARTS: dict[str, Callable[[Check], Result]] = {
    "demo": demo, **{name: partial(stage, name) for name in STAGES}, "cycles": cycles
}  # fmt: skip
"""What is checked, in order."""


def verdict(result: Result) -> str:
    """In a word."""
    return "skipped" if "skipped" in result else "passed" if result["passed"] else "FAILED"


def table(results: Mapping[str, Result]) -> str:
    """Markdown: a row per part."""
    rows = []
    for name, result in results.items():
        numbers = [f"{result[key]:.2f}" if key in result else "-" for key in ("seconds", "gib")]
        rows.append([name, verdict(result), result.get("skipped") or result["found"], *numbers])
    return markdown_table(["part", "", "found", "seconds", "GiB"], rows)


def machine(device: str) -> str:
    """What was checked, in a sentence."""
    if device == "cuda":
        return f"On {torch.cuda.get_device_name()}, PyTorch {torch.__version__}."
    return (
        f"On the processor ({platform.machine()}), PyTorch {torch.__version__}: it shows that the check itself runs. "
        "**No part of this was ever run on a GPU.**"
    )
