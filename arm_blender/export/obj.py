"""An asset as a Wavefront OBJ with its MTL; the maps lie beside them.

Roughness and metallic stand in the keys of the PBR extension (`Pr`, `Pm`, `map_Pr`, `map_Pm`), a normal map in its
`norm`, and in `map_Bump`, where Blender writes it and looks for it. The format knows no colour spaces: Blender takes
all maps for sRGB; set those of roughness and metallic to Non-Color by hand. Y is up, as Blender writes and reads it.
"""

from pathlib import Path

import numpy as np

from ..graphics.meshes import angle_weighted_normals
from ..structures import MaterialMaps, RelightableAsset
from .gltf import gltf_from_world
from .textures import FOLDER

MATERIAL = "arm"
"""A name without spaces: readers cut it there."""


def write_obj(asset: RelightableAsset, path: Path) -> None:
    """`path` and, beside it, the .mtl of the same name; the mesh stays welded, its UVs are of corners.

    Raises:
        OSError: it cannot be written.
    """
    mesh = asset.mesh
    vertices, faces = mesh.vertices.cpu(), mesh.faces.cpu()
    normals = angle_weighted_normals(vertices, faces)
    with path.open("w", encoding="utf-8") as file:
        file.write(f"# {asset.name}: Y is up\nmtllib {path.stem}.mtl\no {asset.name}\n")
        # Nine digits bring each float32 back as it was.
        np.savetxt(file, gltf_from_world(vertices).numpy(), "v %.9g %.9g %.9g")
        np.savetxt(file, mesh.uvs.cpu().numpy(), "vt %.9g %.9g")
        np.savetxt(file, gltf_from_world(normals).numpy(), "vn %.6g %.6g %.6g")
        file.write(f"usemtl {MATERIAL}\ns 1\n")
        corner, uv = faces.numpy() + 1, mesh.face_uvs.cpu().numpy() + 1
        columns = np.stack([corner, uv, corner], axis=2).reshape(-1, 9)
        np.savetxt(file, columns, "f %d/%d/%d %d/%d/%d %d/%d/%d")
    path.with_suffix(".mtl").write_text(_material(asset.maps), encoding="utf-8")


def _material(maps: MaterialMaps) -> str:
    lines = [f"newmtl {MATERIAL}", "Kd 1 1 1", f"map_Kd {FOLDER}/albedo.png"]
    for key, name in (("Pr", "roughness"), ("Pm", "metallic")):
        value = getattr(maps, name)
        lines.append(f"{key} {value:.6g}" if isinstance(value, float) else f"map_{key} {FOLDER}/{name}.png")
    if maps.normal is not None:
        lines += [f"norm {FOLDER}/normal.png", f"map_Bump -bm 1 {FOLDER}/normal.png"]
    return "\n".join([*lines, ""])
