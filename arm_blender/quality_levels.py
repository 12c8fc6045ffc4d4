"""What the quality levels cost and give, as the sweep of `training` measured it. Imports nothing heavy.

The numbers lie in quality_levels.json, which `python -m training quality-levels` makes of docs/error-and-time.csv.
"""

import functools
import json
from dataclasses import dataclass
from pathlib import Path

PRESET = "small"
"""The preset that was measured; nothing is known of the others."""

FILE = Path(__file__).with_suffix(".json")

STAGES = ("shape", "unwrap", "appearance")


@dataclass(frozen=True)
class MeasuredLevel:
    """One quality level: means over the objects of the sweep, six views each.

    Attributes:
        seconds: of each of `STAGES`.
        chamfer: Chamfer distance to the true surface, whose longest side is 2.
        psnr: dB, of the baked colour rendered into the views.
    """

    seconds: dict[str, float]
    chamfer: float
    psnr: float

    @property
    def off_in_shape(self) -> float:
        """Mean distance from the true surface, as a share of the longest side: the Chamfer distance adds both ways."""
        return self.chamfer / 2.0 / 2.0

    @property
    def off_in_color(self) -> float:
        """Root mean square error of the colour, as a share of the whole range from black to white."""
        return float(10.0 ** (-self.psnr / 20.0))


@functools.cache
def measured_levels() -> dict[str, MeasuredLevel]:
    """The levels by name."""
    return {name: MeasuredLevel(**values) for name, values in json.loads(FILE.read_text(encoding="utf-8")).items()}
