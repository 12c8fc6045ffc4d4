"""`python -m training evaluate`: shape, colours, materials and relighting against the truth, beside simple baselines.

With `--data` the truth is rendered once into a cache, the real pipeline runs on every object, its assets are rendered
as the truth was, and one table says where they stand. With `--views` the shapes alone are compared, without Blender.
"""

import argparse
import logging
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from arm_blender.commands.progress_line import Counted
from arm_blender.errors import ArmError
from arm_blender.machine.files import check_output
from arm_blender.views import ViewOptions
from arm_blender.views.zero123plus.sampling import Zero123PlusConfig

from ..documents import fill_block
from ..lpips import Lpips
from ..rendering.manifest import read_manifest
from . import captures
from .cost import measured_cost
from .tables import shape_table
from .tables.output import card_text, front_text, write_tables
from .tables.resume import kept_results
from .tables.sheets import Sheets
from .trials.measure import ONE_VIEW, OURS, ObjectResult, measure
from .trials.other_system import measure_file
from .trials.trial import Trial, add_object_arguments, add_trial_arguments, other_settings, trial_settings
from .truth.captured import captured_objects
from .truth.entries import DATASETS, evaluation_entries, in_fair_order, spread
from .truth.objects import EvaluationObject
from .truth.protocol import PAPER_COUNTS, QUICK, EvaluationEntry, Protocol
from .truth.truth import is_whole, read_truth

logger = logging.getLogger(__name__)

QUICK_OBJECTS, QUICK_POINTS = 6, 30_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training evaluate`."""
    add_object_arguments(parser, required=False)
    add_trial_arguments(parser)
    parser.add_argument("--output", type=Path, default=Path("out/evaluation"), help="folder of tables and pictures")
    parser.add_argument("--no-sheets", action="store_true", help="no picture per object")
    parser.add_argument("--run-time", action="store_true", help="with --views: a column with the seconds per object")
    parser.add_argument(
        "--update-results",
        "--update-readme",
        type=Path,
        nargs="?",
        const=Path("docs/results.md"),
        help="fill the document's block of results; tables made before name it --update-readme",
    )
    parser.add_argument(
        "--update-card", type=Path, nargs="?", const=Path("arm_blender/weights/README.md"), help="fill the model card"
    )
    parser.add_argument("--dataset", default="manifest", choices=DATASETS, help="how the data folder is laid out")
    parser.add_argument("--meshes", type=Path, metavar="DIR", help="another system's <id>.glb instead of ours")
    parser.add_argument("--aligned", action="store_true", help="those lie in no known frame")
    parser.add_argument(
        "--captures", type=Path, metavar="DIR", help="photographs of objects, as render --layout capture writes them"
    )
    parser.add_argument("--update-document", type=Path, metavar="FILE", help="with --captures: fill its block")
    parser.add_argument("--resume", action="store_true", help="keep what the output's results.json has of this trial")
    parser.add_argument("--ids", nargs="*", help="only these objects")
    parser.add_argument("--cache", type=Path, default=Path("out/evaluation-truth"), help="rendered truth, kept")
    parser.add_argument("--resolution", type=int, default=Protocol.resolution, help="pixels a side of every view")
    parser.add_argument("--samples", type=int, default=Protocol.samples, help="of Cycles, a pixel")
    parser.add_argument("--test-views", type=int, default=Protocol.views, help="around the object")
    parser.add_argument(
        "--paper-protocol", action="store_true", help="32 test views, and 24 that are relit under 6 environments"
    )
    parser.add_argument("--quick", action="store_true", help="six objects, four test views, eight samples")
    parser.add_argument("--no-cycles", action="store_true", help="maps and shapes alone: no lit colour, no relighting")
    parser.add_argument("--no-single", action="store_true", help="six views only, not the one view")
    parser.add_argument("--lpips", type=Path, metavar="FILE", help="weights of LPIPS, Alex for the paper's numbers")
    parser.add_argument("--multiview-model", type=Path, metavar="DIR", help="Zero123++'s weights: a row for its views")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="a picture for a front page, a row for each ...")
    parser.add_argument("--picture-of", nargs="*", default=(), metavar="ID", help="... of these objects")


def run(args: argparse.Namespace) -> int:
    """Measure every object, and write `results.md`, `results.json` and the sheets."""
    if args.views is not None:
        return shape_table.run(args)
    protocol = _protocol(args)
    taken = [] if args.captures is None else captured_objects(args.captures)
    if taken:
        args.ids = sorted({capture.object for capture in taken})
    entries, trial = _entries(args), _trial(args, protocol)
    check_output(args.output)
    args.output.mkdir(parents=True, exist_ok=True)
    cache = args.cache / protocol.folder
    render_truth(entries, cache, args.data, args.dataset, protocol)
    if taken:
        document = args.update_document
        return captures.run(taken, entries, trial, cache, args.data, args.output, document, args.command)
    cost = None if args.meshes else measured_cost(cache / entries[0].name, trial)
    known = kept_results(args.output, trial) if args.resume else {}
    results, sheets = [], None if args.no_sheets else Sheets(args.output)
    count = Counted(len(entries), logger.info)
    for entry in entries:
        if entry.name in known and (sheets is None or sheets.has(entry.name)):
            results.append(known[entry.name])
            count.skip()
            continue
        item = EvaluationObject(entry.name, cache / entry.name)
        truth = read_truth(item, args.data, protocol)
        measured = measure if trial.meshes is None else partial(measure_file, trial.meshes)
        result, shown = measured(entry, item, truth, trial)
        results.append(result)
        count(_summary(result))
        if sheets is not None:
            sheets.add(entry.name, shown)
        # After every object: what ends the run leaves a table that says of how many it is.
        write_tables(args.output, results, cost, trial, args.command)
    write_tables(args.output, results, cost, trial, args.command)
    if sheets is not None:
        sheets.finish(results)
        if args.picture is not None:
            sheets.front(args.picture_of, args.picture)
    if args.update_results is not None:
        fill_block(args.update_results, "results", front_text(results, cost, trial, args.command))
    if args.update_card is not None:
        fill_block(args.update_card, "measured", card_text(results, trial, args.command))
    print((args.output / "results.md").read_text(encoding="utf-8"))
    return 0


def _protocol(args: argparse.Namespace) -> Protocol:
    """What the words ask to render.

    Raises:
        ArmError: two of them contradict each other.
    """
    if args.quick and args.paper_protocol:
        raise ArmError("--quick and --paper-protocol: give one of them")
    if args.quick:
        return QUICK
    counts = PAPER_COUNTS if args.paper_protocol else {"views": args.test_views}
    # Fewer samples are for speed: then the assets have no more of them than the truth.
    return Protocol(args.resolution, args.samples, min(args.samples, Protocol.asset_samples), **counts)


def _trial(args: argparse.Namespace, protocol: Protocol) -> Trial:
    """What the words ask to try."""

    def provider(name: str) -> ViewOptions:
        drawing = Zero123PlusConfig(args.multiview_model, args.output / "views" / name, device=args.device)
        return ViewOptions(multiview="zero123plus", zero123plus=drawing)

    return Trial(
        trial_settings(args),
        protocol,
        args.seed,
        QUICK_POINTS if args.quick else Trial.points,
        cycles=not args.no_cycles,
        one_view=not args.no_single,
        perceptual=None if args.lpips is None else Lpips.from_file(args.lpips),
        others=other_settings(args),
        provider=None if args.multiview_model is None else provider,
        meshes=args.meshes,
        own_frame=not args.aligned,
    )


def _entries(args: argparse.Namespace) -> list[EvaluationEntry]:
    """The chosen objects.

    Raises:
        ArmError: none, or `--ids` names others.
    """
    entries = evaluation_entries(args.data, args.dataset, args.split, args.set)
    if args.ids:
        unknown = sorted(set(args.ids) - {entry.name for entry in entries})
        if unknown:
            raise ArmError(f"--ids {' '.join(unknown)}: no such object of split {args.split}")
        entries = [entry for entry in entries if entry.name in args.ids]
    if args.quick and len(entries) > QUICK_OBJECTS:
        entries = spread(entries, QUICK_OBJECTS)
    return in_fair_order(entries)[: args.limit]


def render_truth(entries: Sequence[EvaluationEntry], cache: Path, data: Path, dataset: str, protocol: Protocol) -> None:
    """Whatever the cache lacks; only then Blender is needed here.

    Args:
        cache: folder of the protocol.
        dataset: how `data` is laid out, one of `DATASETS`.
    Raises:
        ArmError: an object cannot be rendered.
    """
    if all(is_whole(cache / entry.name) for entry in entries):
        return
    from .truth.truth_blender import environments, render_missing

    hdris = read_manifest(data)["hdris"] if dataset == "manifest" else []
    lights = {split: [data / h["files"][0] for h in hdris if h["split"] == split] for split in ("train", "eval")}
    render_missing(entries, cache, data, environments(lights), protocol)


def _summary(result: ObjectResult) -> str:
    """A line for the log."""
    ours = result.systems[OURS]
    maps = ", ".join(f"{name} {scores.psnr_in:.1f}" for name, scores in ours.maps.items())
    one = result.systems.get(ONE_VIEW)
    single = f", one view F@0.1 {one.geometry.f_coarse:.3f}" if one is not None and one.geometry is not None else ""
    shape = ours.geometry or ours.aligned
    assert shape is not None, "its shape is compared in the cameras' frame, or else aligned"
    return f"{result.name}: F@0.1 {shape.f_coarse:.3f}, IoU {ours.overlap:.3f}; dB in: {maps}{single}"
