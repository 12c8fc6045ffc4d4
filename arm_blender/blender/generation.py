"""What the panel asks for, and the pipeline run that answers it. No bpy in this module: it runs on a worker thread."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..report import Report
    from ..structures import Progress, RelightableAsset


@dataclass(frozen=True)
class GenerationRequest:
    """The user's wishes, copied out of Blender's properties before the work starts."""

    views: Path
    """One image, a folder with transforms.json, or a folder of six images in the rig's order."""
    preset: str = "small"
    texture_size: int | None = None
    """Texels a side; None leaves it to the quality."""
    faces: int | None = None
    """Triangles; None leaves it to the quality."""
    seed: int = 0
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
    from .. import pipeline
    from ..config import Settings
    from ..views import ViewOptions, load_views

    settings = Settings(
        preset=request.preset,
        texture_size=request.texture_size,
        faces=request.faces,
        seed=request.seed,
        threads=request.threads,
    )
    views = load_views(request.views, ViewOptions(), progress)
    return pipeline.generate(views, settings, progress)
