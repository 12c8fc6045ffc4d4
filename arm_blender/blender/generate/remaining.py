"""A guess at the seconds that a run still takes. No bpy in this module."""

from ...progress import SHARES
from ...quality_levels import PRESET, STAGES, measured_levels
from ...run import LOADING_SHARE

_PRIOR = 3.0
"""Seconds that the measured ones count for before this machine has shown its own speed."""

_UNKNOWN = {"shape": 1.0, "unwrap": 0.2, "appearance": 1.0}
"""Relative seconds of the stages where nothing was measured."""


class Remaining:
    """Learns, while a run goes on, how fast this machine is against the one of the sweep.

    Args:
        preset, quality: of the run.
        own_mesh: the shape is given, so that its stage takes nothing.
    """

    def __init__(self, preset: str, quality: str, own_mesh: bool) -> None:
        self._measured = preset == PRESET
        expected = dict(measured_levels()[quality].seconds if self._measured else _UNKNOWN)
        if own_mesh:
            expected["shape"] = 0.0
        self._expected = expected
        self._began: float | None = None

    def seconds(self, fraction: float, elapsed: float) -> float | None:
        """Seconds that are left; None before anything can be said.

        Args:
            fraction: of the run's progress, in [0, 1].
            elapsed: seconds since its start.
        """
        total = sum(self._expected.values())
        if fraction <= LOADING_SHARE:
            return total if self._measured else None
        if self._began is None:
            self._began = elapsed
        done = self._expected_until((fraction - LOADING_SHARE) / (1.0 - LOADING_SHARE))
        prior = _PRIOR if self._measured else 0.0
        if done + prior == 0.0:
            return None
        return (total - done) * (elapsed - self._began + prior) / (done + prior)

    def _expected_until(self, fraction: float) -> float:
        """Expected seconds from the start of the pipeline until its own progress is `fraction`."""
        seconds = 0.0
        for stage in STAGES:
            start, end = SHARES[stage]
            seconds += self._expected[stage] * min(1.0, max(0.0, (fraction - start) / (end - start)))
        return seconds


def clock(seconds: float) -> str:
    """Seconds as a stopwatch shows them: 0:07, 12:40."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"
