"""Processor seconds of training data made on the fly, beside those of the training step that it is for.

python -m benchmarks.bench_rasterized [--threads N]
"""

import itertools
import statistics
import tempfile
from collections.abc import Callable
from pathlib import Path

import torch

from arm_blender.models.small.instant_albedo import SMALL, InstantAlbedo
from training.datasets.atlases import AtlasConfig
from training.datasets.rasterized_atlases import RasterizedAtlases
from training.documents import markdown_table, paragraphs
from training.rasterized import pictures as rasterized
from training.rasterized import surface as rasterized_surface
from training.rendering.shards import save_arrays
from training.stages.instant_albedo import FitConfig, sample_loss

from .measure import Section, cpu_seconds, run
from .shapes import wavy_ball

FACES, REPEATS = 5_000, 11


def median_cpu_seconds(call: Callable[[], object], repeats: int = REPEATS) -> float:
    """The median of `repeats` calls, after one that is not counted; other work on the machine does not count."""
    call()
    seconds = []
    for _ in range(repeats):
        start = cpu_seconds()
        call()
        seconds.append(cpu_seconds() - start)
    return statistics.median(seconds)


def section() -> Section:
    """The table as Markdown."""
    shape, library = wavy_ball(FACES), rasterized.Library([], [])
    seconds = {"make a shape ready, once": median_cpu_seconds(lambda: rasterized_surface.surface_of(shape), 1)}
    with tempfile.TemporaryDirectory() as folder:
        mesh = Path(folder) / "ball" / "mesh.npz"
        mesh.parent.mkdir()
        save_arrays(mesh, {"vertices": shape.vertices.numpy(), "faces": shape.faces.numpy()})
        source = RasterizedAtlases([mesh], Path(folder) / "kept", library, config=AtlasConfig(faces=FACES))
        generator = torch.Generator().manual_seed(0)
        surface = source.shape(mesh)[1]
        seconds["a rig: ten views of 192²"] = median_cpu_seconds(
            lambda: rasterized.random_rig(surface, library, 192, generator)
        )
        seconds["a sample of InstantAlbedo: such a rig, back-projected"] = median_cpu_seconds(
            lambda: source.draw(generator)
        )
        drawn = [source.draw(generator) for _ in range(REPEATS + 1)]
    model, samples = InstantAlbedo(SMALL), itertools.cycle(drawn)
    seconds["a step of InstantAlbedo at `small` with such samples: loss and gradient"] = median_cpu_seconds(
        lambda: sample_loss(model, next(samples), FitConfig(), generator)[0].backward()
    )
    rows = [[what, f"{value:.2f}"] for what, value in seconds.items()]
    text = paragraphs(
        "## Training pictures on the fly",
        f"A wavy ball of {FACES:,} faces, procedural materials and light, {torch.get_num_threads()} thread(s).",
        markdown_table(["what", "processor seconds"], rows),
    )
    return Section(text, [(what, f"{value} s") for what, value in rows])


if __name__ == "__main__":
    run(section, __doc__)
