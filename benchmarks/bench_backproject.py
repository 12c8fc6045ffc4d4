"""Seconds and memory of six 512² views on their way into an atlas: texels, visibility, sampling and blend.

python -m benchmarks.bench_backproject [--threads N]
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import torch

from arm_blender.graphics.color import linear_from_srgb
from arm_blender.graphics.raster.rasterize import interpolate, rasterize_views
from arm_blender.structures import UvMesh, ViewSet
from arm_blender.uv.backproject import backproject
from arm_blender.uv.blend import blend
from arm_blender.uv.texels import texel_map
from arm_blender.uv.unwrap import UnwrapConfig, unwrap
from arm_blender.views.rigs import zero123plus_rig
from training.documents import markdown_table, paragraphs

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


def peak_gib(mesh: UvMesh, views: ViewSet, size: int) -> float:
    """Memory of a process that does this work once, and nothing else, at its highest."""
    code = (
        "import sys, torch; from arm_blender.report import peak_memory_mib; "
        "from benchmarks.bench_backproject import onto; "
        "mesh, views = torch.load(sys.argv[1], weights_only=False); torch.set_num_threads(int(sys.argv[3])); "
        "onto(mesh, views, int(sys.argv[2])); print(peak_memory_mib())"
    )
    with tempfile.TemporaryDirectory() as folder:
        scene_file = Path(folder) / "scene.pt"
        torch.save((mesh, views), scene_file)
        command = [sys.executable, "-c", code, str(scene_file), str(size), str(torch.get_num_threads())]
        done = subprocess.run(command, check=True, cwd=Path(__file__).parents[1], capture_output=True, text=True)
    return float(done.stdout) / 1024


def section() -> Section:
    """The table as Markdown."""
    mesh, views = scene()
    rows = []
    for size in (1024, 2048):
        seconds = median_seconds(lambda s=size: onto(mesh, views, s), 3)
        rows.append([f"{size}²", f"{seconds:.2f}", f"{peak_gib(mesh, views, size):.2f}"])
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
