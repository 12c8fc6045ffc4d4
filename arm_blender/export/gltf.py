"""An asset as a binary glTF 2.0, its maps inside."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from ..graphics.color import bytes_from_unit, srgb_from_linear
from ..graphics.meshes import angle_weighted_normals
from ..structures import MaterialMaps, RelightableAsset, UvMesh
from ..uv.normal_map import unit_from_normals


@dataclass(frozen=True)
class GltfVertices:
    """A mesh as glTF wants it: one UV per vertex, Y up.

    Attributes:
        position: (P, 3) float32.
        normal: (P, 3) float32 unit, smooth: equal on both sides of a seam.
        uv: (P, 2) float32, v up.
        faces: (F, 3) int64.
    """

    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    uv: NDArray[np.float32]
    faces: NDArray[np.int64]


def write_glb(asset: RelightableAsset, path: Path) -> None:
    """A binary glTF 2.0: metallic-roughness material, values where a map is one; Y up, as the format demands."""
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
        normal=gltf_from_world(angle_weighted_normals(vertices, faces)[pairs[:, 0]]).numpy(),
        uv=mesh.uvs.cpu()[pairs[:, 1]].numpy(),
        faces=inverse.view(-1, 3).numpy(),
    )


def gltf_from_world(vectors: Tensor) -> Tensor:
    """(..., 3) vectors of our Z-up world in glTF's Y-up one; Blender's importer turns them back."""
    x, y, z = vectors.unbind(dim=-1)
    return torch.stack([x, z, -y], dim=-1)


def _material(name: str, maps: MaterialMaps) -> trimesh.visual.material.PBRMaterial:
    texture = None
    sizes = [image.shape[-1] for image in (maps.roughness, maps.metallic) if isinstance(image, Tensor)]
    if sizes:
        roughness, metallic = (_sized(maps.image(name, max(sizes)), max(sizes)) for name in ("roughness", "metallic"))
        # Red would be occlusion, if the material declared one: 1 is none.
        texture = _picture(torch.cat([torch.ones_like(roughness), roughness, metallic]))
    return trimesh.visual.material.PBRMaterial(
        name=name,
        baseColorTexture=_picture(srgb_from_linear(maps.albedo)),
        baseColorFactor=[255, 255, 255, 255],
        metallicRoughnessTexture=texture,
        roughnessFactor=1.0 if texture is not None else maps.roughness,
        metallicFactor=1.0 if texture is not None else maps.metallic,
        normalTexture=None if maps.normal is None else _picture(unit_from_normals(maps.normal)),
        # A mesh of the user's own may be open: its inside is then no hole.
        doubleSided=True,
    )


def _sized(image: Tensor, size: int) -> Tensor:
    """(1, size, size) on the CPU: a map as it is, or a smaller one enlarged."""
    if image.shape[-1] == size:
        return image.cpu()
    return torch.nn.functional.interpolate(image.cpu()[None], size=(size, size), mode="bilinear")[0]


def _picture(image: Tensor) -> Image.Image:
    """An 8-bit picture of (3, T, T) in [0, 1], as it is; row 0 on top."""
    return Image.fromarray(bytes_from_unit(image).permute(1, 2, 0).contiguous().cpu().numpy(), "RGB")
