"""A box with a knob whose sides have a colour each, and what cameras see of it: the right result is known.

The knob tells the sides apart, also to an eye that takes one for another.
"""

from pathlib import Path

import numpy as np
import torch

from arm_blender.graphics.cameras import Camera, orbit_camera
from arm_blender.graphics.color import linear_from_srgb, srgb_from_linear
from arm_blender.graphics.meshes import face_normals
from arm_blender.graphics.raster.rasterize import rasterize
from arm_blender.structures import TriangleMesh, UvMesh, ViewSet
from arm_blender.uv.backproject import backproject
from arm_blender.uv.blend import blend
from arm_blender.uv.texels import texel_map
from arm_blender.views.image_io import write_png
from arm_blender.views.transforms_json import write_transforms

COLORS = {
    "+x": (0.9, 0.2, 0.1),
    "-x": (0.1, 0.7, 0.3),
    "+y": (0.2, 0.3, 0.9),
    "-y": (0.9, 0.8, 0.2),
    "+z": (0.9, 0.9, 0.9),
    "-z": (0.7, 0.2, 0.7),
}
"""sRGB of the sides, by their normals."""

BODY = (-0.8, -0.4, -0.5), (0.8, 0.4, 0.1)
KNOB = (0.4, -0.4, 0.1), (0.8, 0.4, 0.6)
"""Lowest and highest corner."""

AROUND = tuple(zip((20.0, 80.0, 140.0, 200.0, 260.0, 320.0), (25.0, -25.0) * 3, strict=True))
"""Azimuth and elevation of six cameras that together see every side, degrees."""

FINER = 3
"""Samples of a pixel's side."""


def corners(low, high) -> tuple[np.ndarray, np.ndarray]:
    """(8, 3) corners of a box, and (6, 4) its sides in the order of `COLORS`, counter-clockwise from outside."""
    places = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    quads = [(4, 6, 7, 5), (0, 1, 3, 2), (2, 3, 7, 6), (0, 4, 5, 1), (1, 5, 7, 3), (0, 2, 6, 4)]
    return np.where(places, np.array(high), np.array(low)).astype(np.float32), np.array(quads)


def split_box(low, high) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(24, 3) vertices of a box, (24, 2) UVs of six squares side by side, and (12, 3) faces."""
    points, quads = corners(low, high)
    column, row = np.arange(6) % 3, np.arange(6) // 3
    square = np.array([[0.05, 0.05], [0.95, 0.05], [0.95, 0.95], [0.05, 0.95]])
    uvs = (np.stack([column, row], 1)[:, None] + square) / (3, 2)
    first = 4 * np.arange(6)[:, None]
    faces = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]])
    return points[quads].reshape(-1, 3), uvs.reshape(-1, 2).astype(np.float32), faces


def box_mesh() -> TriangleMesh:
    """Body and knob."""
    (first, _, faces), (second, _, more) = split_box(*BODY), split_box(*KNOB)
    vertices, faces = np.concatenate([first, second]), np.concatenate([faces, more + len(first)])
    return TriangleMesh(torch.from_numpy(vertices), torch.from_numpy(faces))


def cameras(size: int = 128, distance: float = 5.0, fovy_deg: float = 30.0) -> tuple[Camera, ...]:
    return tuple(orbit_camera(azimuth, elevation, distance, fovy_deg, size, size) for azimuth, elevation in AROUND)


def picture(camera: Camera, mesh: TriangleMesh | None = None) -> torch.Tensor:
    """(4, H, W) linear, straight alpha: the box without light, antialiased."""
    mesh = mesh or box_mesh()
    fragments = rasterize(mesh.vertices, mesh.faces, camera.resized(FINER * camera.width, FINER * camera.height))
    side = sides(face_normals(mesh.vertices, mesh.faces))
    sample = linear_from_srgb(torch.tensor(list(COLORS.values())))[side][fragments.face_id].permute(2, 0, 1)
    sample = torch.cat([sample * fragments.mask, fragments.mask[None]])
    image = torch.nn.functional.avg_pool2d(sample[None], FINER)[0]
    return torch.cat([image[:3] / image[3:].clamp(min=1e-6), image[3:]])


def pictures(views: tuple[Camera, ...]) -> list[torch.Tensor]:
    return [picture(camera) for camera in views]


def view_set(views: tuple[Camera, ...] | None = None) -> ViewSet:
    views = views or cameras()
    return ViewSet(torch.stack(pictures(views)), views, torch.ones(len(views)), "box")


def write_views(folder: Path, images: list[torch.Tensor] | None = None, views: tuple[Camera, ...] = ()) -> Path:
    """A folder of PNGs with transforms.json."""
    views = views or cameras()
    folder.mkdir(parents=True, exist_ok=True)
    names = [f"{index}.png" for index in range(len(views))]
    for name, image in zip(names, images or pictures(views), strict=True):
        write_png(folder / name, image, srgb=True)
    write_transforms(folder / "transforms.json", names, views)
    return folder


def sides(normals: torch.Tensor) -> torch.Tensor:
    """(N,) index in `COLORS` of the side that normals (N, 3) look to."""
    axis = normals.abs().argmax(dim=1)
    return 2 * axis + (normals.gather(1, axis[:, None])[:, 0] < 0.0)


def side_errors(mesh: UvMesh, views: ViewSet, size: int = 256) -> tuple[dict[str, float], float]:
    """By side the median of how far the blended colour is off, sRGB; and the share of texels that are seen."""
    texels = texel_map(mesh, size)
    color, weight = blend(backproject(mesh, texels, views), views.weights)
    seen = (weight > 0.0) & texels.mask
    side, found = sides(texels.normal[:, seen].T), srgb_from_linear(color[:, seen]).T
    errors = (found - torch.tensor(list(COLORS.values()))[side]).abs().amax(dim=1)
    of_side = {name: errors[side == index] for index, name in enumerate(COLORS)}
    medians = {name: float(found.median()) for name, found in of_side.items() if len(found)}
    return medians, float(seen.sum() / texels.mask.sum())
