"""What an evaluation leaves in its folder: tables as Markdown and JSON, a sheet per object, the worst ones large."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from arm_blender.files import whole_file, write_json

from .bars import Cost, bars_table
from .measure import OURS, ObjectResult, Shown
from .report_text import as_json, finite, means_table, objects_table, verdicts
from .results import paragraphs, write_text
from .sheets import front_sheet, large_sheet, object_sheet
from .trial import Trial

WORST = 3


class Sheets:
    """Pictures on their way to the folder; only those of the worst objects and of the front page are kept meanwhile."""

    def __init__(self, folder: Path, front: Sequence[str]) -> None:
        """`front` names the objects of the front page."""
        self.folder, self.names = folder, front
        self.worst: list[tuple[float, str, Shown]] = []
        self.front: list[Shown] = []

    def add(self, result: ObjectResult, shown: Shown) -> None:
        """The sheet of one object, at once."""
        _save(self.folder / f"{result.name}.jpg", object_sheet(shown))
        self.worst = sorted([*self.worst, (quality(result), result.name, shown)], key=lambda one: one[:2])[:WORST]
        if result.name in self.names:
            self.front.append(shown)

    def finish(self, picture: Path | None) -> None:
        """The worst objects in full, and the front page's picture."""
        for place, (_, name, shown) in enumerate(self.worst, start=1):
            _save(self.folder / f"worst-{place}-{name}.jpg", large_sheet(shown))
        if picture is not None and self.front:
            picture.parent.mkdir(parents=True, exist_ok=True)
            _save(picture, front_sheet(self.front))


def quality(result: ObjectResult) -> float:
    """What objects are ranked by: dB of relighting inside of the object, or of albedo where nothing was lit."""
    maps = result.systems[OURS].maps
    return maps["relit" if "relit" in maps else "albedo"].psnr_in


def write_tables(folder: Path, results: Sequence[ObjectResult], cost: Cost, trial: Trial, command: str) -> None:
    """`results.md` and `results.json`."""
    sets = [
        part
        for kind in sorted({result.kind for result in results})
        for part in (f"## Means over the set `{kind}`", means_table(results, kind))
    ]
    front = front_text(results, cost, trial, command)
    write_text(folder / "results.md", paragraphs("# Evaluation", front, *sets, "## Objects", objects_table(results)))
    settings = {
        name: str(value) if isinstance(value, Path) else value for name, value in asdict(trial.settings).items()
    }
    record = {
        "command": command,
        "setting": setting_text(results, trial),
        "settings": settings,
        "protocol": asdict(trial.protocol),
        "points": trial.points,
        "seed": trial.seed,
        "cost": finite(asdict(cost)),
        "objects": as_json(results),
    }
    write_json(folder / "results.json", record)


def front_text(results: Sequence[ObjectResult], cost: Cost, trial: Trial, command: str) -> str:
    """The bars' table, and what does not beat its baseline: Markdown for a front page."""
    return paragraphs(
        setting_text(results, trial), bars_table(results, cost), verdicts(results), f"Made by `{command}`."
    )


def setting_text(results: Sequence[ObjectResult], trial: Trial) -> str:
    """What the numbers are of."""
    protocol = trial.protocol
    text = f"{len(results)} objects, {protocol.views} test views of {protocol.resolution}², "
    if trial.cycles:
        text += f"by Cycles at {protocol.samples} samples a pixel (assets {protocol.asset_samples}, all denoised), "
        text += "one environment for inputs and lit colour and one for relighting, "
    else:
        text += "nothing lit, "
    return f"{text}{trial.points:,} points on each surface."


def _save(path: Path, picture) -> None:
    with whole_file(path) as temporary:
        picture.save(temporary, quality=88)
