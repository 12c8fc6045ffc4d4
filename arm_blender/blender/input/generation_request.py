"""What the panel asks for, copied out of Blender, and its views. No bpy in this module: views are read on a thread.

Nor is torch imported here: Blender's main thread imports this module when the extension is enabled.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...asset_record import AssetRecord, chosen_values
from ...knobs import Knobs, ViewKnobs, values_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ...photographs.cameras.solving import SolvingOptions
    from ...progress import Progress
    from ...report import Report
    from ...structures import ViewSet
    from ...views import ViewOptions
    from ...views.multiview import View


@dataclass(frozen=True)
class CameraPicture:
    """What one camera of the scene sees, copied out of Blender.

    Attributes:
        name: of the camera.
        pixels: (H, W, 4) float32 as Blender holds them, row 0 at the bottom.
        encoded: colours are sRGB, not linear.
        premultiplied: colours are multiplied by alpha.
        c2w: (4, 4) camera to world, rigid.
        K: (3, 3) in pixels of this picture, row 0 on top.
    """

    name: str
    pixels: NDArray[np.float32]
    encoded: bool
    premultiplied: bool
    c2w: NDArray[np.float64]
    K: NDArray[np.float64]


@dataclass(frozen=True)
class OwnMesh:
    """A mesh of the user's, copied out of Blender.

    Attributes:
        name: of the object.
        vertices: (N, 3) world or, where the object is a result, in the frame of its cameras.
        faces: (F, 3) indices into `vertices`.
        corner_uvs: (F, 3, 2), or None where the mesh has no UVs.
        origin: of the object, in the space of the vertices; its result gets the same.
    """

    name: str
    vertices: NDArray[np.floating[Any]]
    faces: NDArray[np.int32]
    corner_uvs: NDArray[np.float32] | None
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class GenerationRequest(ViewKnobs, Knobs):
    """The user's wishes, copied out of Blender's properties before the work starts."""

    views: Path | tuple[CameraPicture, ...]
    """One image, a folder with transforms.json, or a folder of six images in the rig's order; or cameras' pictures."""
    name: str | None = None
    """Of the result; None takes that of the views."""
    mesh: OwnMesh | None = None
    """The shape; None has it reconstructed."""
    mesh_in_place: bool = False
    """The mesh is in the frame of the views' cameras, also where those are assumed."""
    device: str = field(default="auto", kw_only=True)
    """"cpu", "cuda" or "mps"; "auto" is CUDA where PyTorch finds it, else the CPU."""

    def record(self, frame: Sequence[float] | None) -> AssetRecord:
        """What another run needs to be asked for the same; pictures of cameras and the mesh by their names.

        Args:
            frame: of the object that was made.
        """
        return AssetRecord(
            chosen_values(self, self),
            views=self.views if isinstance(self.views, Path) else None,
            cameras=None if isinstance(self.views, Path) else tuple(picture.name for picture in self.views),
            mesh=None if self.mesh is None else self.mesh.name,
            frame=None if frame is None else tuple(frame),
        )


def view_options(request: GenerationRequest) -> ViewOptions:
    """How the pictures of a request are taken that come without cameras."""
    from ...views import ViewOptions

    return ViewOptions(**values_of(ViewKnobs, request))


def solving_options(request: GenerationRequest) -> SolvingOptions:
    """How cameras of photographs are solved."""
    from ...photographs.cameras.solving import SolvingOptions

    return SolvingOptions(threads=request.threads, seed=request.seed)


def views_folder(path: Path) -> Path:
    """Where the views of photographs, or of a video, are made: beside them, so that another run finds them."""
    name = path.name if path.is_dir() else path.stem
    return path.with_name(f"{name}-views") if name else path / "views"  # The root of a disk has no name.


def view_of_camera(picture: CameraPicture) -> View:
    """A picture of a camera as a view, cut out.

    Raises:
        InputImageError: it does not do.
    """
    import torch

    from ...graphics.cameras import Camera
    from ...graphics.color import linear_from_srgb
    from ...views import preprocess
    from ...views.foreground import foreground
    from ...views.multiview import View

    path = Path(picture.name)
    image = torch.from_numpy(picture.pixels[::-1].copy()).permute(2, 0, 1).clamp(0.0, 1.0)
    color, alpha = image[:3], image[3:]
    if picture.premultiplied:
        color = torch.where(alpha > 0.0, color / alpha.clamp(min=1e-6), 0.0)
    if picture.encoded:
        color = linear_from_srgb(color)
    cut_out = foreground(torch.cat([color.clamp(0.0, 1.0), alpha]), path)
    height, width = cut_out.shape[1:]
    camera = Camera(torch.tensor(picture.c2w).float(), torch.tensor(picture.K).float(), width, height)
    cut_out = preprocess.limit_size(cut_out, path)
    return View(path, cut_out, camera.resized(cut_out.shape[2], cut_out.shape[1]))


def read_views(request: GenerationRequest, progress: Progress, report: Report) -> ViewSet:
    """The views of a request, ready for a run; `report` is told what is not used.

    Raises:
        ArmError: as `load_views`; `Cancelled` from `progress`.
    """
    from ...photographs.intake import load_views
    from ...views import view_set

    if isinstance(request.views, Path):
        folder = views_folder(request.views)
        place = folder if os.access(folder.parent, os.W_OK) else None  # A card of a camera may not be written.
        return load_views(request.views, place, view_options(request), solving_options(request), report, progress)
    views = []
    for index, picture in enumerate(request.views):
        progress(index / len(request.views), f"reading {picture.name}")
        views.append(view_of_camera(picture))
    return view_set(views, Path(request.name or "object"), request.weights, report.leave_out)
