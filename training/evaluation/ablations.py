"""`python -m training ablations`: fit networks with a part left out, all alike, and compare them on measured objects.

The paper's ablations of InstantAlbedo (ARM, section 6 and supplement), and GeoRM without pixel-aligned features, which
are ours. Each is fitted from scratch in as many steps as the network with all its parts, from the same samples in the
same order. A run that is stopped goes on where it was.
"""

import argparse
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from arm_blender.config import Settings
from arm_blender.errors import ArmError
from arm_blender.files import check_output

from ..datasets import atlases, shards
from ..stages import georm_occupancy, instant_albedo
from .bars import Reader, geometry_score, map_score, mean
from .entries import evaluation_entries, in_fair_order
from .evaluate import render_truth
from .measure import BLEND, HULL, OURS, ObjectResult, measure
from .objects import EvaluationObject
from .output import write_tables
from .protocol import Protocol
from .results import fill_block, markdown_table, paragraphs, write_text
from .resume import kept_results
from .trial import Trial
from .truth import read_truth

logger = logging.getLogger(__name__)

PROTOCOL = Protocol()
"""What the objects are measured by; nothing is lit."""

WHOLE = "none"
"""What the network with all its parts leaves out."""

VIEWS, ALBEDO_RATE = 4, 1e-3
"""Truth views in a step of InstantAlbedo, and its learning rate: for runs this short."""


@dataclass(frozen=True)
class Study:
    """One network and what is left out of it.

    Attributes:
        network: as of `Settings.weights`.
        stage: module of the stage that fits it.
        rows: title in the table by the name of the ablation; `WHOLE` is the first.
    """

    network: str
    stage: ModuleType
    rows: dict[str, str]

    def system(self, ablation: str) -> str:
        """Name of a row's system in `results.json`."""
        return f"{self.network}, {ablation}"


ALBEDO = Study(
    "instant_albedo",
    instant_albedo,
    {
        WHOLE: "nothing left out",
        "no-measurements": "no measurements",
        "no-material-prior": "no material encoder",
        "local-unet": "a local U-Net for FFC-Net",
        "unified-material": "roughness and metallic predicted, too",
        "no-super-resolution": "no super-resolution",
    },
)
SHAPE = Study("georm", georm_occupancy, {WHOLE: "nothing left out", "no-pixel-aligned": "no pixel-aligned features"})


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training ablations`."""
    parser.add_argument("--shards", type=Path, required=True, help="rendered and prepared objects to learn from")
    parser.add_argument("--cache", type=Path, required=True, help="folder of InstantAlbedo's samples, made if missing")
    parser.add_argument("--data", type=Path, help="folder with manifest.json; ARM_DATA by default")
    parser.add_argument("--split", default="eval", choices=("train", "eval"), help="whose objects are measured")
    parser.add_argument("--set", nargs="*", default=["pbr"], help="their sets")
    parser.add_argument("--limit", type=int, help="only so many of them, the same in every run")
    parser.add_argument("--steps", type=int, default=200, help="of every fit of InstantAlbedo")
    parser.add_argument("--georm-steps", type=int, default=150, help="of every fit of GeoRM")
    parser.add_argument("--truth", type=Path, default=Path("out/evaluation-truth"), help="rendered truth, kept")
    parser.add_argument("--output", type=Path, default=Path("out/ablations"), help="folder of weights and tables")
    parser.add_argument(
        "--update-document", type=Path, nargs="?", const=Path("docs/ablations.md"), help="fill its block of ablations"
    )


def run(args: argparse.Namespace) -> int:
    """Fit what is not fitted yet, measure, and write the tables."""
    check_output(args.output)
    others = fitted(ALBEDO, args.steps, args) | fitted(SHAPE, args.georm_steps, args)
    trial = Trial(Settings("small"), PROTOCOL, align=False, cycles=False, one_view=False, others=others)
    results = measured(trial, args)
    text = paragraphs(setting_text(results, args), albedo_table(results), shape_table(results))
    text = paragraphs(text, f"Made by `{args.command}`.")
    write_text(args.output / "ablations.md", text)
    if args.update_document is not None:
        fill_block(args.update_document, "ablations", text)
    print(text)
    return 0


def fitted(study: Study, steps: int, args: argparse.Namespace) -> dict[str, Settings]:
    """Settings with the weights of each row by the name of its system; those that are missing are fitted.

    Raises:
        ArmError: as the stage does.
    """
    # Another budget is another run.
    folder = args.output / f"{study.network}-{steps}-steps"
    found = {ablation: Settings("small", weights_folder=folder / ablation) for ablation in study.rows}
    missing = {ablation: settings for ablation, settings in found.items() if not settings.brings(study.network)}
    if missing and study is ALBEDO:
        atlases.prepare(args.shards, args.cache)
    for ablation, settings in missing.items():
        weights = settings.weights_folder / settings.weights(study.network).name
        words = ["--output", weights, "--steps", steps, "--seed", 0]
        words += ["--data", args.data] if args.data is not None else []
        if study is ALBEDO:
            words += ["--cache", args.cache, "--views", VIEWS, "--learning-rate", ALBEDO_RATE, "--ablation", ablation]
        else:
            words += ["--shards", args.shards, *([f"--{ablation}"] if ablation != WHOLE else [])]
        parser = argparse.ArgumentParser(prog=f"python -m training ablations: {study.system(ablation)}")
        study.stage.add_arguments(parser)
        if study.stage.run(parser.parse_args([str(word) for word in words])) != 0 or not settings.brings(study.network):
            raise ArmError(f"{weights}: was not fitted; see the lines above")
    return {study.system(ablation): settings for ablation, settings in found.items()}


def measured(trial: Trial, args: argparse.Namespace) -> list[ObjectResult]:
    """Every object through all systems; `results.json` keeps what was measured before."""
    entries = in_fair_order(evaluation_entries(args.data, "manifest", args.split, args.set))[: args.limit]
    cache, folder = args.truth / trial.protocol.folder, args.output / "evaluation"
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


def albedo_table(results: Sequence[ObjectResult]) -> str:
    """Markdown: maps inside of the object, by every network of `ALBEDO`, as shipped, and by blending alone."""
    readers = [map_score(*names) for names in _MAPS.values()]
    systems = {BLEND: "*plain blending, no network*", OURS: "*as shipped, from a longer training*"}
    systems |= {ALBEDO.system(ablation): title for ablation, title in ALBEDO.rows.items()}
    return _table(results, systems, ALBEDO, dict(zip(_MAPS, readers, strict=True)), digits=2)


def shape_table(results: Sequence[ObjectResult]) -> str:
    """Markdown: the surface by every network of `SHAPE`, as shipped, and by the visual hull alone."""
    readers = {title: geometry_score(name) for title, name in _SHAPES.items()}
    systems = {HULL: "*visual hull, no network*", OURS: "*as shipped, from a longer training*"}
    systems |= {SHAPE.system(ablation): title for ablation, title in SHAPE.rows.items()}
    return _table(results, systems, SHAPE, readers, digits=3)


_MAPS = {
    "albedo": ("albedo", "psnr_in"),
    "albedo, scaled": ("albedo scaled", "psnr_in"),
    "roughness": ("roughness", "psnr_in"),
    "metallic": ("metallic", "psnr_in"),
}
_SHAPES = {"F@0.1": "f_coarse", "F@0.02": "f_fine", "CD": "chamfer"}


def _table(
    results: Sequence[ObjectResult], systems: dict[str, str], study: Study, readers: dict[str, Reader], digits: int
) -> str:
    """A row per system with its means; the last column counts on how many objects the first reader's is better."""
    first, whole = next(iter(readers.values())), study.system(WHOLE)
    rows = []
    for name, title in systems.items():
        numbers = [mean(results, (), name, read) for read in readers.values()]
        pairs = [(first(r.systems[name]), first(r.systems[whole])) for r in results]
        better = "-" if name == whole else f"{sum(a > b for a, b in pairs)} of {len(pairs)}"
        rows.append([title, *(_number(number, digits) for number in numbers), better])
    name = {"instant_albedo": "InstantAlbedo", "georm": "GeoRM"}[study.network]
    return markdown_table([name, *readers, f"better {next(iter(readers))} than with all parts"], rows)


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def setting_text(results: Sequence[ObjectResult], args: argparse.Namespace) -> str:
    """What was fitted on what, and measured on what."""
    samples, rigs = atlases.files(args.cache), shards.rigs(args.shards)
    owners = {instant_albedo.owner(path) for path in samples}
    return (
        f"InstantAlbedo: {args.steps} steps of one atlas and {VIEWS} views, learning rate {ALBEDO_RATE:g}, "
        f"{len(samples)} samples of {len(owners)} objects. GeoRM: {args.georm_steps} steps of two objects, "
        f"{len(rigs)} rigs of {len({rig.parent for rig in rigs})} objects. A twentieth and a thirty-second of the "
        f"objects validate. Measured on {len(results)} objects of {', '.join(args.set)}, {PROTOCOL.views} views of "
        f"{PROTOCOL.resolution}², PSNR in dB inside of the object; InstantAlbedo's rows have the shape that ships."
    )
