"""How far a run is: one callback for every stage, and the place where a stop is noticed. Imports nothing heavy."""

from collections.abc import Callable

Progress = Callable[[float, str], None]
"""Called with a fraction in [0, 1] and what is being done. It raises `Cancelled` when the user has stopped the run."""

SHARES = {"shape": (0.0, 0.4), "unwrap": (0.4, 0.6), "appearance": (0.6, 0.95), "check by light": (0.97, 1.0)}
"""Of the pipeline's progress, from where to where each stage goes."""


def silent(fraction: float, message: str) -> None:
    """The progress callback that reports to nobody."""


def part(progress: Progress, start: float, end: float) -> Progress:
    """A `Progress` whose 0 to 1 is `start` to `end` of `progress`: a stage's own, as a part of the run's."""
    return lambda fraction, message: progress(start + (end - start) * fraction, message)
