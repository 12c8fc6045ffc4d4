"""Make one relightable asset from views of an object.

Its words are those of `batch` as well, which makes many.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import run as run_of
from ..asset_record import AssetRecord, chosen_values
from ..errors import ArmError, InputImageError
from ..knobs import DrawingKnobs, Knobs, ViewKnobs, knobs_of, values_of
from ..machine.files import check_output
from ..progress import part
from . import UsageError, mesh_option, progress_line

if TYPE_CHECKING:
    from ..config import Settings
    from ..progress import Progress
    from ..report import Report
    from ..structures import RelightableAsset, ViewSet
    from ..views import ViewOptions

LONGEST_NAME = 200
"""Bytes: with what files that are underway have around it, it stays below the 255 that file systems take."""

NO_BPY = "bpy is not installed here; `pip install bpy`, or use `blender --command arm`"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "views", type=Path, metavar="VIEWS", help="an image, a video, or a folder of views or photographs"
    )
    parser.add_argument("--json", action="store_true", help="print the report as JSON on stdout")
    add_options(parser)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Everything but the views: what `generate` and `batch` share."""
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="the folder of the result")
    _add_knobs(parser.add_argument_group("quality and time"), Knobs)
    views = parser.add_argument_group("views")
    _add_knobs(views, ViewKnobs)
    views.add_argument("--multiview-model", type=Path, metavar="DIR", help="its weights, as diffusers saves a pipeline")
    _add_knobs(views, DrawingKnobs)
    result = parser.add_argument_group("result")
    result.add_argument("--mesh", type=Path, metavar="FILE", help="your mesh: only its texture is made")
    result.add_argument(
        "--mesh-up",
        type=mesh_option.up,
        default="auto",
        metavar="AXIS",
        help="of an OBJ, PLY or STL: y, z, or auto (default): what fits the views",
    )
    result.add_argument(
        "--place",
        type=placement,
        default="cameras",
        metavar="WHERE",
        help="cameras: where they see it (default); ground",
    )
    result.add_argument(
        "--export", type=formats, default="glb", metavar="F,F", help="besides .blend: glb (default), usd, usdz, obj"
    )
    result.add_argument("--preview", action="store_true", help="also render preview.png, and draw comparison.png")
    result.add_argument("--strict", action="store_true", help="status 1 where a result may be wrong (doubtful)")
    progress_line.add_option(result)


def _add_knobs(group: argparse._ArgumentGroup, declared: type) -> None:
    """An option for each knob."""
    for one in knobs_of(declared):
        words: dict[str, Any] = {"dest": one.name, "default": one.default, "help": one.help}
        if one.kind is bool:
            group.add_argument(f"--{one.option}", action="store_true", **words)
        else:
            letter = one.letter or one.column.upper()
            group.add_argument(f"--{one.option}", type=one.kind, metavar=letter, **words)


def formats(text: str) -> str:
    """The value of --export; which formats there are is known once torch is imported."""
    if not text.replace(",", "").replace(" ", ""):
        raise argparse.ArgumentTypeError(f"{text!r}: give formats, separated by commas")
    return text


def placement(text: str) -> str:
    """The value of --place."""
    if text not in ("cameras", "ground"):
        raise argparse.ArgumentTypeError(f"{text!r}: give cameras or ground")
    return text


def run(args: argparse.Namespace) -> int:
    check_output(args.output)
    with progress_line.shown(args.progress) as progress:
        report, files = produce(args, progress)
    say_doubts(report)
    if args.json:
        json.dump(report.as_dict(), sys.stdout, indent=2)
        print()
    else:
        print(progress_line.summary(report), *files, sep="\n")
    return int(args.strict and bool(report.all_doubts))


def say_doubts(report: Report, of: str = "") -> None:
    """A line on stderr for each reason why a result may be wrong; `of` names it where there are several."""
    for why in report.all_doubts:
        print(f"arm: doubtful: {of}{why}", file=sys.stderr)


def produce(args: argparse.Namespace, progress: Progress, name: str | None = None) -> tuple[Report, list[Path]]:
    """Makes the asset of `args.views` in `args.output`.

    Args:
        args: as `add_arguments` makes them.
        progress: of the whole run.
        name: of the asset; None takes that of the views.
    Returns:
        the report, and the files, report.json last.
    Raises:
        ArmError: as the stages.
    """
    check_output(args.output)
    report = run_of.begin(args.preset, args.device, args.seed, progress)
    from ..export import write_asset, written_names
    from ..export.light_file import COMPARISON, write_comparison
    from ..export.one_asset import check_asset_folder, source_of
    from ..photographs.cameras.solving import SolvingOptions
    from ..photographs.intake import load_views, views_are_made
    from ..views.placement import on_the_ground
    from ..views.scene_frame import IDENTITY

    settings, options, kinds = settings_of(args), view_options_of(args), formats_of(args)
    check_asset_folder(args.output, None, args.views)  # Also before views are made there.

    made = views_are_made(args.views, options)

    def read_views(progress: Progress, report: Report) -> ViewSet:
        solving = SolvingOptions(threads=args.threads, seed=args.seed)
        views = load_views(args.views, args.output / "views", options, solving, report, progress)
        if name is not None:
            views = replace(views, name=name)
        if len(os.fsencode(views.name)) > LONGEST_NAME:
            raise InputImageError(f"{args.views}: the name is too long for the files made of it; rename it")
        _check_inputs(args, written_names(views.name, kinds))
        check_asset_folder(args.output, views.name, args.views)
        report.name, report.views = views.name, source_of(args.views, args.output)
        return views

    own_mesh = None if args.mesh is None else partial(mesh_option.own_mesh, args.mesh, args.mesh_up, report)
    drawing = 0.6 if args.multiview != "none" or made else run_of.LOADING_SHARE
    asset = run_of.make(settings, read_views, own_mesh, part(progress, 0.0, 0.85), report, drawing)
    frame = IDENTITY
    if args.place == "ground":
        asset, frame = on_the_ground(asset)
    kept = _record(args, settings, options, made, [frame.scale, *frame.center.tolist()])

    def add_blender_files(stage: Path) -> None:
        if args.preview and asset.comparison is not None:
            write_comparison(asset.comparison, stage / COMPARISON)
        _write_blender_files(asset, stage, kept, args.preview, report, part(progress, 0.9, 0.99))

    files = write_asset(asset, report, args.output, part(progress, 0.85, 0.9), add_blender_files, kinds)
    return report, files


def settings_of(args: argparse.Namespace) -> Settings:
    """The pipeline's settings.

    Raises:
        UsageError: a value is out of range, or the folder of weights has none.
    """
    from ..config import Settings
    from ..networks import check_folder

    try:
        settings = Settings(**values_of(Settings, args))
        check_folder(settings)
    except ArmError as error:
        raise UsageError(str(error)) from error
    return settings


def formats_of(args: argparse.Namespace) -> tuple[str, ...]:
    """What to write besides the .blend.

    Raises:
        UsageError: a format is unknown.
    """
    from .. import export

    try:
        return export.formats_of(args.export)
    except ArmError as error:
        raise UsageError(str(error)) from error


def _check_inputs(args: argparse.Namespace, names: list[str]) -> None:
    """Refuses to write over what is read.

    Raises:
        UsageError: the mesh or the picture is one of the files `names` of the output.
    """
    given = {path.resolve() for path in (args.views, args.mesh) if path is not None}
    for name in names:
        if (args.output / name).resolve() in given:
            raise UsageError(f"{args.output / name}: is read, and would be written over; choose another --output")


def view_options_of(args: argparse.Namespace) -> ViewOptions:
    """How the views are to be taken.

    Raises:
        UsageError: a value is out of range.
    """
    from ..views import ViewOptions
    from ..views.zero123plus.sampling import Zero123PlusConfig

    diffusion = None
    if args.multiview == "none" and (args.reseed or args.multiview_model is not None):
        raise UsageError("--multiview-model, --reseed: are of --multiview zero123plus; add it")
    try:
        if args.multiview_model is not None:
            machine = {"seed": args.seed, "device": args.device, "threads": args.threads}
            drawing = values_of(Zero123PlusConfig, args)
            diffusion = Zero123PlusConfig(args.multiview_model, args.output / "views", **machine, **drawing)
        return ViewOptions(**values_of(ViewOptions, args), zero123plus=diffusion)
    except ArmError as error:
        raise UsageError(str(error)) from error


def _record(
    args: argparse.Namespace, settings: Settings, options: ViewOptions, made: bool, frame: list[float]
) -> dict[str, Any]:
    """What the .blend's object keeps of its run, to be recalled in Blender; `frame` as in `AssetRecord`."""
    chosen, views = chosen_values(settings, options), args.views
    if options.zero123plus is not None:  # Its views lie beside the result, with their cameras.
        chosen["multiview"], views = "none", options.zero123plus.folder
    if made:
        chosen["cameras_from"], views = "auto", args.output / "views"
    mesh = None if args.mesh is None else args.mesh.stem
    record = AssetRecord(chosen, views.absolute(), mesh=mesh, frame=tuple(frame))
    return record.as_json(args.output.absolute())


def _write_blender_files(
    asset: RelightableAsset, stage: Path, kept: dict[str, Any], preview: bool, report: Report, progress: Progress
) -> None:
    """The .blend, and its preview where that is wanted; without bpy the report says that they are left out."""
    blend = stage / f"{asset.name}.blend"
    progress(0.0, f"writing {blend.name}")
    with report.stage("blender"):
        try:
            from ..blender.asset import blend_file as export
            from ..blender.relight import renders as relight
        except ImportError as error:
            report.leave_out(blend.name, f"{NO_BPY} ({error})")
            if preview:
                report.leave_out("preview.png", NO_BPY)
            return
        export.save_blend(asset, blend, kept)
    if preview:
        progress(0.2, "rendering preview.png")
        with report.stage("preview"):
            relight.preview(blend, stage / "preview.png")
