"""What the panel asks for, and the run that answers it. No bpy in this module: it runs on a worker thread.

Nor is torch imported here: Blender's main thread imports this module when the extension is enabled.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from .. import run

if TYPE_CHECKING:
    import numpy as np

    from ..progress import Progress
    from ..report import Report
    from ..structures import RelightableAsset, TriangleMesh, UvMesh, ViewSet
    from ..views import ViewOptions
    from ..views.multiview import View
    from ..views.scene_frame import SceneFrame


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
    pixels: np.ndarray
    encoded: bool
    premultiplied: bool
    c2w: np.ndarray
    K: np.ndarray


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
    vertices: np.ndarray
    faces: np.ndarray
    corner_uvs: np.ndarray | None
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class GenerationRequest:
    """The user's wishes, copied out of Blender's properties before the work starts."""

    views: Path | tuple[CameraPicture, ...]
    """One image, a folder with transforms.json, or a folder of six images in the rig's order; or cameras' pictures."""
    name: str | None = None
    """Of the result; None takes that of the views."""
    weights: tuple[float, ...] | None = None
    """One per view, 0 leaves it out; None takes the views' own."""
    elevation_deg: float | None = None
    """Of the camera of a single picture."""
    fovy_deg: float | None = None
    """Of a single picture or of the rig."""
    rig_distance: float = 4.0
    """Of the rig."""
    mesh: OwnMesh | None = None
    """The shape; None has it reconstructed."""
    mesh_in_place: bool = False
    """The mesh is in the frame of the views' cameras, also where those are assumed."""
    preset: str = "small"
    quality: str = "balanced"
    texture_size: int | None = None
    """Texels a side at most; None leaves it to the quality."""
    faces: int | None = None
    """Triangles at most; None leaves it to the quality."""
    normal_map: bool = False
    """Bake the detail lost to the face budget; a mesh of the user's loses none."""
    own_weights: str | None = None
    """Folder of weights of the user's own; None takes those of the preset."""
    seed: int = 0
    device: str = "auto"
    """"cpu", "cuda" or "mps"; "auto" is CUDA where PyTorch finds it, else the CPU."""
    threads: int | None = None
    """None leaves it to torch."""

    def as_settings(self) -> dict[str, object]:
        """What another run needs to be asked for the same, as JSON types; pictures and mesh by their names."""
        cameras = None if isinstance(self.views, Path) else [picture.name for picture in self.views]
        return {
            "views": str(self.views) if cameras is None else None,
            "cameras": cameras,
            "mesh": None if self.mesh is None else self.mesh.name,
            "weights": None if self.weights is None else list(self.weights),
        } | {name: getattr(self, name) for name in PLAIN}


PLAIN = (
    "elevation_deg",
    "fovy_deg",
    "rig_distance",
    "preset",
    "quality",
    "texture_size",
    "faces",
    "normal_map",
    "own_weights",
    "seed",
)
"""Fields of a request that are kept with its result as they are; device and threads are the machine's."""


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
    from ..config import Settings
    from ..views.scene_frame import IDENTITY

    settings = Settings(
        preset=request.preset,
        quality=request.quality,
        texture_size=request.texture_size,
        faces=request.faces,
        normal_map=request.normal_map and request.mesh is None,
        seed=request.seed,
        device=device,
        threads=request.threads,
        weights_folder=None if request.own_weights is None else Path(request.own_weights),
    )
    frames = [IDENTITY]

    def own_mesh(views: ViewSet) -> TriangleMesh | UvMesh:
        mesh, frame = _own_mesh(request, views)
        frames.append(frame)
        return mesh.moved(frame.restore)

    read_mesh = None if request.mesh is None else own_mesh
    asset = run.make(settings, partial(_views, request), read_mesh, progress, report)
    frame = frames[-1]
    name = request.name or asset.name
    return Generated(replace(asset, name=name, mesh=asset.mesh.moved(frame.boxed)), report, frame)


def draw_views(request: GenerationRequest, model: Path, folder: Path, steps: int, progress: Progress) -> Path:
    """Have Zero123++ draw six views of the request's one picture.

    Args:
        request: its views are a picture; seed, device and threads are those of the drawing.
        model: folder of the weights, as diffusers saves a pipeline.
        folder: where the views go; what it already holds of them is replaced.
        steps: of the sampler.
    Returns:
        `folder`, which is a folder of views with cameras now.
    Raises:
        ArmError: as `Zero123Plus.views`; the folder is as it was.
    """
    progress(0.0, "starting")
    from ..views.zero123plus.provider import Zero123Plus
    from ..views.zero123plus.sampling import Zero123PlusConfig

    drawing = Zero123PlusConfig(
        model, folder, steps, seed=request.seed, device=_device(request), threads=request.threads
    )
    Zero123Plus(drawing, request.rig_distance, request.fovy_deg).views(request.views, progress)
    return folder


def _device(request: GenerationRequest) -> str:
    """What "auto" stands for on this machine."""
    if request.device != "auto":
        return request.device
    import torch

    return "cuda" if torch.cuda.is_available() else "cpu"


def view_options(request: GenerationRequest) -> ViewOptions:
    """How the pictures of a request are taken that come without cameras."""
    from ..views import ViewOptions

    return ViewOptions(
        rig_distance=request.rig_distance, elevation_deg=request.elevation_deg, fovy_deg=request.fovy_deg
    )


def view_of_camera(picture: CameraPicture) -> View:
    """A picture of a camera as a view, cut out.

    Raises:
        InputImageError: it does not do.
    """
    import torch

    from ..graphics.cameras import Camera
    from ..graphics.color import linear_from_srgb
    from ..views import preprocess
    from ..views.foreground import foreground
    from ..views.multiview import View

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


def _views(request: GenerationRequest, progress: Progress, report: Report) -> ViewSet:
    from ..views import load_views, view_set

    if isinstance(request.views, Path):
        options = replace(view_options(request), weights=request.weights)
        return load_views(request.views, options, progress, report.leave_out, report.note_mask)
    views = []
    for index, picture in enumerate(request.views):
        progress(index / len(request.views), f"reading {picture.name}")
        views.append(view_of_camera(picture))
    return view_set(views, Path(request.name or "object"), request.weights, report.leave_out)


def _own_mesh(request: GenerationRequest, views: ViewSet) -> tuple[TriangleMesh | UvMesh, SceneFrame]:
    """The user's mesh, and the frame that restores it to where the views show it."""
    from ..uv.given_mesh import mesh_from_arrays
    from ..views import has_cameras
    from ..views.mesh_fit import fit_to_views
    from ..views.scene_frame import IDENTITY

    own = request.mesh
    uvs = None
    if own.corner_uvs is not None:
        import numpy as np

        uvs = own.corner_uvs.reshape(-1, 2), np.arange(own.faces.size).reshape(-1, 3)
    mesh = mesh_from_arrays(own.name, own.vertices, own.faces, uvs)
    placed = request.mesh_in_place or not isinstance(request.views, Path) or has_cameras(request.views)
    return mesh, IDENTITY if placed else fit_to_views(mesh, views)
