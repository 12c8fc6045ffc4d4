"""Captures as other programs write them."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from arm_blender.photographs.capture import Lens

from .ball import photograph


def write_pictures(folder: Path, poses: list[np.ndarray], one: Lens, masks: str | None = None, **options) -> list[str]:
    """`0000.png` and so on in `folder`, and their masks where `masks`, with the name in place of {}, says."""
    folder.mkdir(parents=True, exist_ok=True)
    names = []
    for index, c2w in enumerate(poses):
        color, mask = photograph(c2w, one, **options)
        names.append(f"{index:04d}.png")
        Image.fromarray(color).save(folder / names[-1])
        if masks is not None:
            place = folder / masks.format(names[-1])
            place.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(mask).save(place)
    return names


def write_transforms_json(path: Path, names: list[str], poses: list[np.ndarray], **fields) -> Path:
    """A transforms.json; `fields` are the file's, of `frames` each frame's."""
    more = fields.pop("frames", [{}] * len(names))
    frames = [
        {"file_path": name, "transform_matrix": c2w.tolist()} | own
        for name, c2w, own in zip(names, poses, more, strict=True)
    ]
    path.write_text(json.dumps(fields | {"frames": frames}))
    return path


def write_colmap(folder: Path, names: list[str], poses: list[np.ndarray], one: Lens, binary: bool) -> None:
    """A COLMAP model: text written by hand, or binary made of it by pycolmap, in a process of its own."""
    folder.mkdir(parents=True)
    numbers = " ".join(map(repr, one.parameters))
    (folder / "cameras.txt").write_text(f"1 {one.model} {one.width} {one.height} {numbers}\n")
    lines = []
    for index, (name, c2w) in enumerate(zip(names, poses, strict=True)):
        w2c = np.linalg.inv(c2w @ np.diag([1.0, -1.0, -1.0, 1.0]))
        lines += [" ".join(map(repr, [index + 1, *_quaternion(w2c[:3, :3]), *w2c[:3, 3].tolist(), 1])) + f" {name}", ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    (folder / "points3D.txt").write_text("1 0.1 0.2 0.3 255 255 255 0.5 1 0\n")
    (folder / "images.txt").write_text("\n".join([lines[0], "10.0 10.0 1", *lines[2:]]) + "\n")
    if binary:
        code = f"import pycolmap; r = pycolmap.Reconstruction({str(folder)!r}); r.write_binary({str(folder)!r})"
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
        for text in folder.glob("*.txt"):
            text.unlink()


def _quaternion(rotation: np.ndarray) -> list[float]:
    """w, x, y, z of a rotation (3, 3): the eigenvector of Bar-Itzhack's matrix."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation.T
    matrix = np.array(
        [
            [xx - yy - zz, yx + xy, zx + xz, yz - zy],
            [yx + xy, yy - xx - zz, zy + yz, zx - xz],
            [zx + xz, zy + yz, zz - xx - yy, xy - yx],
            [yz - zy, zx - xz, xy - yx, xx + yy + zz],
        ]
    )
    x, y, z, w = np.linalg.eigh(matrix)[1][:, -1]
    return [float(w), float(x), float(y), float(z)]
