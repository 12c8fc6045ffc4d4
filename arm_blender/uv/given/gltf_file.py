"""A glTF's shapes and UVs as trimesh may read them, held against what the file holds before memory is taken.

trimesh takes memory as a file claims it, follows nodes without end, reads UVs only beside a material and integers as
they are stored, and opens pictures that nobody asked for.
"""

import base64
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

MOST_TRIANGLES = 10_000_000
"""Of all meshes, each as often as it is placed."""

_KINDS = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
"""NumPy's types by glTF's numbers of components."""

_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}

_DRACO, _MESHOPT = "KHR_draco_mesh_compression", "EXT_meshopt_compression"
_UNREAD = {
    _DRACO: "it is compressed with Draco; export it without compression",
    _MESHOPT: "it is compressed with meshopt; export it without compression",
    "EXT_mesh_gpu_instancing": "it places instances by an extension; make them real, and export it again",
}
"""Extensions that leave nothing to read where they are used, and what to do."""

_PLACED = ("children", "matrix", "mesh", "rotation", "scale", "translation")
"""Fields of a node that say where things are."""

_POINTS_AND_LINES = range(4)
"""Modes of primitives without faces."""


def shapes_of(path: Path) -> bytes:
    """A GLB of the nodes, the meshes and their UVs in a .glb or .gltf, and of one empty material.

    Raises:
        ValueError: the file contradicts itself, claims more than it holds, or is compressed; the message has no name.
        KeyError, TypeError, IndexError, AttributeError, RecursionError, struct.error: it is no glTF.
        OSError: it, or a file that it names, cannot be read.
    """
    gltf, buffers = _opened(path)
    for name in {*gltf.get("extensionsUsed", ()), *gltf.get("extensionsRequired", ())} & _UNREAD.keys():
        raise ValueError(_UNREAD[name])
    meshes = _Meshes(gltf, buffers)
    clean = [{"primitives": found} for mesh in gltf["meshes"] if (found := meshes.primitives(mesh))]
    there = [bool(meshes.triangles[index]) for index in range(len(gltf["meshes"]))]
    number = np.cumsum(there) - 1
    nodes = [{key: node[key] for key in _PLACED if key in node} for node in gltf["nodes"]]
    roots = gltf["scenes"][gltf.get("scene", 0)]["nodes"]
    _check_nodes(nodes, roots, meshes.triangles)
    for node in nodes:
        if "mesh" in node and there[node["mesh"]]:
            node["mesh"] = int(number[node["mesh"]])
        else:
            node.pop("mesh", None)
    blob = b"".join(meshes.parts)
    made = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": roots}], "nodes": nodes, "meshes": clean}
    made |= {"accessors": meshes.accessors, "bufferViews": meshes.views, "materials": [{}]}
    return _glb(made | {"buffers": [{"byteLength": len(blob)}]}, blob)


class _Meshes:
    """The primitives of a file's meshes, as arrays of their own.

    Attributes:
        triangles: of each mesh that was asked for.
        accessors: of the new file; so are `views` and `parts`, the bytes of each.
    """

    def __init__(self, gltf: dict[str, Any], buffers: list[bytes]) -> None:
        self.gltf, self.buffers = gltf, buffers
        self.triangles: list[int] = []
        self.accessors: list[dict[str, Any]] = []
        self.views: list[dict[str, Any]] = []
        self.parts: list[bytes] = []

    def primitives(self, mesh: dict[str, Any]) -> list[dict[str, Any]]:
        """Those of a mesh that have faces."""
        made, triangles = [], 0
        for primitive in mesh["primitives"]:
            mode = primitive.get("mode", 4)
            if mode in _POINTS_AND_LINES:
                continue
            if mode == 6:
                raise ValueError("it has fans of triangles; export it as triangles")
            one, faces = self._primitive(primitive, mode)
            triangles += faces
            made += [one] if faces else []
        self.triangles.append(triangles)
        return made

    def _primitive(self, primitive: dict[str, Any], mode: int) -> tuple[dict[str, Any], int]:
        attributes = primitive["attributes"]
        if primitive.get("extensions", {}).keys() & _UNREAD.keys():
            raise ValueError(_UNREAD[_DRACO])
        positions = self._read(attributes["POSITION"], "VEC3").astype(np.float32)
        entries = {"POSITION": self._add(positions, "VEC3")}
        if "TEXCOORD_0" in attributes:
            uvs = self._read(attributes["TEXCOORD_0"], "VEC2").astype(np.float32)
            if len(uvs) != len(positions):
                raise ValueError(f"{len(positions)} positions have {len(uvs)} UVs")
            entries["TEXCOORD_0"] = self._add(uvs, "VEC2")
        made = {"attributes": entries, "material": 0, "mode": mode}
        corners = len(positions)
        if "indices" in primitive:
            indices = self._read(primitive["indices"], "SCALAR")
            if len(indices) and not 0 <= int(indices.min()) <= int(indices.max()) < corners:
                raise ValueError(f"a face has vertex {int(indices.max())} of {corners}")
            made["indices"], corners = self._add(indices.astype(np.uint32), "SCALAR"), len(indices)
        return made, corners // 3 if mode == 4 else max(0, corners - 2)

    def _read(self, index: int, kind: str) -> NDArray[Any]:
        """(N,) or (N, 2) or (N, 3) of an accessor, integers that stand for shares as those."""
        accessor = self.gltf["accessors"][_natural(index)]
        if accessor["type"] != kind:
            raise ValueError(f"accessor {index} is {str(accessor['type'])[:20]}, not {kind}")
        if "sparse" in accessor or "bufferView" not in accessor:
            raise ValueError(f"accessor {index} has no plain data; export it again without compression")
        dtype, width = np.dtype(_KINDS[accessor["componentType"]]), _WIDTHS[kind]
        view = self.gltf["bufferViews"][_natural(accessor["bufferView"])]
        buffer = self.buffers[_natural(view["buffer"])]
        count, item = _natural(accessor["count"]), dtype.itemsize * width
        stride = _natural(view.get("byteStride", item))
        start = _natural(view.get("byteOffset", 0)) + _natural(accessor.get("byteOffset", 0))
        if stride < item or start + max(0, count - 1) * stride + item * (count > 0) > len(buffer):
            raise ValueError(f"accessor {index} claims {count} values, more than the file holds")
        rows: NDArray[Any] = np.ndarray((count, width), dtype, buffer, start, (stride, dtype.itemsize))
        values = rows[:, 0] if kind == "SCALAR" else rows
        if accessor.get("normalized") and dtype.kind in "iu":
            highest = 2 ** (8 * dtype.itemsize - (dtype.kind == "i")) - 1
            return np.maximum(values / np.float32(highest), -1.0)
        return values

    def _add(self, values: NDArray[Any], kind: str) -> int:
        """The number of a new accessor."""
        data = np.ascontiguousarray(values).tobytes()
        number = 5126 if values.dtype == np.float32 else 5125
        self.views.append({"buffer": 0, "byteOffset": sum(map(len, self.parts)), "byteLength": len(data)})
        self.accessors.append(
            {"bufferView": len(self.views) - 1, "componentType": number, "count": len(values), "type": kind}
        )
        self.parts.append(data)
        if sum(map(len, self.parts)) > 8 * sum(map(len, self.buffers)) + 2**20:
            raise ValueError("its meshes claim many times what the file holds")
        return len(self.accessors) - 1


def _check_nodes(nodes: list[dict[str, Any]], roots: list[int], triangles: list[int]) -> None:
    """Raises `ValueError` where a node is below itself, or meshes are placed too often."""
    total, placed = 0, 0
    ways: list[tuple[int, tuple[int, ...]]] = [(_natural(root), ()) for root in roots]
    while ways:
        index, above = ways.pop()
        if index in above:
            raise ValueError(f"node {index} is below itself")
        node, placed = nodes[index], placed + 1
        total += triangles[_natural(node["mesh"])] if "mesh" in node else 0
        if total > MOST_TRIANGLES or placed > 10 * len(nodes) + 1000:
            raise ValueError(
                f"it has more than {MOST_TRIANGLES:,} triangles, or places nodes over and over; simplify it"
            )
        ways += [(_natural(child), (*above, index)) for child in node.get("children", ())]


def _natural(value: Any) -> int:
    """`value` where it is an integer of 0 or more; a negative one would count from the end."""
    if not isinstance(value, int) or value < 0:
        raise ValueError(f"{str(value)[:40]} stands where a number has to be")
    return value


def _opened(path: Path) -> tuple[dict[str, Any], list[bytes]]:
    """The JSON of a file, and its buffers, each as long as it says."""
    data, binary = path.read_bytes(), b""
    if data[:4] == b"glTF":
        length = struct.unpack_from("<I", data, 12)[0]
        text, rest = data[20 : 20 + length], data[20 + length :]
        if len(rest) >= 8:
            binary = rest[8 : 8 + struct.unpack_from("<I", rest)[0]]
    else:
        text = data
    gltf = json.loads(text)
    buffers = []
    for index, buffer in enumerate(gltf.get("buffers", ())):
        content = _buffer(path, buffer["uri"]) if "uri" in buffer else binary if index == 0 else b""
        if len(content) < _natural(buffer["byteLength"]):
            raise ValueError(f"buffer {index} claims {buffer['byteLength']} bytes of {len(content)}")
        buffers.append(content)
    return gltf, buffers


def _buffer(path: Path, uri: str) -> bytes:
    """What lies in the file's own text, or in a file inside of its folder."""
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2])
    place = path.parent / unquote(uri)
    if not place.resolve().is_relative_to(path.parent.resolve()):
        raise ValueError(f"buffer {uri[:80]} lies outside of the folder")
    return place.read_bytes()


def _glb(gltf: dict[str, Any], blob: bytes) -> bytes:
    text = json.dumps(gltf).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
