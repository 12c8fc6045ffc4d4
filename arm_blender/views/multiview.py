"""Where the views of an object without poses come from: its one picture, or six that another program has made."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from ..errors import CameraError, InputImageError
from ..graphics.borders import Rectangle, scaled
from ..graphics.cameras import Camera
from ..machine.picture_files import pictures_in
from ..progress import Progress
from ..structures import ViewSet
from . import preprocess
from .agreement import agreement
from .foreground import Heard, unheard
from .image_io import as_stored, read_orientation
from .mask_files import mask_beside, read_cut_out
from .masks import sees_something
from .posed_frame import PosedFrame
from .rigs import AZIMUTHS_DEG, front_camera, zero123plus_rig
from .transforms_json import read_transforms

_CLEARER = 0.03
"""Share of the masks by which pictures as they are stored have to fit better than as they are shown."""


@dataclass(frozen=True)
class View:
    """A picture that has been read, and its camera.

    Attributes:
        path: of the file, for messages.
        image: (4, H, W) linear Rec.709, straight alpha, cut out.
        camera: of that size.
        weight: how much it counts in the texture, >= 0.
        known: the pixels of `image` that a camera took, where others were added around them; None where none were.
        ground: height (world Z) of what the object stands on, where that is known.
        varying_exposure: the camera exposed by itself.
    """

    path: Path
    image: Tensor
    camera: Camera
    weight: float = 1.0
    known: Rectangle | None = None
    ground: float | None = None
    varying_exposure: bool = False


def view_alone(
    path: Path, elevation_deg: float | None, fovy_deg: float | None, progress: Progress, heard: Heard
) -> list[View]:
    """The one view of a picture that nothing else is made of, seen from the front; what is None is assumed.

    Raises:
        InputImageError: the picture does not do.
    """
    progress(0.0, f"reading {path.name}")
    image, longest, known = preprocess.crop_single(read_cut_out(path, mask_beside(path, path.parent), heard), path)
    elevation_deg = 10.0 if elevation_deg is None else elevation_deg
    fovy_deg = 30.0 if fovy_deg is None else fovy_deg
    return [View(path, image, front_camera(longest, image.shape[1], elevation_deg, fovy_deg), known=known)]


def views_of_rig(folder: Path, distance: float, fovy_deg: float | None, progress: Progress, heard: Heard) -> list[View]:
    """The views of six square pictures, by name in the order of the Zero123++ v1.2 rig.

    Raises:
        InputImageError: there are more or fewer, or one does not do.
    """
    pictures = pictures_in(folder)
    if not pictures:
        raise InputImageError(f"{folder}: holds no pictures; choose the folder that they are in")
    if len(pictures) != len(AZIMUTHS_DEG):
        raise InputImageError(
            f"{folder}: no transforms.json and {len(pictures)} images; add the cameras, have them solved, or give "
            f"exactly {len(AZIMUTHS_DEG)} images in the rig's order, or one image"
        )
    images = []
    for index, picture in enumerate(pictures):
        progress(index / len(pictures), f"reading {picture.name}")
        cut_out = read_cut_out(picture, mask_beside(picture, folder), heard)
        images.append(preprocess.limit_size(cut_out, picture))
    height, width = images[0].shape[1:]
    if height != width:
        raise InputImageError(f"{pictures[0]}: {width}x{height} pixels; the rig's views are square, crop them so")
    cameras = zero123plus_rig(distance, 30.0 if fovy_deg is None else fovy_deg, width)
    return [View(*view) for view in zip(pictures, images, cameras, strict=True)]


def posed_views(
    transforms: Path,
    progress: Progress,
    heard: Heard = unheard,
    left_out: Callable[[str, str], None] = unheard,
) -> list[View]:
    """The views of a transforms.json.

    Cameras are of pictures as they are shown, turned by EXIF, or as their files store them: `w` and `h` tell which, and
    else the masks, which have to be of one object.

    Args:
        heard: is told how each was cut out.
        left_out: is told where EXIF does not count.
    Raises:
        InputImageError, CameraError: the files do not do; the line names the file and the remedy.
    """
    frames, images, turns = read_transforms(transforms), [], []
    for index, frame in enumerate(frames):
        progress(index / len(frames), f"reading {frame.image.name}")
        images.append(read_cut_out(frame.image, frame.mask, heard))
        turns.append(read_orientation(frame.image)[2])
    told = [
        frame.is_of_stored(image.shape[2], image.shape[1], turn)
        for frame, image, turn in zip(frames, images, turns, strict=True)
    ]
    turned = [index for index, turn in enumerate(turns) if turn != 1]
    stored, why = any(told[index] for index in turned), "w and h say so"
    if turned and all(told[index] is None for index in turned):
        stored, why = _masks_prefer_stored(frames, images, turns), "the masks fit together so"
    if stored:
        left_out(f"the EXIF orientation of {len(turned)} pictures", f"cameras are of the stored pixels: {why}")
    as_meant = [stored if one is None else one for one in told]
    return _views_of(frames, images, turns, as_meant)


def _masks_prefer_stored(frames: Sequence[PosedFrame], images: Sequence[Tensor], turns: Sequence[int]) -> bool:
    """Whether pictures as their files store them, rather than as they are shown, are of one object."""
    fits = []
    for stored in (False, True):
        try:
            views = _views_of(frames, images, turns, [stored] * len(frames))
        except CameraError:
            fits.append(0.0)
            continue
        seeing = [view for view in views if sees_something(view.image[3])]
        if len({view.image.shape for view in seeing}) != 1 or len(seeing) < 2:
            return False
        pictures, cameras = torch.stack([view.image for view in seeing]), tuple(view.camera for view in seeing)
        fits.append(float(agreement(ViewSet(pictures, cameras, torch.ones(len(seeing)), "views")).mean()))
    return fits[1] > fits[0] + _CLEARER


def _views_of(
    frames: Sequence[PosedFrame], images: Sequence[Tensor], turns: Sequence[int], stored: Sequence[bool | None]
) -> list[View]:
    """The views of pictures (4, H, W) that are upright, or turned back to where their cameras have them."""
    views = []
    for frame, upright, turn, back in zip(frames, images, turns, stored, strict=True):
        image = as_stored(upright, turn) if back and turn != 1 else upright
        camera = frame.camera(image.shape[2], image.shape[1])
        limited = preprocess.limit_size(image, frame.image)
        known = frame.known(image.shape[2], image.shape[1])
        known = None if known is None else scaled(known, limited.shape[2] / image.shape[2])
        camera = camera.resized(limited.shape[2], limited.shape[1])
        views.append(View(frame.image, limited, camera, frame.weight, known, frame.ground, frame.varying_exposure))
    return views
