"""`python -m training ablations`: fit networks with a part left out, all alike, and compare them on measured objects.

The paper's ablations of InstantAlbedo (ARM, section 6 and supplement). Each is fitted from scratch in as many steps as
the network with all its parts, from the same samples in the same order. A run that is stopped goes on where it was.
"""

import argparse
import logging
from collections.abc import Sequence
from pathlib import Path

from arm_blender.commands.progress_line import Counted
from arm_blender.config import Settings
from arm_blender.machine.files import check_output

from ..datasets import atlases
from ..documents import fill_block, markdown_table, paragraphs, write_text
from ..evaluation.evaluate import render_truth
from ..evaluation.tables.bars import map_score, mean
from ..evaluation.tables.output import write_tables
from ..evaluation.tables.report_text import without_empty
from ..evaluation.tables.resume import kept_results
from ..evaluation.trials.measure import BLEND, OURS, ObjectResult, measure
from ..evaluation.trials.trial import Trial
from ..evaluation.truth.entries import evaluation_entries, in_fair_order
from ..evaluation.truth.objects import EvaluationObject
from ..evaluation.truth.protocol import Protocol
from ..evaluation.truth.truth import read_truth
from ..options import TrainerConfig
from ..run_record import last_scalar
from ..stages import instant_albedo
from . import ablated_albedo
from .ablated_albedo import WHOLE

logger = logging.getLogger(__name__)

PROTOCOL = Protocol()
"""What the objects are measured by; nothing is lit."""

VIEWS, ALBEDO_RATE = 4, 1e-3
"""Truth views in a step of InstantAlbedo, and its learning rate: for runs this short."""


NETWORK = "instant_albedo"
"""As of `Settings.weights`."""

ROWS = {
    WHOLE: "nothing left out",
    "no-measurements": "no measurements",
    "no-material-encoder": "no material encoder",
    "local-unet": "a local U-Net for FFC-Net",
    "no-super-resolution": "no super-resolution",
}
"""Titles in the table by the name of the ablation."""

READERS = {
    "albedo": map_score("albedo", "psnr_in"),
    "albedo, scaled": map_score("albedo scaled", "psnr_in"),
    "roughness": map_score("roughness", "psnr_in"),
    "metallic": map_score("metallic", "psnr_in"),
}
"""Scores by their title in the table, dB."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training ablations`."""
    parser.add_argument("--shards", type=Path, required=True, help="rendered and prepared objects to learn from")
    parser.add_argument("--cache", type=Path, required=True, help="folder of InstantAlbedo's samples, made if missing")
    parser.add_argument("--data", type=Path, help="folder with manifest.json; ARM_DATA by default")
    parser.add_argument("--split", default="eval", choices=("train", "eval"), help="whose objects are measured")
    parser.add_argument("--set", nargs="*", default=["pbr"], help="their sets")
    parser.add_argument("--limit", type=int, help="only so many, the same in every run; 0 fits alone")
    parser.add_argument("--steps", type=int, default=200, help="of every fit of InstantAlbedo")
    parser.add_argument("--truth", type=Path, default=Path("out/evaluation-truth"), help="rendered truth, kept")
    parser.add_argument("--output", type=Path, default=Path("out/ablations"), help="folder of weights and tables")
    parser.add_argument(
        "--update-document",
        type=Path,
        nargs="?",
        const=Path("docs/ablations.md"),
        help="fill its block of the network",
    )


def run(args: argparse.Namespace) -> int:
    """Fit what is not fitted yet, measure, and write the table."""
    check_output(args.output)
    ablated_albedo.register()
    fits = fitted(args)
    others = {system(ablation): settings for ablation, settings in fits.items()}
    trial = Trial(Settings(preset="small"), PROTOCOL, align=False, cycles=False, one_view=False, others=others)
    results = measured(trial, args.output / f"evaluation-{NETWORK}", args)
    text = paragraphs(setting_text(results, args), table(fits, results), f"Made by `{args.command}`.")
    write_text(args.output / f"{NETWORK}.md", text)
    if args.update_document is not None:
        fill_block(args.update_document, NETWORK, text)
    print(text)
    return 0


def system(ablation: str) -> str:
    """Name of a row's system in `results.json`."""
    return f"{NETWORK}, {ablation}"


def fitted(args: argparse.Namespace) -> dict[str, Settings]:
    """Settings with the weights of each row by the name of the ablation; those that are missing are fitted.

    Raises:
        ArmError: there is nothing to fit from.
    """
    # Another budget is another run.
    folder = args.output / f"{NETWORK}-{args.steps}-steps"
    found = {ablation: Settings(preset="small", weights_folder=folder / ablation) for ablation in ROWS}
    missing = {ablation: settings for ablation, settings in found.items() if not settings.brings(NETWORK)}
    if missing:
        atlases.prepare(args.shards, args.cache)
    config = TrainerConfig(steps=args.steps, learning_rate=ALBEDO_RATE, weight_decay=0.0)
    for ablation, settings in missing.items():
        weights = folder / ablation / settings.weights(NETWORK).name
        ablated_albedo.fit(ablation, args.cache, weights, config, VIEWS)
    return found


def measured(trial: Trial, folder: Path, args: argparse.Namespace) -> list[ObjectResult]:
    """Every object through all systems; `results.json` in the folder keeps what was measured before."""
    entries = in_fair_order(evaluation_entries(args.data, "manifest", args.split, args.set))[: args.limit]
    cache = args.truth / trial.protocol.folder
    render_truth(entries, cache, args.data, "manifest", trial.protocol)
    known, results = kept_results(folder, trial), []
    folder.mkdir(parents=True, exist_ok=True)
    count = Counted(len(entries), logger.info)
    for entry in entries:
        if entry.name in known:
            count.skip()
        else:
            item = EvaluationObject(entry.name, cache / entry.name)
            known[entry.name], _ = measure(entry, item, read_truth(item, args.data, trial.protocol), trial)
            count(entry.name)
        results.append(known[entry.name])
        write_tables(folder, results, None, trial, args.command)
    return results


def table(fits: dict[str, Settings], results: Sequence[ObjectResult]) -> str:
    """Markdown: a row per network, as shipped, and without any, with the means over all objects.

    The first column is what the fit's own validation said of held-out objects, the last counts on how many of the
    measured objects the first of the other scores is better than by the network with all its parts.

    Args:
        fits: settings with the weights of each row by the name of the ablation.
    """
    outputs = {name: settings.weights(NETWORK) for name, settings in fits.items()}
    systems = [
        (BLEND, "*no network*", last_scalar(outputs[WHOLE], "validation", "blend as albedo")),
        (OURS, "*as shipped, from a longer training*", None),
        *((system(name), row, last_scalar(outputs[name], "validation", "albedo")) for name, row in ROWS.items()),
    ]
    (title, first), *_ = READERS.items()
    whole, rows = system(WHOLE), []
    for name, row, held_out in systems:
        numbers = [held_out, *(mean(results, (), name, read) for read in READERS.values())]
        pairs = [(first(result.systems[name]), first(result.systems[whole])) for result in results]
        won = sum(a > b for a, b in pairs if a is not None and b is not None)
        better = "-" if name == whole or not pairs else f"{won} of {len(pairs)}"
        rows.append([row, *("-" if x is None else f"{x:.2f}" for x in numbers), better])
    header = ["InstantAlbedo", "held out: albedo", *READERS, f"better {title} than with all parts"]
    return markdown_table(*without_empty(header, rows))


def setting_text(results: Sequence[ObjectResult], args: argparse.Namespace) -> str:
    """What was fitted on what, and measured on what."""
    samples = atlases.files(args.cache)
    objects, held_out = len({instant_albedo.owner(path) for path in samples}), "one in twenty"
    text = f"InstantAlbedo: {args.steps} steps of one atlas and {VIEWS} views each, learning rate {ALBEDO_RATE:g}; "
    text += f"{len(samples)} samples of {objects} objects, of which {held_out} only validates."
    if not results:
        return f"{text} Nothing else was measured."
    views = f"{PROTOCOL.views} views of {PROTOCOL.resolution}²"
    return (
        f"{text} Measured on {len(results)} objects of {', '.join(args.set)}, {views}; PSNR in dB inside of the object."
    )
