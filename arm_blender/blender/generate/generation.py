"""The run that answers what the panel asks for. No bpy in this module: it runs on a worker thread.

Nor is torch imported here: Blender's main thread imports this module when the extension is enabled.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ... import run
from ...knobs import Knobs, values_of
from ..input.generation_request import GenerationRequest, OwnMesh, read_views

if TYPE_CHECKING:
    from ...progress import Progress
    from ...report import Report
    from ...structures import RelightableAsset, TriangleMesh, UvMesh, ViewSet
    from ...views.scene_frame import SceneFrame


class Generated(NamedTuple):
    """What a run gives.

    Attributes:
        asset: in the cameras' frame, or where the user's mesh is.
        report: of the run.
        frame: `restore` brings the asset's vertices into the cameras' frame.
    """

    asset: RelightableAsset
    report: Report
    frame: SceneFrame


def generate(request: GenerationRequest, progress: Progress) -> Generated:
    """Load the views and run the whole pipeline.

    Raises:
        ArmError: as the stages; `Cancelled` from `progress`.
    """
    # Importing torch takes seconds: here it does so on the worker thread, while Blender stays usable.
    device = _device(request)
    report = run.begin(request.preset, device, request.seed, progress)
    from ...config import Settings
    from ...views.scene_frame import IDENTITY

    normal_map = request.normal_map and request.mesh is None  # A mesh of the user's loses no detail.
    settings = Settings(**values_of(Knobs, request) | {"device": device, "normal_map": normal_map})
    frames = [IDENTITY]

    def own_mesh(own: OwnMesh, views: ViewSet) -> TriangleMesh | UvMesh:
        mesh, frame = _own_mesh(own, request, views, report)
        frames.append(frame)
        return mesh.moved(frame.restore)

    read_mesh = None if request.mesh is None else partial(own_mesh, request.mesh)
    asset = run.make(settings, partial(read_views, request), read_mesh, progress, report)
    frame = frames[-1]
    name = request.name or asset.name
    return Generated(replace(asset, name=name, mesh=asset.mesh.moved(frame.boxed)), report, frame)


def draw_views(
    request: GenerationRequest, picture: Path, model: Path, folder: Path, steps: int, progress: Progress
) -> Path:
    """Have Zero123++ draw six views of a picture.

    Args:
        request: seed, device, threads and rig are those of the drawing.
        picture: of the object.
        model: folder of the weights, as diffusers saves a pipeline.
        folder: where the views go; what it already holds of them is replaced.
        steps: of the sampler.
    Returns:
        `folder`, which is a folder of views with cameras now.
    Raises:
        ArmError: as `drawn_views`; the folder is as it was.
    """
    progress(0.0, "starting")
    from ...views.zero123plus.provider import drawn_views
    from ...views.zero123plus.sampling import Zero123PlusConfig

    drawing = Zero123PlusConfig(
        model, folder, steps=steps, seed=request.seed, device=_device(request), threads=request.threads
    )
    drawn_views(picture, drawing, request.rig_distance, request.fovy_deg, progress)
    return folder


def _device(request: GenerationRequest) -> str:
    """What "auto" stands for on this machine."""
    if request.device != "auto":
        return request.device
    import torch

    return "cuda" if torch.cuda.is_available() else "cpu"


def _own_mesh(
    own: OwnMesh, request: GenerationRequest, views: ViewSet, report: Report
) -> tuple[TriangleMesh | UvMesh, SceneFrame]:
    """The user's mesh, and the frame that restores it to where the views show it."""
    from ...photographs.way import has_cameras
    from ...uv.given_mesh import mesh_from_arrays
    from ...views.mesh_fit import fit_to_views
    from ...views.scene_frame import IDENTITY

    uvs = None
    if own.corner_uvs is not None:
        import numpy as np

        uvs = own.corner_uvs.reshape(-1, 2), np.arange(own.faces.size).reshape(-1, 3)
    mesh = mesh_from_arrays(own.name, own.vertices, own.faces, uvs, left_out=report.leave_out)
    placed = request.mesh_in_place or not isinstance(request.views, Path) or has_cameras(request.views)
    return mesh, IDENTITY if placed else fit_to_views(mesh, views)
