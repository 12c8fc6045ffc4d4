"""Runs xatlas in a process of its own: it holds Python's lock for its whole run, and it cannot be interrupted.

Started by `unwrap.py` as a script, with the paths of the files to read and to write and the search path for modules.
Imports nothing of this package: the process starts in the time that numpy takes.
"""

import os
import sys


def main(source: str, target: str, search_path: str) -> None:
    """Read vertices, faces and options from `source` (npz), write the atlas to `target` (npz)."""
    sys.path[:0] = search_path.split(os.pathsep)
    import numpy as np
    import xatlas

    request = np.load(source)
    atlas = xatlas.Atlas()
    atlas.add_mesh(request["vertices"], request["faces"])
    chart_options, pack_options = xatlas.ChartOptions(), xatlas.PackOptions()
    chart_options.max_iterations = 1
    chart_options.fix_winding = True
    chart_options.max_cost = float(request["max_cost"])
    chart_options.max_chart_area = float(request["max_chart_area"])
    pack_options.resolution = int(request["texture_size"])
    pack_options.padding = int(request["padding"])
    pack_options.bruteForce = False
    pack_options.bilinear = False  # The padding is there for that.
    pack_options.rotate_charts = False  # Its quarter turns are reflections; turning to the axes is not.
    atlas.generate(chart_options, pack_options)

    original, face_uvs, uvs = atlas.get_mesh(0)
    if atlas.atlas_count != 1 or face_uvs.shape != request["faces"].shape:
        raise RuntimeError(f"{atlas.atlas_count} atlases, {len(face_uvs)} of {len(request['faces'])} faces")
    np.savez(
        target,
        original=original,
        face_uvs=face_uvs,
        uvs=uvs,
        size=[atlas.width, atlas.height],
        charts=atlas.chart_count,
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
