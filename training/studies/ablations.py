"""`python -m training ablations`: fit networks with a part left out, all alike, and compare them on measured objects.

The paper's ablations of InstantAlbedo (ARM, section 6 and supplement). Each is fitted from scratch in as many steps as
the network with all its parts, from the same samples in the same order. A run that is stopped goes on where it was.
"""

import argparse
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from arm_blender.config import Settings
from arm_blender.machine.files import check_output

from ..datasets import atlases
from ..documents import fill_block, markdown_table, paragraphs, write_text
from ..evaluation.evaluate import render_truth
from ..evaluation.tables.bars import Reader, map_score, mean
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


@dataclass(frozen=True)
class Study:
    """One network and what is left out of it.

    Attributes:
        network: as of `Settings.weights`.
        title: in the table.
        rows: title in the table by the name of the ablation; `WHOLE` is the first.
        validated: the stage's own number on held-out objects, in its validations.
        baseline: the same without a network.
        bare: the evaluation's system without this network.
        readers: scores by their title in the table.
        digits: of those.
    """

    network: str
    title: str
    rows: dict[str, str]
    validated: str
    baseline: str
    bare: str
    readers: dict[str, Reader]
    digits: int

    def system(self, ablation: str) -> str:
        """Name of a row's system in `results.json`."""
        return f"{self.network}, {ablation}"


ALBEDO = Study(
    "instant_albedo",
    "InstantAlbedo",
    {
        WHOLE: "nothing left out",
        "no-measurements": "no measurements",
        "no-material-encoder": "no material encoder",
        "local-unet": "a local U-Net for FFC-Net",
        "no-super-resolution": "no super-resolution",
    },
    validated="albedo",
    baseline="blend as albedo",
    bare=BLEND,
    readers={
        "albedo": map_score("albedo", "psnr_in"),
        "albedo, scaled": map_score("albedo scaled", "psnr_in"),
        "roughness": map_score("roughness", "psnr_in"),
        "metallic": map_score("metallic", "psnr_in"),
    },
    digits=2,
)


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
    fits = fitted(ALBEDO, args.steps, args)
    others = {ALBEDO.system(ablation): settings for ablation, settings in fits.items()}
    trial = Trial(Settings(preset="small"), PROTOCOL, align=False, cycles=False, one_view=False, others=others)
    results = measured(trial, args.output / f"evaluation-{ALBEDO.network}", args)
    text = paragraphs(
        setting_text(ALBEDO, args.steps, results, args), table(ALBEDO, fits, results), f"Made by `{args.command}`."
    )
    write_text(args.output / f"{ALBEDO.network}.md", text)
    if args.update_document is not None:
        fill_block(args.update_document, ALBEDO.network, text)
    print(text)
    return 0


def fitted(study: Study, steps: int, args: argparse.Namespace) -> dict[str, Settings]:
    """Settings with the weights of each row by the name of the ablation; those that are missing are fitted.

    Raises:
        ArmError: there is nothing to fit from.
    """
    # Another budget is another run.
    folder = args.output / f"{study.network}-{steps}-steps"
    found = {ablation: Settings(preset="small", weights_folder=folder / ablation) for ablation in study.rows}
    missing = {ablation: settings for ablation, settings in found.items() if not settings.brings(study.network)}
    if missing:
        atlases.prepare(args.shards, args.cache)
    config = TrainerConfig(steps=steps, learning_rate=ALBEDO_RATE, weight_decay=0.0)
    for ablation, settings in missing.items():
        weights = settings.weights_folder / settings.weights(study.network).name
        ablated_albedo.fit(ablation, args.cache, weights, config, VIEWS)
    return found


def measured(trial: Trial, folder: Path, args: argparse.Namespace) -> list[ObjectResult]:
    """Every object through all systems; `results.json` in the folder keeps what was measured before."""
    entries = in_fair_order(evaluation_entries(args.data, "manifest", args.split, args.set))[: args.limit]
    cache = args.truth / trial.protocol.folder
    render_truth(entries, cache, args.data, "manifest", trial.protocol)
    known, results = kept_results(folder, trial), []
    folder.mkdir(parents=True, exist_ok=True)
    for index, entry in enumerate(entries):
        if entry.name not in known:
            item = EvaluationObject(entry.name, cache / entry.name)
            known[entry.name], _ = measure(entry, item, read_truth(item, args.data, trial.protocol), trial)
        results.append(known[entry.name])
        logger.info("%d of %d, %s", index + 1, len(entries), entry.name)
        write_tables(folder, results, None, trial, args.command)
    return results


def table(study: Study, fits: dict[str, Settings], results: Sequence[ObjectResult]) -> str:
    """Markdown: a row per network of a study, as shipped, and without any, with the means over all objects.

    The first column is what the fit's own validation said of held-out objects, the last counts on how many of the
    measured objects the first of the other scores is better than by the network with all its parts.

    Args:
        fits: settings with the weights of each row by the name of the ablation.
    """
    outputs = {name: row.weights(study.network) for name, row in fits.items()}
    systems = [
        (study.bare, "*no network*", last_scalar(outputs[WHOLE], "validation", study.baseline)),
        (OURS, "*as shipped, from a longer training*", None),
    ]
    for name, row in study.rows.items():
        systems.append((study.system(name), row, last_scalar(outputs[name], "validation", study.validated)))
    (title, first), *_ = study.readers.items()
    whole = study.system(WHOLE)
    rows = []
    for system, row, held_out in systems:
        numbers = [held_out, *(mean(results, (), system, read) for read in study.readers.values())]
        pairs = [(first(result.systems[system]), first(result.systems[whole])) for result in results]
        better = "-" if system == whole or not pairs else f"{sum(a > b for a, b in pairs)} of {len(pairs)}"
        rows.append([row, *("-" if x is None else f"{x:.{study.digits}f}" for x in numbers), better])
    header = [study.title, f"held out: {study.validated}", *study.readers, f"better {title} than with all parts"]
    return markdown_table(*without_empty(header, rows))


def setting_text(study: Study, steps: int, results: Sequence[ObjectResult], args: argparse.Namespace) -> str:
    """What was fitted on what, and measured on what."""
    samples = atlases.files(args.cache)
    objects, held_out = len({instant_albedo.owner(path) for path in samples}), "one in twenty"
    text = f"{steps} steps of one atlas and {VIEWS} views each, learning rate {ALBEDO_RATE:g}; {len(samples)} samples"
    text = f"{study.title}: {text} of {objects} objects, of which {held_out} only validates."
    if not results:
        return f"{text} Nothing else was measured."
    views = f"{PROTOCOL.views} views of {PROTOCOL.resolution}²"
    return (
        f"{text} Measured on {len(results)} objects of {', '.join(args.set)}, {views}; PSNR in dB inside of the object."
    )
