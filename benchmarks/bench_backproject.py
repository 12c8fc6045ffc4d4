"""Seconds and memory of six 512² views on their way into an atlas: texels, visibility, sampling and blend.

python -m benchmarks.bench_backproject [--threads N]
"""

import resource
import subprocess
import sys
from pathlib import Path

import torch

from arm_blender.graphics.color import linear_from_srgb
from arm_blender.graphics.rasterize import interpolate, rasterize_views
from arm_blender.structures import UvMesh, ViewSet
from arm_blender.uv.backproject import backproject, blend
from arm_blender.uv.texels import texel_map
from arm_blender.uv.unwrap import UnwrapConfig, unwrap
from arm_blender.views.rigs import zero123plus_rig
from training.evaluation.results import markdown_table, paragraphs

from .measure import Section, median_seconds, run
from .shapes import wavy_ball

FACES = 20_000


def scene() -> tuple[UvMesh, ViewSet]:
    """The wavy ball, and six views of it, coloured by position."""
    mesh, _ = unwrap(wavy_ball(FACES), UnwrapConfig())
    cameras = zero123plus_rig(distance=6.0, size=512)
    fragments = rasterize_views(mesh.vertices, mesh.faces, cameras)
    place = torch.stack([interpolate(mesh.vertices, mesh.faces, fragments[view]) for view in range(len(cameras))])
    color = linear_from_srgb((0.5 + 0.5 * torch.sin(8.0 * place)).clamp(0.0, 1.0))
    mask = fragments.mask[:, None].float()
    return mesh, ViewSet(torch.cat([color * mask, mask], dim=1), cameras, torch.ones(6), "wavy ball")


def onto(mesh: UvMesh, views: ViewSet, size: int) -> None:
    """The work that is measured."""
    blend(backproject(mesh, texel_map(mesh, size), views), views.weights)


def peak_gib(size: int, threads: int) -> float:
    """Memory of a process that does the work once, at its highest."""
    code = (
        "import torch; from benchmarks.bench_backproject import onto, scene; "
        f"torch.set_num_threads({threads}); onto(*scene(), {size})"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[1])
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20  # Linux counts KiB.


def section() -> Section:
    """The table as Markdown."""
    mesh, views = scene()
    rows = []
    for size in (1024, 2048):  # The larger last: the peak is that of all children so far.
        seconds = median_seconds(lambda s=size: onto(mesh, views, s), 3)
        rows.append([f"{size}²", f"{seconds:.2f}", f"{peak_gib(size, torch.get_num_threads()):.2f}"])
    text = paragraphs(
        "## Back-projection",
        f"Six views of 512² onto the atlas of a mesh of {FACES:,} faces, rasterising, visibility, sampling and blend "
        "included; the memory is that of a whole process, torch included.",
        markdown_table(["atlas", "seconds", "peak GiB"], rows),
    )
    what = "back-project six views of 512² onto"
    return Section(text, [(f"{what} {size}", f"{seconds} s, {peak} GiB") for size, seconds, peak in rows])


if __name__ == "__main__":
    run(section, __doc__)
