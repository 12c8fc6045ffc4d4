"""Seconds of the rasteriser for a bumpy sphere: triangles against pixels.

python -m benchmarks.bench_rasterize [--threads N]
"""

import argparse
import statistics
import sys
import time

import torch
import trimesh
from torch import Tensor

from arm_blender.graphics.cameras import Camera, orbit_camera
from arm_blender.graphics.rasterize import rasterize

REPEATS = 5


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--threads", type=int, default=2)
    torch.set_num_threads(parser.parse_args().threads)
    print("triangles  pixels  seconds")
    for subdivisions in (5, 6, 7):
        sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
        vertices = torch.tensor(sphere.vertices, dtype=torch.float32)
        vertices = vertices * (0.8 + 0.1 * torch.sin(12.0 * vertices).prod(dim=1, keepdim=True))
        faces = torch.tensor(sphere.faces, dtype=torch.int64)
        for size in (320, 1024):
            camera = orbit_camera(30.0, 20.0, 4.0, 30.0, size, size)
            print(f"{len(faces):9,}  {size:>4}²  {_median_seconds(vertices, faces, camera):7.3f}")
    return 0


def _median_seconds(vertices: Tensor, faces: Tensor, camera: Camera) -> float:
    rasterize(vertices, faces, camera)  # The first call also pays for torch's start.
    seconds = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        rasterize(vertices, faces, camera)
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


if __name__ == "__main__":
    sys.exit(main())
