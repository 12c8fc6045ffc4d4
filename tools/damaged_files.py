"""The formats that are read, each with small good files, and with what reads them."""

import dataclasses
import io
import json
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import torch
import trimesh
from PIL import Image

from arm_blender.commands import batch
from arm_blender.models.small.cutout import CutoutConfig
from arm_blender.structures import UvMesh
from arm_blender.uv.decimate import clean, decimate
from arm_blender.uv.mesh_file import read_mesh
from arm_blender.uv.unwrap import UnwrapConfig, unwrap
from arm_blender.views.image_io import read_image
from arm_blender.views.transforms_json import read_frames
from arm_blender.weight_files import checkpoints
from arm_blender.weight_files.imported import read_tensors

SIDE = 24
"""Pixels of the pictures."""


@dataclass(frozen=True)
class FileFormat:
    """What is read in one way.

    Attributes:
        make: good files, in a folder where they may need others.
        read: one content, in that folder.
    """

    make: Callable[[Path], list[bytes]]
    read: Callable[[bytes, Path], object]


def pixels(channels: int = 4) -> np.ndarray:
    """(SIDE, SIDE, channels) uint8: noise inside of a square."""
    image = np.random.default_rng(0).integers(0, 256, (SIDE, SIDE, channels), dtype=np.uint8)
    if channels == 4:
        image[..., 3] = 0
        image[4:20, 4:20, 3] = 255
    return image


def by_pillow(kind: str, channels: int, **options: object) -> bytes:
    exif = Image.Exif()
    exif[0x112] = 6
    file = io.BytesIO()
    Image.fromarray(pixels(channels)).save(file, kind, exif=exif.tobytes(), **options)
    return file.getvalue()


def by_oiio(folder: Path, suffix: str, kind: str, **fields: int) -> bytes:
    spec = oiio.ImageSpec(SIDE, SIDE, 4, kind)
    for name, value in fields.items():
        setattr(spec, name, value)
    place = folder / f"good{suffix}"
    output = oiio.ImageOutput.create(str(place))
    image = pixels() if kind == "uint8" else (pixels() / 255.0).astype(np.float32)
    if not (output.open(str(place), spec) and output.write_image(image) and output.close()):
        raise RuntimeError(f"{suffix}: {output.geterror()}")
    return place.read_bytes()


def read_picture(suffix: str, content: bytes, folder: Path) -> object:
    (folder / f"case{suffix}").write_bytes(content)
    return read_image(folder / f"case{suffix}")


def picture(suffix: str, make: Callable[[Path], list[bytes]]) -> FileFormat:
    return FileFormat(make, partial(read_picture, suffix))


def tiffs(folder: Path) -> list[bytes]:
    return [by_oiio(folder, ".tif", "uint8"), by_oiio(folder, ".tif", "float", tile_width=16, tile_height=16)]


def solid() -> trimesh.Trimesh:
    """A ball with UVs."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.visual = trimesh.visual.TextureVisuals(uv=0.5 + 0.45 * ball.vertices[:, :2])
    return ball


def objs(folder: Path) -> list[bytes]:
    lines = ["v 0 0 0", "v 2 0 0", "v 2 2 0", "v 1 1 0.5", "v 0 2 0", "vt 0 0", "vt 1 0", "vt 1 1", "vn 0 0 1"]
    faces = ["f 1/1/1 2/2/1 3/3/1 4/1/1 5/2/1", "f -1 -2 -3", "usemtl x", "f 1//1 2//1 3//1 4//1"]
    return [solid().export(file_type="obj").encode(), "\n".join([*lines, *faces]).encode()]


def plys(folder: Path) -> list[bytes]:
    head = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    text = head + "0 0 0\n2 0 0\n2 2 0\n1 1 0\n0 2 0\n5 0 1 2 3 4\n4 0 1 2 3\n"
    return [solid().export(file_type="ply"), solid().export(file_type="ply", encoding="ascii"), text.encode()]


def read_as_mesh(suffix: str, content: bytes, folder: Path) -> object:
    """Through all that a given mesh goes through before it is coloured."""
    (folder / f"case{suffix}").write_bytes(content)
    mesh = read_mesh(folder / f"case{suffix}")
    if isinstance(mesh, UvMesh):
        return mesh
    return unwrap(decimate(clean(mesh), 200), UnwrapConfig(64, time_limit=0.0))


def mesh(suffix: str, make: Callable[[Path], list[bytes]]) -> FileFormat:
    return FileFormat(make, partial(read_as_mesh, suffix))


def transforms(folder: Path) -> list[bytes]:
    for index in range(3):
        Image.fromarray(pixels()).save(folder / f"{index}.png")
    pose = [[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
    frames = [{"file_path": f"{index}.png", "transform_matrix": pose, "weight": 0.5} for index in range(3)]
    lens = {"fl_x": 30, "fl_y": 30, "cx": 12, "cy": 12, "w": SIDE, "h": SIDE, "k1": 0.1, "camera_model": "OPENCV"}
    found = [{"camera_angle_x": 0.6, "frames": frames}, lens | {"frames": frames, "ground": -1.0}]
    return [json.dumps(one).encode() for one in found]


def read_transforms_json(content: bytes, folder: Path) -> object:
    (folder / "transforms.json").write_bytes(content)
    frames, _ = read_frames(folder / "transforms.json")
    return [(frame.camera(SIDE, SIDE), frame.known(SIDE, SIDE), frame.ground, frame.is_bent) for frame in frames]


def weights(folder: Path) -> list[bytes]:
    state = {"a": torch.arange(6.0).view(2, 3), "b": torch.ones(3, dtype=torch.int64)}
    checkpoints.save(folder / "good.safetensors", state, CutoutConfig(), "cutout")
    return [(folder / "good.safetensors").read_bytes()]


def foreign_weights(folder: Path) -> list[bytes]:
    header = json.dumps({"a": {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]}}).encode()
    torch.save({"state_dict": {"a": torch.ones(2)}}, folder / "good.ckpt")
    return [struct.pack("<Q", len(header)) + header + bytes(8), (folder / "good.ckpt").read_bytes()]


def read_weights(content: bytes, folder: Path) -> object:
    (folder / "case.safetensors").write_bytes(content)
    return checkpoints.load(folder / "case.safetensors", CutoutConfig)


def read_foreign_weights(content: bytes, folder: Path) -> object:
    (folder / "case.ckpt").write_bytes(content)
    return read_tensors(folder / "case.ckpt")


def lists(folder: Path) -> list[bytes]:
    (folder / "cup.png").touch()
    rows = [{"views": "cup.png", "name": "cup", "seed": 3, "fovy": 30.0}, "cup.png"]
    return [json.dumps(rows).encode()]


def read_list(suffix: str, content: bytes, folder: Path) -> object:
    (folder / f"list{suffix}").write_bytes(content)
    items = batch.read_items(folder / f"list{suffix}", folder / "out")
    for item in items:
        batch.clear_unfinished(folder / "out" / item.name)
    return [dataclasses.asdict(item) for item in items]


FORMATS = {
    "PNG": picture(".png", lambda folder: [by_pillow("PNG", 4), by_pillow("PNG", 3)]),
    "JPEG": picture(".jpg", lambda folder: [by_pillow("JPEG", 3)]),
    "WebP": picture(".webp", lambda folder: [by_pillow("WEBP", 4), by_pillow("WEBP", 4, lossless=True)]),
    "TIFF": picture(".tif", tiffs),
    "EXR": picture(".exr", lambda folder: [by_oiio(folder, ".exr", "half"), by_oiio(folder, ".exr", "float")]),
    "HDR": picture(".hdr", lambda folder: [radiance(folder)]),
    "GLB": mesh(".glb", lambda folder: [solid().export(file_type="glb")]),
    "OBJ": mesh(".obj", objs),
    "PLY": mesh(".ply", plys),
    "STL": mesh(
        ".stl", lambda folder: [solid().export(file_type="stl"), solid().export(file_type="stl_ascii").encode()]
    ),
    "transforms.json": FileFormat(transforms, read_transforms_json),
    "safetensors": FileFormat(weights, read_weights),
    "weights of others": FileFormat(foreign_weights, read_foreign_weights),
    "list.json": FileFormat(lists, partial(read_list, ".json")),
    "list.csv": FileFormat(
        lambda folder: [b"views,name,seed,fovy\ncup.png,cup,3,30\ncup.png,,,\n"], partial(read_list, ".csv")
    ),
}
"""By their names, in the order of the table."""


def radiance(folder: Path) -> bytes:
    spec = oiio.ImageSpec(SIDE, SIDE, 3, "float")
    output = oiio.ImageOutput.create(str(folder / "good.hdr"))
    output.open(str(folder / "good.hdr"), spec)
    output.write_image((pixels(3) / 255.0).astype(np.float32))
    output.close()
    return (folder / "good.hdr").read_bytes()
