"""The documents that an evaluation leaves: tables as Markdown and JSON, and blocks of other documents."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from arm_blender.config import Settings
from arm_blender.machine.files import write_json
from arm_blender.weight_files.checkpoints import sha256

from ...documents import paragraphs, write_text
from ..trials.measure import ObjectResult
from ..trials.trial import Trial
from .bars import Cost, bars_table
from .report_text import as_json, finite, means_table, objects_table, verdicts

RESULTS = "results.json"


def write_tables(folder: Path, results: Sequence[ObjectResult], cost: Cost | None, trial: Trial, command: str) -> None:
    """`results.md` and `results.json`."""
    sets = [
        part
        for kind in sorted({result.kind for result in results})
        for part in (f"## Means over the set `{kind}`", means_table(results, kind))
    ]
    front = front_text(results, cost, trial, command)
    write_text(folder / "results.md", paragraphs("# Evaluation", front, *sets, "## Objects", objects_table(results)))
    record = {"command": command, "setting": setting_text(results, trial), "trial": trial_record(trial)}
    write_json(folder / RESULTS, record | {"cost": finite(asdict(cost)) if cost else None, "objects": as_json(results)})


def trial_record(trial: Trial) -> dict[str, Any]:
    """What the numbers depend on, for JSON: the settings with the hash of their weights, and the protocol."""

    def described(settings: Settings) -> dict[str, Any]:
        values = {name: value for name, value in asdict(settings).items() if name != "weights_folder"}
        return values | {"weights": {name: sha256(settings.weights(name)) for name in settings.networks}}

    return {
        "settings": described(trial.settings),
        "others": {name: described(settings) for name, settings in trial.others.items()},
        "protocol": asdict(trial.protocol),
        "points": trial.points,
        "seed": trial.seed,
        "align": trial.align,
        "cycles": trial.cycles,
        "one view": trial.one_view,
        "lpips": trial.perceptual is not None,
        "provider": trial.provider is not None,
        "meshes": None if trial.meshes is None else [str(trial.meshes), trial.own_frame],
    }


def front_text(results: Sequence[ObjectResult], cost: Cost | None, trial: Trial, command: str) -> str:
    """The bars' table, and what does not beat its baseline: Markdown for a front page."""
    return paragraphs(
        setting_text(results, trial), bars_table(results, cost), verdicts(results), f"Made by `{command}`."
    )


def card_text(results: Sequence[ObjectResult], trial: Trial, command: str) -> str:
    """What the shipped networks reach, set by set: Markdown for their model card."""
    parts = [setting_text(results, trial)]
    for kind in sorted({result.kind for result in results}):
        parts += [f"Means over the set `{kind}`; PSNR in dB, inside of the object and over the whole picture:"]
        parts += [means_table(results, kind)]
    return paragraphs(*parts, verdicts(results), f"Made by `{command}`.")


def setting_text(results: Sequence[ObjectResult], trial: Trial) -> str:
    """What the numbers are of."""
    protocol = trial.protocol
    text = f"{len(results)} objects, {protocol.views} test views of {protocol.resolution}², "
    if trial.cycles:
        text += f"by Cycles at {protocol.samples} samples a pixel (assets {protocol.asset_samples}, all denoised), "
        text += "one environment for inputs and lit colour"
        if protocol.relit_views is None:
            text += " and one for relighting, "
        else:
            text += f", relighting of {protocol.relit_views} views under {protocol.environments} environments, "
    else:
        text += "nothing lit, "
    return f"{text}{trial.points:,} points on each surface."
