"""Packs charts with xatlas in a process of its own: it holds Python's lock while it runs, and cannot be interrupted.

Started by `unwrap.py` as a script, with the paths of the files to read and to write and the search path for modules.
Imports nothing of this package: the process starts in the time that numpy takes.
"""

import os
import sys

FILL = 0.55
"""Share of the atlas that charts usually cover: the first guess at their scale."""

TRIALS = 3
"""Of a scale; each takes a tenth of a second."""


def main(source: str, target: str, search_path: str) -> None:
    """Read charts and options from `source` (npz), write the atlas to `target` (npz)."""
    sys.path[:0] = search_path.split(os.pathsep)
    import numpy as np
    import xatlas

    request = np.load(source)
    places, faces, size = request["places"], request["faces"], int(request["texture_size"])
    options = xatlas.PackOptions()
    options.texels_per_unit = 1.0
    options.padding = int(request["padding"])
    options.bruteForce = False
    options.bilinear = False  # The padding is there for that.
    options.rotate_charts = False  # Its quarter turns are reflections; turning to the axes is not.
    scale = size * (FILL / max(float(request["area"]), 1e-12)) ** 0.5
    best = None
    for _ in range(TRIALS):
        atlas = xatlas.Atlas()
        atlas.add_uv_mesh((places * scale).astype(np.float32), faces)
        atlas.generate(xatlas.ChartOptions(), options)
        original, face_uvs, uvs = atlas.get_mesh(0)
        longest = max(atlas.width, atlas.height)
        if atlas.atlas_count != 1 or not np.array_equal(original[face_uvs], faces):
            raise RuntimeError(f"{atlas.atlas_count} atlases, {len(face_uvs)} of {len(faces)} faces, or others")
        # uvs are shares of a width and of a height that differ.
        packed = np.zeros_like(places)
        packed[original] = uvs * [atlas.width, atlas.height] / max(longest, size)
        if best is None or longest <= size:
            best = packed
        if 0.96 * size <= longest <= size:
            break
        scale *= 0.985 * size / longest
    np.savez(target, uvs=best)


if __name__ == "__main__":
    main(*sys.argv[1:])
