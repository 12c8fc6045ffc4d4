"""Plots without a display, written whole or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from arm_blender.machine.files import whole_file


@contextmanager
def panels(path: Path, count: int, width: float, height: float) -> Iterator[Any]:
    """An array of `count` axes side by side, `width` x `height` inches in all; a PNG when the block ends."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, count, figsize=(width, height), layout="constrained", squeeze=False)
    try:
        yield axes[0]
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as temporary:
            figure.savefig(temporary, format="png", dpi=110)
    finally:
        pyplot.close(figure)
