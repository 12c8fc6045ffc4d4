"""What an evaluation leaves in its folder: tables as Markdown and JSON, a sheet per object, the worst ones large."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from arm_blender.files import whole_file, write_json

from .bars import Cost, bars_table
from .measure import OURS, ObjectResult, Shown
from .report_text import as_json, finite, means_table, objects_table, verdicts
from .results import fill_block, paragraphs, write_text
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


def write_tables(
    folder: Path, results: Sequence[ObjectResult], cost: Cost, trial: Trial, command: str, readme: Path | None
) -> None:
    """`results.md`, `results.json`, and the document's block of results."""
    lights = "" if trial.cycles else " Nothing was lit: lit colour and relighting have no numbers."
    setting = (
        f"{len(results)} objects, {trial.protocol.views} test views of {trial.protocol.resolution}², truth and assets by "
        f"Cycles at {trial.protocol.samples} samples a pixel, one light for the inputs and one for relighting, "
        f"{trial.points:,} points on each surface.{lights}"
    )
    made = f"Made by `{command}`."
    table, words = bars_table(results, cost), verdicts(results)
    sets = [
        part
        for kind in sorted({result.kind for result in results})
        for part in (f"## Means over the set `{kind}`", means_table(results, kind))
    ]
    parts = ["# Evaluation", setting, table, words, *sets, "## Objects", objects_table(results), made]
    write_text(folder / "results.md", paragraphs(*parts))
    record = {"command": command, "setting": setting, "cost": asdict(cost), "points": trial.points, "seed": trial.seed}
    settings = {
        name: str(value) if isinstance(value, Path) else value for name, value in asdict(trial.settings).items()
    }
    protocol = asdict(trial.protocol)
    write_json(
        folder / "results.json",
        record
        | {"settings": settings, "protocol": protocol, "objects": as_json(results)}
        | {"cost": finite(asdict(cost))},
    )
    if readme is not None:
        fill_block(readme, "results", paragraphs(setting, table, words, made))


def _save(path: Path, picture) -> None:
    with whole_file(path) as temporary:
        picture.save(temporary, quality=88)
