"""The sparse iso-surface beside the dense one, on the field of the shipped network.

python -m benchmarks.bench_isosurface [--threads N]
"""

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from arm_blender.graphics.surface.isosurface import IsosurfaceConfig, extract
from arm_blender.graphics.surface.sample_grid import Density
from arm_blender.structures import TriangleMesh
from training.documents import markdown_table, paragraphs

from .measure import Section, run, seconds_of
from .shapes import example_density

RESOLUTIONS = (64, 128, 256, 512)
DENSE_LIMIT = 256
"""Dense grids beyond are not run: their seconds are those of this one, by the number of samples."""


class Counted:
    """A density that counts what it is asked for."""

    def __init__(self, density: Density) -> None:
        self.density, self.points = density, 0

    def __call__(self, points: Tensor) -> Tensor:
        self.points += len(points)
        return self.density(points)


def surface(density: Density, resolution: int, dense: bool) -> tuple[TriangleMesh, float, int]:
    """The mesh, the seconds, and the samples that were asked for."""
    counted, meshes = Counted(density), []
    config = IsosurfaceConfig(resolution, iso=0.0, dense=dense, chunk=2**14)
    seconds = seconds_of(lambda: meshes.append(extract(counted, config)))
    return meshes[0], seconds, counted.points


def hausdorff_cells(a: TriangleMesh, b: TriangleMesh, resolution: int) -> float:
    """The farthest that a vertex of either mesh lies from the vertices of the other, in cells of the grid."""
    one, other = a.vertices.numpy(), b.vertices.numpy()
    distance = max(cKDTree(one).query(other)[0].max(), cKDTree(other).query(one)[0].max())
    return float(distance) * (resolution - 1) / 2.0


def measured() -> list[list[object]]:
    """A row for each resolution."""
    density = example_density()
    rows = []
    dense_seconds = 0.0
    for resolution in RESOLUTIONS:
        mesh, seconds, points = surface(density, resolution, dense=False)
        apart = missed = "not run"
        note = ", by the number of samples"
        if resolution <= DENSE_LIMIT:
            dense, dense_seconds, _ = surface(density, resolution, dense=True)
            apart, note = f"{hausdorff_cells(mesh, dense, resolution):.3f}", ""
            missed = f"{1.0 - len(mesh.faces) / len(dense.faces):.3%}"
        whole = dense_seconds * (resolution / min(resolution, DENSE_LIMIT)) ** 3
        rows.append([
            f"{resolution}³", f"{len(mesh.faces):,}", f"{points:,}", f"{points / resolution**3:.1%}", f"{seconds:.2f}",
            f"{whole:.1f}{note}", f"{whole / seconds:.1f}", missed, apart,
        ])  # fmt: skip
    return rows


def section() -> Section:
    """The table as Markdown."""
    with torch.inference_mode():
        rows = measured()
    header = ["grid", "faces", "samples", "of all", "sparse s", "dense s", "times faster", "missed faces", "Hausdorff"]
    text = paragraphs(
        "## Iso-surface",
        "The field is that of the shipped GeoRM for the committed example. *Missed*: faces of the dense surface that "
        "the sparse one has not, parts that leave no trace on the first samples. *Hausdorff*: the farthest that a "
        "vertex of either mesh lies from the other's, in cells.",
        markdown_table(header, rows),
    )
    highlights = [
        (f"the iso-surface at {row[0]}, where it is instead of everywhere", f"{row[4]} s, {row[6]} times faster")
        for row in rows[2:]
    ]
    samples = [(float(n), float(row[2].replace(",", ""))) for n, row in zip(RESOLUTIONS, rows, strict=True)]
    return Section(text, highlights, {"sparse": samples, "dense": [(n, float(n) ** 3) for n in RESOLUTIONS]})


if __name__ == "__main__":
    run(section, __doc__)
