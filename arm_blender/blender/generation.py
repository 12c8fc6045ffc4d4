"""What the panel asks for, and the pipeline run that answers it. No bpy in this module: it runs on a worker thread."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..progress import Progress
    from ..report import Report
    from ..structures import RelightableAsset

LOADING_SHARE = 0.05
"""Of the progress bar; the networks take the rest."""


@dataclass(frozen=True)
class GenerationRequest:
    """The user's wishes, copied out of Blender's properties before the work starts."""

    views: Path
    """One image, a folder with transforms.json, or a folder of six images in the rig's order."""
    preset: str = "small"
    quality: str = "balanced"
    texture_size: int | None = None
    """Texels a side at most; None leaves it to the quality."""
    faces: int | None = None
    """Triangles at most; None leaves it to the quality."""
    seed: int = 0
    device: str = "auto"
    """"cpu", "cuda" or "mps"; "auto" is CUDA where PyTorch finds it, else the CPU."""
    threads: int | None = None
    """None leaves it to torch."""

    def as_settings(self) -> dict[str, object]:
        """The same, for the custom properties of the object."""
        return asdict(self) | {"views": self.views.name}


def generate(request: GenerationRequest, progress: Progress) -> tuple[RelightableAsset, Report]:
    """Load the views and run the whole pipeline.

    Raises:
        ArmError: as the stages; `Cancelled` from `progress`.
    """
    progress(0.0, "Starting")
    # Importing torch takes seconds: here it does so on the worker thread, while Blender stays usable.
    import torch

    from .. import pipeline
    from ..config import Settings
    from ..progress import part
    from ..report import Report
    from ..views import load_views

    device = request.device
    if device == "auto":
        device = "cuda" if torch.cuda.is_available() else "cpu"
    settings = Settings(
        preset=request.preset,
        quality=request.quality,
        texture_size=request.texture_size,
        faces=request.faces,
        seed=request.seed,
        device=device,
        threads=request.threads,
    )
    report = Report(settings.preset, settings.device, settings.seed)
    with report.stage("load"):
        views = load_views(request.views, progress=part(progress, 0.0, LOADING_SHARE), left_out=report.leave_out)
    return pipeline.generate(views, settings, part(progress, LOADING_SHARE, 1.0), report)
