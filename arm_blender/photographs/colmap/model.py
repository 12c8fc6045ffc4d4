"""A model of COLMAP as a capture: `sparse/0`, binary or text, with the pictures beside it.

RealityCapture, Metashape and others write such models too.
"""

import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ...errors import CameraError, InputImageError
from ...progress import Progress
from ...views.image_io import read_orientation
from ...views.mask_files import mask_beside
from ..capture import Capture, Lens, PosedPhotograph
from ..orientation import oriented
from ..selection import object_center
from .runner import ColmapFailed, arrays

_DISTANCE = 4.0
"""Of the cameras from the object, on average, in a model that had to be set upright: as in our rig."""

_UPRIGHT = 0.94
"""Cosine of 20°: cameras that are held level on average within that show that a model stands upright already."""


def model_folder(path: Path) -> Path | None:
    """The folder of a COLMAP model in a capture's folder, or that folder itself; None where there is none."""
    for folder in (path / "sparse" / "0", path / "sparse", path / "colmap" / "sparse" / "0", path):
        if any((folder / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
            return folder
    return None


def capture_of_colmap(path: Path, progress: Progress) -> Capture:
    """The photographs of a COLMAP model; a model that lies on its side is set upright by how the cameras were held.

    Args:
        path: of the capture, as `model_folder` takes it.
        progress: is told while the model is read.
    Raises:
        CameraError: there is no model, it cannot be read, or a picture's name leaves the folder.
        InputImageError: no picture is there.
        ArmError: pycolmap is not there.
    """
    folder = model_folder(path)
    if folder is None:
        raise CameraError(f"{path}: no cameras.bin or cameras.txt; give the folder with sparse/0 in it")
    try:
        read = arrays("read_model", {"folder": str(folder)}, progress, f"reading {folder.name}")
    except ColmapFailed as error:
        raise CameraError(f"{folder}: no readable model of COLMAP ({error}); export it again") from error
    model = json.loads(str(read["json"]))
    left_out = dict.fromkeys(model["poseless"], "the model has no camera for it")
    photographs = _photographs(model["images"], folder, _root(path, folder), left_out)
    if not photographs:
        raise InputImageError(f"{folder}: has cameras of no picture that is there; put the pictures into images/")
    return _set_upright(Capture(tuple(photographs), torch.from_numpy(read["points"]), left_out))


def _root(path: Path, folder: Path) -> Path:
    """The folder that holds model and pictures."""
    if folder != path:
        return path
    outer = {"0": 2, "sparse": 1}.get(path.name, 0)
    return path.resolve().parents[outer - 1] if outer else path


def _photographs(images: list[Any], folder: Path, root: Path, left_out: dict[str, str]) -> list[PosedPhotograph]:
    """The images of a model whose pictures are there."""
    photographs: list[PosedPhotograph] = []
    missing: list[str] = []
    for name, w2c, (model, parameters, width, height) in images:
        where = f"{folder}: image {name}"
        picture = _picture(root, name, where)
        if picture is None:
            missing.append(name)
            continue
        c2w = _c2w(w2c, where)
        lens = Lens(model, tuple(parameters), width, height)
        try:
            stored_width, stored_height, orientation = read_orientation(picture)
        except InputImageError as error:
            left_out[name] = str(error)
            continue
        # Solved of turned copies, if the shape says so: then it is upright already.
        if (stored_width > stored_height) == (width > height):
            lens, c2w = oriented(lens, c2w, orientation, where)
        photographs.append(PosedPhotograph(picture, c2w, lens, mask_beside(picture, root)))
    if missing:
        left_out[f"{len(missing)} of {len(images)} images"] = f"their pictures are missing, first {missing[0]}"
    return photographs


def _picture(root: Path, name: str, where: str) -> Path | None:
    """The picture of an image: in images/, in input/, or beside the model; inside the folder, links followed."""
    for place in (root / "images" / name, root / "input" / name, root / name):
        if not place.resolve().is_relative_to(root.resolve()):
            raise CameraError(f"{where}: its name leaves the folder; move the picture into images/")
        if place.is_file():
            return place
    return None


def _c2w(w2c: list[list[float]], where: str) -> Tensor:
    """(4, 4) float64 in OpenGL axes, of COLMAP's 3 rows in which y points down and z ahead."""
    matrix = torch.tensor([*w2c, [0.0, 0.0, 0.0, 1.0]], dtype=torch.float64)
    if not bool(matrix.isfinite().all()):
        raise CameraError(f"{where}: its pose has numbers that are none; export the model again")
    c2w = torch.linalg.inv(matrix)
    c2w[:3, 1:3] *= -1.0
    return c2w


def _set_upright(capture: Capture) -> Capture:
    """The capture with Z up: COLMAP's own frame is any. One that stands already stays as it is."""
    c2ws = torch.stack([photograph.c2w for photograph in capture.photographs])
    up = torch.nn.functional.normalize(c2ws[:, :3, 1].mean(dim=0), dim=0)
    if float(up[2]) >= _UPRIGHT:
        return capture
    side = torch.zeros(3, dtype=torch.float64)
    side[int(up.abs().argmin())] = 1.0
    x = torch.nn.functional.normalize(torch.linalg.cross(side, up), dim=0)
    turn = torch.stack([x, torch.linalg.cross(up, x), up])
    center = object_center(c2ws)
    scale = _DISTANCE / float((c2ws[:, :3, 3] - center).norm(dim=-1).mean().clamp(min=1e-9))
    moved = []
    for photograph in capture.photographs:
        c2w = photograph.c2w.clone()
        c2w[:3, :3] = turn @ c2w[:3, :3]
        c2w[:3, 3] = scale * (turn @ (c2w[:3, 3] - center))
        moved.append(PosedPhotograph(photograph.path, c2w, photograph.lens, photograph.mask))
    return Capture(tuple(moved), scale * (capture.points - center) @ turn.T, capture.left_out)
