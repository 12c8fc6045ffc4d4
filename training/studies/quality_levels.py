"""`python -m training quality-levels`: the sweep's rows of the quality levels, where Blender's panel finds them."""

import argparse
import csv
from pathlib import Path
from typing import Any

from arm_blender.config import QUALITIES
from arm_blender.errors import ArmError
from arm_blender.machine.files import write_json
from arm_blender.quality_levels import FILE, STAGES


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training quality-levels`."""
    parser.add_argument("--sweep", type=Path, default=Path("docs/error-and-time.csv"), help="written by `sweep`")
    parser.add_argument("--output", type=Path, default=FILE)


def run(args: argparse.Namespace) -> int:
    """Write the levels' seconds and errors."""
    write_json(args.output, levels(args.sweep))
    print(args.output)
    return 0


def levels(sweep: Path) -> dict[str, dict[str, Any]]:
    """The fields of `MeasuredLevel` for every quality level, from the CSV of a sweep.

    Raises:
        ArmError: the file cannot be read, or a level is not in it.
    """
    try:
        with sweep.open(encoding="utf-8", newline="") as file:
            rows = {row["label"]: row for row in csv.DictReader(file)}
        return {
            name: {
                "seconds": {stage: round(float(rows[name][f"{stage}_seconds"]), 3) for stage in STAGES},
                "chamfer": round(float(rows[name]["chamfer"]), 5),
                "psnr": round(float(rows[name]["psnr"]), 2),
            }
            for name in QUALITIES
        }
    except OSError as error:
        raise ArmError(f"{sweep}: cannot be read ({error.strerror}); run `python -m training sweep` first") from error
    except (KeyError, ValueError) as error:
        raise ArmError(f"{sweep}: has no usable {error}; run `python -m training sweep` again") from error
