"""An OBJ whose polygons are triangles: trimesh would fan them, which is wrong where one is concave."""

from itertools import accumulate
from pathlib import Path

import numpy as np

from .polygons import triangulated


def triangles_of_obj(path: Path) -> bytes:
    """The text of an OBJ in which every face is a triangle, with numbers counted from its beginning.

    Raises:
        ValueError, IndexError: a line is no vertex or no face, or a face names what is not there.
        OSError: it cannot be read.
    """
    text = path.read_text(encoding="utf-8", errors="replace").replace("\\\n", " ")
    lines = [line.split("#", 1)[0].strip() for line in text.splitlines()]
    words = [line.split(None, 1)[0] if line else "" for line in lines]
    if "p" in words or "l" in words:
        lines = [line if word not in ("p", "l") else "" for line, word in zip(lines, words, strict=True)]
    places = [index for index, word in enumerate(words) if word == "f"]
    # Of each line how many vertices, UVs and normals stand above: what negative numbers count back from.
    above = [list(accumulate(word == kind for word in words)) for kind in ("v", "vt", "vn")]
    faces = [
        [_absolute(corner, [int(count[place]) for count in above]) for corner in lines[place].split()[1:]]
        for place in places
    ]
    vertices = np.array([line.split()[1:4] for line, word in zip(lines, words, strict=True) if word == "v"], np.float64)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise ValueError("its vertices have not three numbers each")
    owners, triangles = triangulated(vertices, [[int(corner.split("/")[0]) - 1 for corner in face] for face in faces])
    made: dict[int, list[str]] = {place: [] for place in places}
    for owner, corners in zip(owners.tolist(), triangles.tolist(), strict=True):
        made[places[owner]].append("f " + " ".join(faces[owner][corner] for corner in corners))
    for place, three in made.items():
        lines[place] = "\n".join(three)
    return "\n".join(lines).encode()


def _absolute(corner: str, above: list[int]) -> str:
    """A corner as v, v/vt, v//vn or v/vt/vn, its numbers counted from the file's beginning.

    Raises:
        ValueError: it is none, or names what is not there.
    """
    numbers = corner.split("/")
    if len(numbers) > 3:
        raise ValueError(f"{corner[:40]} is no corner of a face")
    found: list[str] = []
    for text, count in zip(numbers, above, strict=False):
        number = int(text) if text or not found else 0
        number += count + 1 if number < 0 else 0
        if text and number < 1:
            raise ValueError(f"a face names number {text[:20]}, of {count}")
        found.append(str(number) if text else "")
    if not 1 <= int(found[0]):
        raise ValueError(f"{corner[:40]} is no corner of a face")
    return "/".join(found).rstrip("/")
