"""Lenses and models as COLMAP knows them: which rays a lens sees, and the cameras that other programs have solved.

Loaded by `process.py` alone, which says what may be imported.
"""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

_STEEPEST = 1.75
"""Tangent of the steepest ray, 60° off the axis: what lies further out a plane picture shows smeared."""

_SAMPLES = 65
"""Pixels a side of the picture, from border to border, that say which rays a lens sees."""

_ROUND_TRIP = 0.5
"""Pixels: where a ray's pixel has another ray, the polynomial of the lens has folded back, and shows nothing real."""


def ray_tables(job: dict[str, Any], tell: Callable[..., None]) -> None:
    """Where the rays of lenses land in their pictures.

    Args:
        job: `lenses`, a list of [COLMAP's model, parameters, width, height]; `side`, entries a side of a table; `out`,
            the .npz: `bounds` (L, 4) float64 left, top, right, bottom: tangents of the rays that each lens sees, and
            `places` (L, side, side, 2) float32: pixels as shares of width and height; NaN where a ray is not seen.
    """
    import pycolmap

    side = job["side"]
    bounds = np.empty((len(job["lenses"]), 4))
    places = np.empty((len(job["lenses"]), side, side, 2), np.float32)
    for index, (model, parameters, width, height) in enumerate(job["lenses"]):
        camera = pycolmap.Camera(model=model, params=parameters, width=width, height=height)
        size = np.array([width, height], np.float64)
        bounds[index] = _bounds(camera, size)
        left, top, right, bottom = bounds[index]
        rays = _lattice(np.linspace(left, right, side), np.linspace(top, bottom, side))
        pixels = _seen(camera, rays, size)
        places[index] = (pixels / size).reshape(side, side, 2)
    np.savez(job["out"], bounds=bounds, places=places)


def read_model(job: dict[str, Any], tell: Callable[..., None]) -> None:
    """The cameras, the images and the points of a model of COLMAP, binary or text.

    Args:
        job: `folder` of the model; `out`, the .npz: `json` with `images`, a list of [name, w2c as 3 rows of 4, lens as
            in `ray_tables`], and `poseless`, names; and `points` (P, 3) float64.
    """
    import pycolmap

    model = pycolmap.Reconstruction(job["folder"])
    images, poseless = [], []
    for image in sorted(model.images.values(), key=lambda image: image.name):
        if not image.has_pose:
            poseless.append(image.name)
            continue
        camera = model.cameras[image.camera_id]
        lens = [camera.model.name, camera.params.tolist(), int(camera.width), int(camera.height)]
        images.append([image.name, image.cam_from_world().matrix().tolist(), lens])
    points = np.array([point.xyz for point in model.points3D.values()], np.float64).reshape(-1, 3)
    np.savez(job["out"], json=json.dumps({"images": images, "poseless": poseless}), points=points)


def _bounds(camera: Any, size: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4,) left, top, right, bottom tangents of the rays that land in the picture."""
    pixels = _lattice(np.linspace(0.0, size[0], _SAMPLES), np.linspace(0.0, size[1], _SAMPLES))
    rays = camera.cam_from_img(pixels)
    back = camera.img_from_cam(np.concatenate([rays, np.ones((len(rays), 1))], axis=1))
    with np.errstate(invalid="ignore"):
        true = np.isfinite(rays).all(1) & (np.abs(back - pixels).max(1) < _ROUND_TRIP)
    if not true.any():
        return np.full(4, np.nan)
    rays = rays[true].clip(-_STEEPEST, _STEEPEST)
    return np.concatenate([rays.min(0), rays.max(0)])


def _seen(camera: Any, rays: NDArray[np.float64], size: NDArray[np.float64]) -> NDArray[np.float64]:
    """(R, 2) pixels of rays (R, 2); NaN where the lens's polynomial has folded back."""
    pixels = camera.img_from_cam(np.concatenate([rays, np.ones((len(rays), 1))], axis=1))
    back = camera.cam_from_img(pixels)
    with np.errstate(invalid="ignore"):
        # As pixels, by the focal length: the first parameter of every model that is no panorama.
        folded = ~(np.abs(back - rays).max(1) * camera.mean_focal_length() < _ROUND_TRIP)
        outside = ((pixels < -0.1 * size) | (pixels > 1.1 * size)).any(1)
    # Outside of the picture the inverse need not converge, and nothing is read there.
    pixels[folded & ~outside] = np.nan
    return pixels


def _lattice(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """(Y * X, 2) all pairs, row by row."""
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
