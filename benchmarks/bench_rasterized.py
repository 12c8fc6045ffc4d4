"""Seconds of training data made on the fly, beside those of the training step that it is for.

python -m benchmarks.bench_rasterized [--threads N]
"""

import tempfile
from pathlib import Path

import torch

from arm_blender.models.instant_albedo import SMALL, InstantAlbedo
from training.datasets import rasterized, rasterized_surface
from training.datasets.atlases import AtlasConfig
from training.datasets.rasterized_atlases import RasterizedAtlases
from training.datasets.shards import save_arrays
from training.evaluation.results import markdown_table, paragraphs
from training.stages.instant_albedo import FitConfig, sample_loss

from .measure import Section, median_seconds, run, seconds_of
from .shapes import wavy_ball

FACES, REPEATS = 5_000, 7


def section() -> Section:
    """The table as Markdown."""
    shape, library = wavy_ball(FACES), rasterized.Library([], [])
    seconds = {"make a shape ready, once": seconds_of(lambda: rasterized_surface.surface_of(shape))}
    with tempfile.TemporaryDirectory() as folder:
        mesh = Path(folder) / "ball" / "mesh.npz"
        mesh.parent.mkdir()
        save_arrays(mesh, {"vertices": shape.vertices.numpy(), "faces": shape.faces.numpy()})
        source = RasterizedAtlases([mesh], Path(folder) / "kept", library, config=AtlasConfig(faces=FACES))
        generator = torch.Generator().manual_seed(0)
        surface = source.shape(mesh)[1]
        seconds["a rig: ten views of 192²"] = median_seconds(
            lambda: rasterized.random_rig(surface, library, 192, generator), REPEATS
        )
        seconds["a sample of InstantAlbedo: such a rig, back-projected"] = median_seconds(
            lambda: source.draw(generator), REPEATS
        )
        atlas = source.draw(torch.Generator().manual_seed(1))
        while len(atlas.images) < 6:
            atlas = source.draw(generator)
    model = InstantAlbedo(SMALL)
    seconds["a step of InstantAlbedo at `small`, six views in, loss and gradient"] = median_seconds(
        lambda: sample_loss(model, atlas, FitConfig(), generator)[0].backward(), REPEATS
    )
    rows = [[what, f"{value:.2f}"] for what, value in seconds.items()]
    text = paragraphs(
        "## Training pictures on the fly",
        f"A wavy ball of {FACES:,} faces, procedural materials and light, {torch.get_num_threads()} thread(s).",
        markdown_table(["what", "seconds"], rows),
    )
    return Section(text, [(what, f"{value} s") for what, value in rows])


if __name__ == "__main__":
    run(section, __doc__)
