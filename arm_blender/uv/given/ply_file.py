"""A PLY with faces of any number of corners; trimesh reads those of one number only."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from .polygons import triangulated

_KINDS = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
"""NumPy's types by PLY's."""

_UVS = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
"""How programs call a vertex's UV."""

_CORNERS, _CORNER_UVS = ("vertex_indices", "vertex_index"), "texcoord"

_LONGEST_HEADER = 1000
"""Lines."""


@dataclass
class _Element:
    """Things of one kind.

    Attributes:
        properties: by name the type, and of a list also that of its length, which comes first.
    """

    name: str
    count: int
    properties: dict[str, tuple[str, ...]] = field(default_factory=dict)


def arrays_of_ply(path: Path) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any] | None]:
    """(N, 3) vertices, (F, 3) triangles, and (F, 3, 2) UVs of their corners where the file has any.

    Raises:
        ValueError, KeyError, IndexError, TypeError, OverflowError: damaged, or longer by its header than it is.
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        order, elements = _header(file)
        data = file.read()
    rows = _text_rows(data, elements) if order is None else _binary_rows(data, elements, order)
    found = dict(zip((element.name for element in elements), rows, strict=True))
    points = {name: np.asarray(values, np.float64) for name, values in found["vertex"].items()}
    vertices = np.stack([points["x"], points["y"], points["z"]], axis=1)
    faces = found.get("face", {})
    lists: Any = next((faces[name] for name in _CORNERS if name in faces), [])
    polygons: list[list[int]] = [[int(corner) for corner in polygon] for polygon in lists]
    if polygons and not 0 <= min(map(min, filter(None, polygons))) <= max(map(max, filter(None, polygons))) < len(
        vertices
    ):
        raise ValueError(f"a face names a vertex that is not among the {len(vertices)}")
    owners, corners = triangulated(vertices, polygons)
    starts = np.concatenate([[0], np.cumsum([len(polygon) for polygon in polygons])])
    places = starts[owners][:, None] + corners
    flat = np.array([corner for polygon in polygons for corner in polygon], np.int64)
    triangles = flat[places] if len(places) else np.zeros((0, 3), np.int64)
    named = next((pair for pair in _UVS if points.keys() >= {*pair}), None)
    if named is not None:
        return vertices, triangles, np.stack([points[name] for name in named], axis=1)[triangles]
    wedges = faces.get(_CORNER_UVS)
    if wedges is None or any(len(one) != 2 * len(polygon) for one, polygon in zip(wedges, polygons, strict=True)):
        return vertices, triangles, None
    return vertices, triangles, np.array([x for one in wedges for x in one], np.float64).reshape(-1, 2)[places]


def _header(file: BinaryIO) -> tuple[str | None, list[_Element]]:
    """The order of bytes, None for text, and the elements."""
    if file.readline(10).strip() != b"ply":
        raise ValueError("it is no PLY")
    order: str | None = None
    elements: list[_Element] = []
    for _ in range(_LONGEST_HEADER):
        words = file.readline(1000).decode("ascii", "replace").split()
        if words[:1] == ["end_header"]:
            return order, elements
        if words[:1] == ["format"]:
            order = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}[words[1]]
        elif words[:1] == ["element"]:
            elements.append(_Element(words[1], int(words[2])))
            if elements[-1].count < 0:
                raise ValueError(f"it has {words[2]} of {words[1][:40]}")
        elif words[:1] == ["property"]:
            kinds = words[2:4] if words[1] == "list" else words[1:2]
            elements[-1].properties[words[-1]] = tuple(_KINDS[kind] for kind in kinds)
    raise ValueError("its header has no end")


def _text_rows(data: bytes, elements: list[_Element]) -> Iterator[dict[str, Any]]:
    """Of each element its columns."""
    words, place = data.split(), 0
    for element in elements:
        if element.count * len(element.properties) > len(words) - place:
            raise ValueError(f"it ends before its {element.count} of {element.name[:40]}")
        columns: dict[str, list[Any]] = {name: [] for name in element.properties}
        for _ in range(element.count):
            for name, kinds in element.properties.items():
                if len(kinds) == 1:
                    columns[name].append(float(words[place]))
                    place += 1
                else:
                    size = int(words[place])
                    if not 0 <= size < len(words) - place:
                        raise ValueError(f"a list claims {size} values, more than the file holds")
                    columns[name].append([float(word) for word in words[place + 1 : place + 1 + size]])
                    place += 1 + size
        yield columns


def _binary_rows(data: bytes, elements: list[_Element], order: str) -> Iterator[dict[str, Any]]:
    """Of each element its columns."""
    place = 0
    for element in elements:
        if all(len(kinds) == 1 for kinds in element.properties.values()):
            kind = np.dtype([(name, order + kinds[0]) for name, kinds in element.properties.items()])
            if element.count * kind.itemsize > len(data) - place:
                raise ValueError(f"it ends before its {element.count} of {element.name[:40]}")
            table = np.frombuffer(data, kind, element.count, place)
            place += element.count * kind.itemsize
            yield {name: table[name] for name in element.properties}
            continue
        columns: dict[str, list[Any]] = {name: [] for name in element.properties}
        for _ in range(element.count):
            for name, kinds in element.properties.items():
                first = np.dtype(order + kinds[0])
                value = np.frombuffer(data, first, 1, place)[0]
                place += first.itemsize
                if len(kinds) == 2:
                    values = np.frombuffer(data, np.dtype(order + kinds[1]), int(value), place)
                    place += values.nbytes
                    columns[name].append(values.tolist())
                else:
                    columns[name].append(value)
        yield columns
