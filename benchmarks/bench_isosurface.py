"""Seconds of the way from a density to an atlas, stage by stage: `python -m benchmarks.bench_isosurface`.

The shape is a ball with waves on it. The density costs almost nothing: what is shown is the work around it.
"""

import argparse
import time

import torch
from torch import Tensor

from arm_blender.graphics.isosurface import IsosurfaceConfig, extract
from arm_blender.graphics.meshes import signed_areas
from arm_blender.structures import TriangleMesh
from arm_blender.uv.decimate import clean, decimate
from arm_blender.uv.unwrap import UnwrapConfig, unwrap


class WavyBall:
    """A density that counts the points and the seconds it is asked for."""

    def __init__(self) -> None:
        self.points, self.seconds = 0, 0.0

    def __call__(self, p: Tensor) -> Tensor:
        started = time.perf_counter()
        values = 10.0 + 50.0 * (0.6 + 0.05 * torch.sin(9.0 * p).sum(dim=1) - p.norm(dim=1))
        self.points += len(p)
        self.seconds += time.perf_counter() - started
        return values


def bench_extraction(resolution: int) -> TriangleMesh:
    """Prints one row; returns the mesh."""
    density = WavyBall()
    started = time.perf_counter()
    mesh = extract(density, IsosurfaceConfig(resolution))
    seconds = time.perf_counter() - started - density.seconds
    share = density.points / resolution**3
    print(f"| extract {resolution}^3 | {seconds:.2f} | {len(mesh.faces)} faces, {share:.1%} of the samples asked for |")
    return mesh


def bench_unwrapping(mesh: TriangleMesh, faces: int) -> None:
    """Prints the rows of cleaning, decimation and both kinds of atlas."""
    started = time.perf_counter()
    mesh = decimate(clean(mesh), faces)
    print(f"| clean and decimate to {faces} | {time.perf_counter() - started:.2f} | {len(mesh.faces)} faces |")
    for limit in (120.0, 0.0):
        started = time.perf_counter()
        atlas, packing = unwrap(mesh, UnwrapConfig(time_limit=limit))
        seconds = time.perf_counter() - started
        covered = float(signed_areas(atlas.uvs, atlas.face_uvs).abs().sum())
        print(f"| unwrap {faces} packed by {packing} | {seconds:.2f} | {atlas.charts} charts cover {covered:.0%} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--threads", type=int, default=1, help="of torch (default 1)")
    parser.add_argument("--faces", type=int, nargs="+", default=[10_000, 20_000], help="face budgets")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    extract(WavyBall(), IsosurfaceConfig(16))  # The table is built once.
    print("| stage | seconds | result |\n|---|---|---|")
    meshes = [bench_extraction(resolution) for resolution in (64, 128, 256)]
    for faces in args.faces:
        bench_unwrapping(meshes[1], faces)


if __name__ == "__main__":
    main()
