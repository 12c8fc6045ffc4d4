"""A look at the views before anything long starts: each picture, its foreground, its weight. No bpy in this module."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from .told_pictures import ToldPicture, told_pictures

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ...progress import Progress
    from ...views.multiview import View
    from .generation_request import GenerationRequest

SIDE = 128
"""Pixels of the longer side of a thumbnail."""

Kind = Literal["picture", "rig", "posed", "photographs"]
"""One picture from the front, pictures of the rig, views with cameras of their own, or photographs without."""


@dataclass(frozen=True)
class SeenView:
    """One view, as the panel shows it.

    Attributes:
        name: of the file or camera.
        picture: (h, w, 4) float32 sRGB, opaque, row 0 at the bottom.
        mask: (h, w, 4) the same of the foreground, white on black.
        weight: how much it counts, as the views say.
        sees: it shows something.
        camera: c2w (4, 4) and K (3, 3); None where it is still to be solved.
        size: width and height in pixels that K is for.
        path: of the picture.
        way: how it was cut out; empty where that is nobody's business.
        doubt: why its mask may be wrong; empty where nothing speaks against it.
    """

    name: str
    picture: NDArray[np.float32]
    mask: NDArray[np.float32]
    weight: float
    sees: bool
    camera: tuple[NDArray[np.float32], NDArray[np.float32]] | None
    size: tuple[int, int]
    path: Path
    way: str = ""
    doubt: str = ""


@dataclass(frozen=True)
class Look:
    """What a look found.

    Attributes:
        kind: of the views.
        views: or pictures, where they are not yet views.
        told: what became of each photograph, where views were made of them.
        folder: the one that the views are in, at whatever depth; None where there are no files of views.
    """

    kind: Kind
    views: tuple[SeenView, ...]
    told: tuple[ToldPicture, ...] = ()
    folder: Path | None = None


def look(request: GenerationRequest, progress: Progress) -> Look:
    """The views of a request, read and cut out as its run will do it.

    Raises:
        ArmError: as reading them for the run; `Cancelled` from `progress`.
    """
    progress(0.0, "reading the views")
    from ...photographs.intake import read_views
    from ...photographs.way import are_views_of, has_cameras, way_of
    from ...report import Report
    from .generation_request import solving_options, view_of_camera, view_options, views_folder

    if not isinstance(request.views, Path):
        return Look("posed", tuple(_seen(view_of_camera(picture)) for picture in request.views))
    if way_of(request.views, request.cameras_from).cameras == "solve":
        pictures, made = tuple(_photographs(request.views, progress)), views_folder(request.views)
        told = told_pictures(made) if are_views_of(made, request.views) else ()
        return Look("photographs", pictures, told, made if told else None)
    untold = Report(request.preset, request.device, request.seed)  # A run says what this only shows.
    views = read_views(request.views, None, view_options(request), solving_options(request), untold, progress)
    kind: Kind = "posed" if has_cameras(request.views) else "picture" if len(views) == 1 else "rig"
    folder = request.views if request.views.is_dir() else request.views.parent
    told = told_pictures(folder) if kind == "posed" else ()
    return Look(kind, tuple(_seen(view, untold.masks) for view in views), told, folder)


def _photographs(path: Path, progress: Progress) -> Iterator[SeenView]:
    """The photographs of a folder as they are: nothing is cut out before their cameras are solved. None of a video."""
    import numpy as np

    from ...machine.picture_files import is_video
    from ...photographs.pictures import photographs_in
    from ...views.pillow_io import reduced

    files = [] if is_video(path) else photographs_in(path)
    for index, file in enumerate(files):
        progress(index / len(files), f"reading {file.name}")
        picture = np.ascontiguousarray(reduced(file, SIDE)[::-1].astype(np.float32) / 255.0)
        height, width = picture.shape[:2]
        yield SeenView(file.name, picture, np.ones_like(picture), 1.0, True, None, (width, height), file)


def _seen(view: View, masks: Mapping[str, Sequence[str]] | None = None) -> SeenView:
    """A view as it is shown; `masks` are the names of pictures by the ways that they were cut out, and by doubts."""
    import torch

    from ...graphics.color import srgb_from_linear
    from ...report import DOUBTFUL
    from ...views.masks import sees_something

    ways = [way for way, names in (masks or {}).items() if view.path.name in names]
    doubts = [way.removeprefix(DOUBTFUL) for way in ways if way.startswith(DOUBTFUL)]
    height, width = view.image.shape[1:]
    scale = min(1.0, SIDE / max(height, width))
    size = max(1, round(height * scale)), max(1, round(width * scale))
    small = torch.nn.functional.interpolate(view.image[None], size=size, mode="area")[0].flip(1)
    opaque = torch.ones_like(small[3:])
    picture = torch.cat([srgb_from_linear(small[:3].clamp(0.0, 1.0)), opaque])
    mask = torch.cat([small[3:].expand(3, -1, -1), opaque])
    return SeenView(
        name=view.path.name,
        picture=picture.permute(1, 2, 0).contiguous().numpy(),
        mask=mask.permute(1, 2, 0).contiguous().numpy(),
        weight=view.weight,
        sees=sees_something(view.image[3]),
        camera=(view.camera.c2w.numpy(), view.camera.K.numpy()),
        size=(view.camera.width, view.camera.height),
        path=view.path,
        way=next((way for way in ways if not way.startswith(DOUBTFUL)), ""),
        doubt="; ".join(doubts),
    )
