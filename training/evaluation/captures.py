"""Simulated captures through the program, beside the truth: the loop of `python -m training evaluate --captures`."""

import logging
from collections.abc import Sequence
from pathlib import Path

from arm_blender.commands.progress_line import Counted

from ..documents import fill_block
from .tables.capture_table import save_overview, save_sheet, summary, write_results
from .trials.capture_trial import CaptureResult, measure_capture
from .trials.trial import Trial
from .truth.captured import CapturedObject
from .truth.objects import EvaluationObject
from .truth.protocol import EvaluationEntry
from .truth.truth import read_truth

logger = logging.getLogger(__name__)


def run(
    captures: Sequence[CapturedObject],
    entries: Sequence[EvaluationEntry],
    trial: Trial,
    cache: Path,
    data: Path,
    output: Path,
    document: Path | None,
    command: str,
) -> int:
    """Measure every capture; `captures.md`, `captures.json` a sheet of each and `overview.jpg` in `output`.

    Args:
        captures: of the objects of `entries`, whose truth lies whole in `cache`.
        document: whose block `captures` is filled; None fills none.
    """
    known = {entry.name: entry for entry in entries}
    results: list[CaptureResult] = []
    count = Counted(len(captures), logger.info)
    for capture in captures:
        item = EvaluationObject(capture.object, cache / capture.object)
        truth = read_truth(item, data, trial.protocol)
        result, found = measure_capture(
            capture, known[capture.object], item, truth, trial, output / "assets" / capture.name
        )
        results.append(result)
        count(f"{capture.name}: {result.answer.said}")
        save_sheet(output / f"{capture.name}.jpg", capture, found)
        write_results(output, results, command)
    save_overview(output / "overview.jpg", [output / f"{capture.name}.jpg" for capture in captures])
    text = summary(results, command)
    if document is not None:
        fill_block(document, "captures", text)
    print(text)
    return 0
