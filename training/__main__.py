"""`python -m training COMMAND ...`: render data sets, fit the networks, measure them.

A command's module is imported only when the command is asked for, so that `--help` is fast and rendering, which
needs `bpy`, stays apart from fitting, which does not. Each offers `add_arguments(parser)` and `run(args) -> int`.
"""

import argparse
import importlib
import logging
import os
import shlex
import sys
from pathlib import Path
from types import ModuleType

from arm_blender.errors import ArmError

COMMANDS = {
    "render": ("training.rendering.render", "render objects into shards, or into evaluation views"),
    "rasterized": ("training.studies.rasterized_blender", "compare views rasterised on the fly with Cycles'"),
    "shards": ("training.rendering.shard_report", "tell what shards hold, check them, and what more would cost"),
    "prepare": ("training.rendering.occupancy", "sample signed distances to the rendered objects"),
    "evaluate": ("training.evaluation.evaluate", "measure shape, colours, materials and relighting against the truth"),
    "ablations": ("training.studies.ablations", "fit networks with a part left out, and compare them"),
    "sweep": ("training.studies.sweep", "error against run time, each knob in turn"),
    "quality-levels": ("training.studies.quality_levels", "hand the sweep's levels on to Blender's panel"),
    "stability": ("training.studies.extremes.stability", "measure the pipeline's parts on extreme inputs"),
    "left-out": ("training.studies.left_out", "show which work the pipeline skips where a scene does not need it"),
    "shading": ("training.studies.shading_blender", "compare the direct light of our BRDF with Cycles'"),
    "presets": ("training.studies.presets", "count the parameters of every preset"),
    "paper-step": ("training.studies.paper_step", "count and run a training step at the paper's sizes"),
    "check-gpu": ("training.studies.gpu_check", "whether a device computes, trains and renders as the processor does"),
    "evaluate-masks": ("training.studies.captured_masks", "compare the masks of simulated captures with the truth"),
    "evaluate-photographs": (
        "training.studies.real_photographs",
        "photographs of a real thing: its cameras beside published ones, and its asset",
    ),
    "gallery": ("training.studies.gallery_blender", "pictures of what the program makes, and the page of them"),
    "credits": ("training.studies.credits", "list the sources of the training objects"),
}
STAGES = {
    "georm-outlines": ("training.stages.georm_outlines", "GeoRM of small, from outlines and colours alone"),
    "ray-occupancy": ("training.stages.ray_occupancy", "where one view's object is, by what objects are like"),
    "material-prior": ("training.stages.material_prior", "InstantAlbedo's encoder, on materials that are known"),
    "delighting": ("training.stages.delighting", "InstantAlbedo's sense of light, at points of GeoRM's shapes"),
    "instant-albedo": ("training.stages.instant_albedo", "InstantAlbedo: albedo and lighting-baked colour"),
    "finish": ("training.stages.finish", "roughness and metallic, off the evidence of the views"),
    "cutout": ("training.stages.cutout", "what of a photograph is the object"),
    "joint-cutout": ("training.stages.joint_cutout", "what of photographs whose cameras are known is the object"),
    "georm-volume": ("training.stages.georm_volume", "the paper's GeoRM, by rendering its density: its first stage"),
    "georm-surface": (
        "training.stages.georm_surface",
        "the paper's GeoRM, by rasterising its surface: its second stage",
    ),
    "glossyrm": ("training.stages.glossyrm", "the paper's GlossyRM, on the surface that GeoRM finds"),
}


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit status: 0 done, 1 failed, 2 bad usage, 130 interrupted."""
    words = sys.argv[1:] if argv is None else argv
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    try:
        module, args = understood(words)
    except SystemExit as stop:  # argparse has printed what is wrong; a caller in Python gets a status as well.
        return int(stop.code or 0)
    try:
        return module.run(args)
    except ArmError as error:
        print(f"{args.program}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"{args.program}: stopped", file=sys.stderr)
        return 130


def understood(words: list[str]) -> tuple[ModuleType, argparse.Namespace]:
    """The module of a command, and its arguments, read but not acted on.

    Raises:
        SystemExit: the words are wrong, or ask for help; argparse has printed it.
    """
    chosen, rest = _command_parser().parse_known_args(words)
    module = importlib.import_module(chosen.module)
    parser = argparse.ArgumentParser(prog=chosen.program, description=(module.__doc__ or "").partition("\n")[0])
    module.add_arguments(parser)
    if "ARM_DATA" in os.environ:
        parser.set_defaults(data=Path(os.environ["ARM_DATA"]))
    args = parser.parse_args(rest)
    args.program = chosen.program
    args.command = f"python -m training {shlex.join(words)}"  # Documents say which command made them.
    return module, args


def _command_parser() -> argparse.ArgumentParser:
    """Knows the commands, not their arguments: those are in modules that are imported later, if at all."""
    parser = argparse.ArgumentParser(prog="python -m training", description="Render, fit and measure.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    stages = commands.add_parser("fit", help="fit one network").add_subparsers(required=True, metavar="STAGE")
    for prefix, group, table in (("", commands, COMMANDS), ("fit ", stages, STAGES)):
        for name, (module, summary) in table.items():
            command = group.add_parser(name, help=summary, add_help=False)
            command.set_defaults(module=module, program=f"python -m training {prefix}{name}")
    return parser


if __name__ == "__main__":
    sys.exit(main())
