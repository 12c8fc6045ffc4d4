"""Seconds and quality of atlases: ours beside xatlas alone.

python -m benchmarks.bench_unwrap [--threads N]
"""

import time
from dataclasses import astuple

import numpy as np
import torch
import xatlas

from arm_blender.knobs import SHORTEST_LIMIT
from arm_blender.structures import TriangleMesh, UvMesh
from arm_blender.uv.unwrap import UnwrapConfig, unwrap
from training.documents import markdown_table, paragraphs

from .atlas_quality import atlas_quality
from .measure import Section, run, seconds_of
from .shapes import example_density, example_mesh, wavy_ball

XATLAS_FACES = 75_000
"""Beyond, xatlas alone is left out: it would take minutes."""


LARGEST = 500_000
"""Faces; no input within this may take longer than the user's limit."""

ALONE = "xatlas alone"


def xatlas_alone(mesh: TriangleMesh) -> UvMesh:
    """Charts and packing by xatlas with its default options, for an atlas of 1024 texels a side."""
    atlas = xatlas.Atlas()
    atlas.add_mesh(mesh.vertices.numpy(), mesh.faces.numpy().astype(np.uint32))
    options = xatlas.PackOptions()
    options.resolution, options.padding = 1024, UnwrapConfig().padding
    atlas.generate(xatlas.ChartOptions(), options)
    original, faces, uvs = atlas.get_mesh(0)
    squares = torch.from_numpy(uvs) * torch.tensor([atlas.width, atlas.height]) / max(atlas.width, atlas.height)
    face_uvs = torch.from_numpy(faces.astype(np.int64))
    return UvMesh(
        mesh.vertices, torch.from_numpy(original.astype(np.int64))[face_uvs], squares, face_uvs, atlas.chart_count
    )


def measured() -> list[list[object]]:
    """A row for each shape and each way."""
    density = example_density()
    rows = []
    for name, mesh in [
        *((f"barrel, {n:,} faces", example_mesh(density, n)) for n in (10_000, 20_000)),
        *((f"wavy ball, {n:,} faces", wavy_ball(n)) for n in (10_000, 20_000, 71_000, LARGEST)),
    ]:
        start = time.perf_counter()
        atlas, packing = unwrap(mesh, UnwrapConfig())
        ours = time.perf_counter() - start
        rows.append([name, f"ours, packed by {packing}", f"{ours:.2f}", *_cells(atlas)])
        if len(mesh.faces) <= XATLAS_FACES:
            found: list[UvMesh] = []
            seconds = seconds_of(lambda mesh=mesh, found=found: found.append(xatlas_alone(mesh)))
            rows.append([name, ALONE, f"{seconds:.2f}", *_cells(found[0])])
    return rows


def _cells(atlas: UvMesh) -> list[str]:
    charts, seams, stretch, utilisation, slivers, sliver_area = astuple(atlas_quality(atlas))
    return [
        f"{charts:,}", f"{seams:.1f}", f"{stretch:.3f}", f"{utilisation:.0%}", f"{slivers:.0%}", f"{sliver_area:.2%}"
    ]  # fmt: skip


def section() -> Section:
    """The table as Markdown."""
    unwrap(wavy_ball(2_000), UnwrapConfig())  # The first process reads xatlas from the disk.
    rows = measured()
    largest, limited = wavy_ball(LARGEST), []
    seconds = seconds_of(lambda: limited.append(unwrap(largest, UnwrapConfig(time_limit=SHORTEST_LIMIT))))
    header = ["mesh", "atlas", "seconds", "charts", "seams", "stretch", "utilisation", "slivers", "surface in slivers"]
    text = paragraphs(
        "## Unwrapping",
        "Ours: charts by smoothed axes, laid flat as rigid as possible, packed by xatlas in a process of its own, all "
        "counted. *Seams*: length over the square root of the area. *Stretch*: L2, 1 is none. *Slivers*: charts of "
        "less than four texels of mean width at 1024², and the share of the surface in them.",
        markdown_table(header, rows),
        f"With the shortest time limit that `--time-limit` takes, {SHORTEST_LIMIT:g} s, {LARGEST:,} faces take "
        f"{seconds:.2f} s, and their charts are packed by {limited[0][1]}.",
    )
    alone = {row[0]: row[2] for row in rows if row[1] == ALONE}
    ours = {row[0]: row[2] for row in rows if row[1] != ALONE}
    highlights = [
        (f"unwrap the {name}", f"{ours[name]} s; xatlas alone {alone[name]} s")
        for name in list(ours)[:2]
        if name in alone
    ]
    curves = {
        name: [(_faces(mesh), float(seconds)) for mesh, seconds in found.items() if mesh.startswith("wavy")]
        for name, found in (("ours", ours), (ALONE, alone))
    }
    return Section(text, highlights, curves)


def _faces(name: str) -> float:
    return float(name.split()[2].replace(",", ""))


if __name__ == "__main__":
    run(section, __doc__)
