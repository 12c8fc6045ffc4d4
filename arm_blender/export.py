"""An asset on disk: GLB, the four texture maps, report.json. No bpy in this module."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import trimesh
from PIL import Image
from torch import Tensor

from .errors import OutputError
from .files import check_output, staging
from .graphics.color import bytes_from_unit, srgb_from_linear
from .graphics.meshes import vertex_normals
from .progress import Progress, silent
from .report import FILE_NAME, Report
from .structures import MaterialMaps, RelightableAsset, UvMesh
from .uv.maps import CONSTANT_SIDE, ONE_STEP, constant_value
from .views.image_io import write_png


@dataclass(frozen=True)
class GltfVertices:
    """A mesh as glTF wants it: one UV per vertex, Y up.

    Attributes:
        position: (P, 3) float32.
        normal: (P, 3) float32 unit, smooth: equal on both sides of a seam.
        uv: (P, 2) float32, v up.
        faces: (F, 3) int64.
    """

    position: np.ndarray
    normal: np.ndarray
    uv: np.ndarray
    faces: np.ndarray


def write_asset(
    asset: RelightableAsset,
    report: Report,
    directory: Path,
    progress: Progress = silent,
    further: Callable[[Path], None] | None = None,
) -> list[Path]:
    """Writes an asset as a whole: while anything is missing, `directory` has no report.json, or still the older asset.

    Args:
        asset: what to write.
        report: is written last.
        directory: is made where it is missing; files of the same names are replaced, others stay.
        progress: is told each file.
        further: writes more files into the folder that it is given, under names that are not taken: the .blend.
    Returns:
        The files, report.json last.
    Raises:
        OutputError: something cannot be written.
        Cancelled: by `progress`; nothing was changed.
    """
    check_output(directory)
    with staging(directory) as stage:
        with report.stage("files"):
            progress(0.0, "writing textures")
            _write_textures(asset.maps, stage / "textures")
            progress(0.5, f"writing {asset.name}.glb")
            write_glb(asset, stage / f"{asset.name}.glb")
        if further is not None:
            further(stage)
        progress(1.0, "writing report.json")
        report.write(stage / FILE_NAME)
        return _move_into(directory, stage)


def is_whole(directory: Path) -> bool:
    """Whether `directory` holds an asset that was written to its end."""
    return (directory / FILE_NAME).is_file()


def write_glb(asset: RelightableAsset, path: Path) -> None:
    """A binary glTF 2.0: metallic-roughness material, values where a map is constant; Y up, as the format demands."""
    vertices = gltf_vertices(asset.mesh)
    mesh = trimesh.Trimesh(
        vertices.position,
        vertices.faces,
        vertex_normals=vertices.normal,
        process=False,
        visual=trimesh.visual.TextureVisuals(uv=vertices.uv, material=_material(asset.name, asset.maps)),
    )
    scene = trimesh.Scene()
    scene.add_geometry(mesh, node_name=asset.name, geom_name=asset.name)
    path.write_bytes(scene.export(file_type="glb", include_normals=True))


def gltf_vertices(mesh: UvMesh) -> GltfVertices:
    """One vertex per pair of a welded vertex and a UV; the normals are those of the welded mesh."""
    corners = torch.stack([mesh.faces.reshape(-1), mesh.face_uvs.reshape(-1)], dim=1).cpu()
    pairs, inverse = torch.unique(corners, dim=0, return_inverse=True)
    vertices, faces = mesh.vertices.cpu(), mesh.faces.cpu()
    return GltfVertices(
        position=gltf_from_world(vertices[pairs[:, 0]]).numpy(),
        normal=gltf_from_world(vertex_normals(vertices, faces)[pairs[:, 0]]).numpy(),
        uv=mesh.uvs.cpu()[pairs[:, 1]].numpy(),
        faces=inverse.view(-1, 3).numpy(),
    )


def gltf_from_world(vectors: Tensor) -> Tensor:
    """(..., 3) vectors of our Z-up world in glTF's Y-up one; Blender's importer turns them back."""
    x, y, z = vectors.unbind(dim=-1)
    return torch.stack([x, z, -y], dim=-1)


def _material(name: str, maps: MaterialMaps) -> trimesh.visual.material.PBRMaterial:
    roughness, metallic = (constant_value(image, None, ONE_STEP) for image in (maps.roughness, maps.metallic))
    texture = None
    if roughness is None or metallic is None:
        size = max(maps.roughness.shape[-1], maps.metallic.shape[-1])
        # Red would be occlusion, if the material declared one: 1 is none.
        channels = torch.ones(1, size, size), _sized(maps.roughness, size), _sized(maps.metallic, size)
        texture = _picture(torch.cat(channels))
    return trimesh.visual.material.PBRMaterial(
        name=name,
        baseColorTexture=_picture(srgb_from_linear(maps.albedo)),
        baseColorFactor=[255, 255, 255, 255],
        metallicRoughnessTexture=texture,
        roughnessFactor=1.0 if texture is not None else roughness,
        metallicFactor=1.0 if texture is not None else metallic,
        # A mesh of the user's own may be open: its inside is then no hole.
        doubleSided=True,
    )


def _sized(image: Tensor, size: int) -> Tensor:
    """(1, size, size) on the CPU: a map as it is, or a constant one spread out."""
    if image.shape[-1] == size:
        return image.cpu()
    return torch.nn.functional.interpolate(image.cpu()[None], size=(size, size), mode="bilinear")[0]


def _picture(image: Tensor) -> Image.Image:
    """An 8-bit picture of (3, T, T) in [0, 1], as it is; row 0 on top."""
    return Image.fromarray(bytes_from_unit(image).permute(1, 2, 0).contiguous().cpu().numpy(), "RGB")


def _write_textures(maps: MaterialMaps, folder: Path) -> None:
    folder.mkdir()
    for name, image, srgb in (
        ("albedo", maps.albedo, True),
        ("roughness", maps.roughness, False),
        ("metallic", maps.metallic, False),
        ("baked", maps.baked, True),
    ):
        if all(constant_value(channel[None], None, ONE_STEP) is not None for channel in image):
            image = image[:, :CONSTANT_SIDE, :CONSTANT_SIDE]
        write_png(folder / f"{name}.png", image, srgb)


def _move_into(directory: Path, stage: Path) -> list[Path]:
    """Moves the files of `stage` to their places; the older report.json goes first and the new one comes last.

    Raises:
        OutputError: something else is where a file or a folder has to be; nothing was moved.
    """
    files = sorted(path.relative_to(stage) for path in stage.rglob("*") if path.is_file())
    files.sort(key=lambda path: path == Path(FILE_NAME))
    for target in (directory / path for path in files):
        if target.is_dir():
            raise OutputError(f"{target}: is a folder where a file has to be; move it away or change --output")
        if target.parent.exists() and not target.parent.is_dir():
            raise OutputError(f"{target.parent}: is a file where a folder has to be; move it away or change --output")
    (directory / FILE_NAME).unlink(missing_ok=True)
    for path in files:
        (directory / path).parent.mkdir(exist_ok=True)
        os.replace(stage / path, directory / path)
    return [directory / path for path in files]
