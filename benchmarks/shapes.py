"""What is measured on: a ball with waves on it, with any number of faces, and the committed example."""

from pathlib import Path

import torch
from torch import Tensor

from arm_blender import pipeline
from arm_blender.config import Settings
from arm_blender.graphics.surface.isosurface import IsosurfaceConfig, extract
from arm_blender.graphics.surface.sample_grid import Density
from arm_blender.report import Report
from arm_blender.structures import TriangleMesh
from arm_blender.uv.decimate import clean, decimate
from arm_blender.views import load_views
from arm_blender.views.scene_frame import normalise

EXAMPLE = next(path.parent for path in sorted(Path(__file__).parents[1].glob("arm_blender/examples/*/transforms.json")))


def waves(points: Tensor) -> Tensor:
    """(P,) density at points (P, 3) whose surface, at 10, is a ball with waves on it."""
    return 10.0 + 50.0 * (0.6 + 0.05 * torch.sin(9.0 * points).sum(dim=1) - points.norm(dim=1))


def wavy_ball(faces: int) -> TriangleMesh:
    """The ball by marching cubes, decimated to `faces`, up to 700,000."""
    resolution = 128 if faces <= 50_000 else 256 if faces <= 200_000 else 448
    return decimate(clean(extract(waves, IsosurfaceConfig(resolution))), faces)


def example_density() -> Density:
    """The density that the shipped `small` GeoRM finds in the example's views; its surface is at 0."""
    views, _ = normalise(load_views(EXAMPLE))
    settings = Settings()
    with torch.inference_mode():
        return pipeline.density(views, settings, Report(settings.preset, settings.device, settings.seed))


def example_mesh(density: Density, faces: int) -> TriangleMesh:
    """The example's surface, decimated to `faces`."""
    with torch.inference_mode():
        return decimate(clean(extract(density, IsosurfaceConfig(128, iso=0.0, chunk=2**14))), faces)
