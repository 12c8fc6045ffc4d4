"""Packs charts with xatlas in a process of its own: it holds Python's lock while it runs, and cannot be interrupted.

Started by `unwrap.py` as a script, with the paths of the files to read and to write and the search path for modules.
Imports nothing of this package: the process starts in the time that numpy takes.

A few large charts pack well or badly by luck, so several arrangements are tried, at a lower resolution than the
atlas': that takes a tenth of the time, and its texels are gaps enough.
"""

from __future__ import annotations

import math
import os
import sys
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats: TypeAlias = NDArray[np.floating[Any]]
    Indices: TypeAlias = NDArray[np.integer[Any]]

RESOLUTION = 320
"""Texels a side at which charts are packed, at most."""

FILL = 0.55
"""Share of the atlas that charts usually cover: the first guess at their scale."""

EFFORT = 200_000
"""Faces to be packed in all arrangements together, a chart counting for `CHART_FACES`: about 0.2 s."""

CHART_FACES, MOST_ARRANGEMENTS, FEW_CHARTS = 500, 12, 64

ANGLES = 30
"""Tried within a quarter turn for a chart's smallest box."""


def main(source: str, target: str, search_path: str) -> None:
    """Read charts and options from `source` (npz), write the atlas to `target` (npz)."""
    sys.path[:0] = search_path.split(os.pathsep)
    import numpy as np

    request = np.load(source)
    chart, faces, area = request["chart"], request["faces"], max(float(request["area"]), 1e-12)
    size, padding = int(request["texture_size"]), int(request["padding"])
    charts = int(chart.max()) + 1
    arrangements = min(max(EFFORT // (len(faces) + CHART_FACES * charts), 2), MOST_ARRANGEMENTS)
    resolution = min(size, RESOLUTION)
    gap = -(-padding * resolution // size)
    widest = size * gap / padding if padding else math.inf  # The most texels a side at which the gap is wide enough.
    target_side = 0.97 * min(resolution, widest)
    scale = target_side * (FILL / area) ** 0.5

    places, extent = _along_axes(request["places"], chart, charts)
    random, best, best_scale, trials = np.random.default_rng(0), None, 0.0, 0
    while trials < arrangements or best is None:
        turns = random.integers(0, 4, charts) if trials else (extent[:, 1] > extent[:, 0]).astype(int)
        packed, side = _packed(_turned(places, turns[chart]), extent.max(), chart, faces, scale, gap)
        if side <= widest and scale / side > best_scale:
            best, best_scale = packed / side, scale / side
        scale *= target_side / side
        trials += 1
        if best is None and trials == arrangements + 20:
            raise RuntimeError(f"{charts} charts and gaps of {padding} texels do not fit into {size} texels a side")
    np.savez(target, uvs=best)


def _along_axes(places: Floats, chart: Indices, charts: int) -> tuple[Floats, Floats]:
    """(N, 2) places with each chart turned into its smallest box, whose corner is the origin; (charts, 2) its sides."""
    import numpy as np

    smallest, result, extent = np.full(charts, np.inf), np.zeros_like(places), np.zeros((charts, 2))
    for angle in np.arange(ANGLES) * (0.5 * np.pi / ANGLES):
        turned = places @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        low, high = np.full((charts, 2), np.inf), np.full((charts, 2), -np.inf)
        np.minimum.at(low, chart, turned)
        np.maximum.at(high, chart, turned)
        box = (high - low).prod(axis=1)
        better = box < smallest
        of_better = better[chart]
        result[of_better] = (turned - low[chart])[of_better]
        smallest[better], extent[better] = box[better], (high - low)[better]
    return result, extent


def _turned(places: Floats, quarters: Indices) -> Floats:
    """(N, 2) places turned about the origin by quarter turns (N,)."""
    import numpy as np

    cosine, sine = np.array([1, 0, -1, 0])[quarters], np.array([0, 1, 0, -1])[quarters]
    x, y = places.T
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)


def _packed(
    places: Floats, spacing: float, chart: Indices, faces: Indices, scale: float, gap: int
) -> tuple[Floats, int]:
    """(N, 2) texels of charts packed at `scale` texels a unit, `gap` texels apart, and how many texels a side."""
    import numpy as np
    import xatlas

    # Side by side: xatlas takes what touches for one chart.
    columns = math.isqrt(int(chart.max())) + 1
    apart = places + 2.2 * spacing * np.stack([chart % columns, chart // columns], axis=1)
    options = xatlas.PackOptions()
    options.texels_per_unit, options.padding = 1.0, gap
    options.bruteForce = int(chart.max()) < FEW_CHARTS
    options.bilinear = False  # The gap is there for that.
    options.rotate_charts = False  # Its quarter turns are reflections.
    options.rotate_charts_to_axis = False
    atlas = xatlas.Atlas()
    atlas.add_uv_mesh((apart * scale).astype(np.float32), faces)
    atlas.generate(xatlas.ChartOptions(), options)
    original, face_uvs, uvs = atlas.get_mesh(0)
    if atlas.atlas_count != 1 or not np.array_equal(original[face_uvs], faces):
        raise RuntimeError(f"{atlas.atlas_count} atlases, {len(face_uvs)} of {len(faces)} faces, or others")
    packed = np.zeros_like(places)
    packed[original] = uvs * [atlas.width, atlas.height]  # uvs are shares of a width and of a height that differ.
    return packed, max(atlas.width, atlas.height)


if __name__ == "__main__":
    main(*sys.argv[1:])
