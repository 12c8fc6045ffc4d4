"""From files to posed views: a folder with transforms.json, a folder of six pictures in rig order, one picture."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from ..errors import ArmError, CameraError, InputImageError
from ..knobs import ViewKnobs, check
from ..machine.picture_files import pictures_in
from ..progress import Progress, silent
from ..structures import ViewSet
from . import preprocess
from .foreground import Heard, unheard
from .multiview import View, posed_views, view_alone, views_of_rig
from .transforms_json import TRANSFORMS, transforms_in
from .zero123plus.provider import drawn_views
from .zero123plus.sampling import Zero123PlusConfig

WEIGHTS = 1e-6, 1e6
"""A view's weight is 0 or lies between these: what is blended by it stays far from the ends of float32."""

LeaveOut = Callable[[str, str], None]
"""Is told what was not used, and why; `Report.leave_out` is one."""


@dataclass(frozen=True, kw_only=True)
class ViewOptions(ViewKnobs):
    """The knobs of the views, and what they need."""

    zero123plus: Zero123PlusConfig | None = None
    """Of that provider, which does not work without."""

    def __post_init__(self) -> None:
        check(self)
        if self.multiview == "zero123plus" and self.zero123plus is None:
            raise ArmError(
                "--multiview zero123plus: no weights; give their folder by --multiview-model, or --multiview none"
            )


def load_views(
    path: Path,
    options: ViewOptions | None = None,
    progress: Progress = silent,
    left_out: LeaveOut | None = None,
    heard: Heard = unheard,
) -> ViewSet:
    """Reads the views of one object.

    Args:
        path: a picture, a folder with transforms.json (or that file), or a folder of six pictures in the rig's order.
        options: for what the files do not say.
        progress: is told each picture.
        left_out: is told what is not used, and why: views that see nothing, pixels beyond `preprocess.MAXIMUM_SIDE`.
        heard: is told how each picture was cut out.
    Returns:
        The views that see something, in the cameras' own frame.
    Raises:
        InputImageError, CameraError: the files do not do; the line names the file and the remedy.
        Cancelled: by `progress`.
    """
    options = options or ViewOptions()
    return view_set(read_views(path, options, progress, left_out, heard), path, options.weights, left_out)


def read_views(
    path: Path,
    options: ViewOptions,
    progress: Progress = silent,
    left_out: LeaveOut | None = None,
    heard: Heard = unheard,
) -> list[View]:
    """All views at `path`, cut out, also those that see nothing: what `load_views` chooses from.

    Raises:
        as `load_views`.
    """
    try:
        return _read(path, options, progress, left_out or unheard, heard)
    except OSError as error:
        raise InputImageError(f"{path}: cannot be read ({error.strerror}); check the path and its rights") from error


def view_set(
    views: list[View], path: Path, weights: tuple[float, ...] | None = None, left_out: LeaveOut | None = None
) -> ViewSet:
    """The views that see something, as one set named after `path`.

    Args:
        views: cut out, with their cameras.
        path: where they are from; need not exist.
        weights: one per view, over the views' own.
        left_out: as for `load_views`.
    Raises:
        InputImageError: sizes differ, no view sees anything, or a weight does not do.
    """
    preprocess.same_size([view.image for view in views], [view.path for view in views])
    if weights is not None:
        if len(weights) != len(views):
            raise InputImageError(f"{path}: {len(views)} views but {len(weights)} --view-weights; give one per view")
        views = [replace(view, weight=weight) for view, weight in zip(views, weights, strict=True)]
    for view in views:
        if view.weight != 0.0 and not WEIGHTS[0] <= view.weight <= WEIGHTS[1]:
            limits = " to ".join(f"{limit:g}" for limit in WEIGHTS)
            raise InputImageError(f"{view.path}: its weight is {view.weight:g}; give 0, or {limits}")
    seeing = preprocess.seeing_views([view.image for view in views], [view.path for view in views])
    if left_out is not None:
        for index in sorted(set(range(len(views))) - set(seeing)):
            left_out(f"view {views[index].path.name}", "it shows nothing")
        if max(views[0].image.shape[1:]) == preprocess.MAXIMUM_SIDE:
            left_out(f"pixels beyond {preprocess.MAXIMUM_SIDE} a side", "no texture can hold them")
    views = [views[index] for index in seeing]
    height, width = views[0].image.shape[1:]
    known = tuple(view.known or (0, 0, width, height) for view in views)
    if not any(view.weight > 0.0 for view in views):
        raise InputImageError(f"{path}: every view that shows something has weight 0; give one a positive weight")
    return ViewSet(
        images=torch.stack([view.image for view in views]),
        cameras=tuple(view.camera for view in views),
        weights=torch.tensor([view.weight for view in views]),
        name=_name(path),
        known=None if all(view.known is None for view in views) else known,
        ground=views[0].ground,
        varying_exposure=any(view.varying_exposure for view in views),
        pictures=tuple(view.path.name for view in views),
    )


def has_cameras(path: Path) -> bool:
    """Whether the views at `path` come with cameras of their own; else they are assumed."""
    return path.suffix.lower() == ".json" or transforms_in(path) is not None


def _read(path: Path, options: ViewOptions, progress: Progress, left_out: LeaveOut, heard: Heard) -> list[View]:
    """The views at `path`, by what is there."""
    if path.is_dir() and options.cameras_from != "rig" and (transforms := transforms_in(path)) is not None:
        return _read(transforms, options, progress, left_out, heard)
    pictures = pictures_in(path) if path.is_dir() else []
    if options.cameras_from == "file" and not path.suffix.lower() == ".json":
        raise CameraError(f"{path}: has no {TRANSFORMS}; add the cameras, or leave --cameras to auto")
    if len(pictures) == 1:
        return _read(pictures[0], options, progress, left_out, heard)
    if options.multiview != "none" and (path.is_dir() or path.suffix.lower() == ".json"):
        left_out(f"--multiview {options.multiview}", "it makes views of a single picture; here they are given")
    if path.is_dir():
        return views_of_rig(path, options.rig_distance, options.fovy_deg, progress, heard)
    if not path.exists():
        raise InputImageError(f"{path}: no such file or folder; give an image, or a folder of views")
    if path.suffix.lower() == ".json":
        return posed_views(path, progress, heard, left_out)
    if options.multiview == "zero123plus" and options.zero123plus is not None:
        return drawn_views(path, options.zero123plus, options.rig_distance, options.fovy_deg, progress, heard)
    return view_alone(path, options.elevation_deg, options.fovy_deg, progress, heard)


def _name(path: Path) -> str:
    """What the result is called: the picture's or the folder's name."""
    path = path.resolve()
    if path.suffix.lower() == ".json":
        path = path.parent
    return (path.name if path.is_dir() else path.stem) or "object"
