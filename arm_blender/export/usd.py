"""An asset as USD: text with the maps beside it, or a USDZ archive with the maps inside.

One mesh, one `UsdPreviewSurface` (https://openusd.org/release/spec_usdpreviewsurface.html). Z is up, as it is here.
"""

import re
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ..graphics.meshes import angle_weighted_normals
from ..structures import MaterialMaps, RelightableAsset, UvMesh
from .textures import FOLDER

ALIGNMENT = 64
"""Bytes: a file in a USDZ begins at a multiple of it, so that it can be read where it lies."""

_HEADER = """#usda 1.0
(
    defaultPrim = "{name}"
    metersPerUnit = 1
    upAxis = "Z"
)

def Xform "{name}" (
    kind = "component"
)
{{
"""

_MESH = """    def Mesh "{name}" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {{
        uniform bool doubleSided = 1
        uniform token subdivisionScheme = "none"
        float3[] extent = [{extent}]
        int[] faceVertexCounts = [{counts}]
        int[] faceVertexIndices = [{faces}]
        point3f[] points = [{points}]
        normal3f[] normals = [{normals}] (
            interpolation = "vertex"
        )
        texCoord2f[] primvars:st = [{uvs}] (
            interpolation = "faceVarying"
        )
        int[] primvars:st:indices = [{face_uvs}]
        rel material:binding = </{name}/material>
    }}
"""

_TEXTURE = """
        def Shader "{map}"
        {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @./{folder}/{map}.png@
            token inputs:sourceColorSpace = "{space}"
            float2 inputs:st.connect = </{name}/material/uv.outputs:result>
            token inputs:wrapS = "clamp"
            token inputs:wrapT = "clamp"{further}
            {kind} outputs:{channel}
        }}
"""

_DECODED = """
            float4 inputs:scale = (2, 2, 2, 1)
            float4 inputs:bias = (-1, -1, -1, 0)"""
"""A normal map's bytes are of [0, 1], its normals of [-1, 1]."""


def write_usd(asset: RelightableAsset, path: Path) -> None:
    """The asset as .usda; the textures are those of `FOLDER` beside it.

    Raises:
        OSError: it cannot be written.
    """
    path.write_text(usd_text(asset), encoding="utf-8")


def write_usdz(asset: RelightableAsset, path: Path) -> None:
    """One file that holds the .usda and its textures, which lie in `FOLDER` beside it already.

    Raises:
        OSError: it cannot be written.
    """
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        _store(archive, f"{_identifier(asset.name)}.usda", usd_text(asset).encode())
        for name in _textures(asset.maps):
            _store(archive, f"{FOLDER}/{name}.png", (path.parent / FOLDER / f"{name}.png").read_bytes())


def usd_text(asset: RelightableAsset) -> str:
    """The asset as the text of a USD layer."""
    name = _identifier(asset.name)
    return _HEADER.format(name=name) + _mesh(name, asset.mesh) + _material(name, asset.maps) + "}\n"


def _mesh(name: str, mesh: UvMesh) -> str:
    vertices, faces = mesh.vertices.cpu(), mesh.faces.cpu()
    bounds = np.stack([vertices.amin(dim=0).numpy(), vertices.amax(dim=0).numpy()])
    return _MESH.format(
        name=name,
        extent=_tuples(bounds),
        counts=", ".join(["3"] * len(faces)),
        faces=", ".join(map(str, faces.flatten().tolist())),
        points=_tuples(vertices.numpy()),
        normals=_tuples(angle_weighted_normals(vertices, faces).numpy()),
        uvs=_tuples(mesh.uvs.cpu().numpy()),
        face_uvs=", ".join(map(str, mesh.face_uvs.flatten().tolist())),
    )


def _material(name: str, maps: MaterialMaps) -> str:
    inputs, shaders = [f"color3f inputs:diffuseColor.connect = </{name}/material/albedo.outputs:rgb>"], []
    shaders.append(_texture(name, "albedo", "sRGB", "float3", "rgb"))
    for channel in ("roughness", "metallic"):
        value = getattr(maps, channel)
        if isinstance(value, float):
            inputs.append(f"float inputs:{channel} = {value:.6g}")
            continue
        inputs.append(f"float inputs:{channel}.connect = </{name}/material/{channel}.outputs:r>")
        shaders.append(_texture(name, channel, "raw", "float", "r"))
    if maps.normal is not None:
        inputs.append(f"normal3f inputs:normal.connect = </{name}/material/normal.outputs:rgb>")
        shaders.append(_texture(name, "normal", "raw", "float3", "rgb", _DECODED))
    surface = "\n            ".join(inputs)
    return f"""
    def Material "material"
    {{
        token outputs:surface.connect = </{name}/material/surface.outputs:surface>

        def Shader "surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            {surface}
            token outputs:surface
        }}

        def Shader "uv"
        {{
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }}
{"".join(shaders)}    }}
"""


def _texture(name: str, map_name: str, space: str, kind: str, channel: str, further: str = "") -> str:
    words = {"map": map_name, "folder": FOLDER, "space": space, "kind": kind, "channel": channel, "further": further}
    return _TEXTURE.format(name=name, **words)


def _textures(maps: MaterialMaps) -> list[str]:
    """The names of the textures that the material reads."""
    read = [name for name in ("roughness", "metallic") if not isinstance(getattr(maps, name), float)]
    return ["albedo", *read, *([] if maps.normal is None else ["normal"])]


def _tuples(rows: ArrayLike) -> str:
    """Rows of numbers as USD writes them; nine digits bring each float32 back as it was."""
    return ", ".join(f"({', '.join(f'{value:.9g}' for value in row)})" for row in np.asarray(rows).tolist())


def _identifier(name: str) -> str:
    """A name that USD takes for a part of a path."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return plain if re.match(r"[A-Za-z_]", plain) else f"_{plain}"


def _store(archive: zipfile.ZipFile, name: str, data: bytes) -> None:
    entry = zipfile.ZipInfo(name)
    assert archive.fp is not None  # None once it is closed.
    begins = archive.fp.tell() + 30 + len(name.encode())  # A local header of 30 bytes, the name, and what we add.
    gap = -begins % ALIGNMENT
    if 0 < gap < 4:
        gap += ALIGNMENT  # An extra field has a head of 4 bytes itself.
    if gap:
        entry.extra = b"\x86\x19" + (gap - 4).to_bytes(2, "little") + b"\0" * (gap - 4)
    archive.writestr(entry, data)
