"""Where the views of an object without poses come from: its one picture, or six that another program has made."""

from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from ..errors import InputImageError
from ..graphics.borders import Rectangle, scaled
from ..graphics.cameras import Camera
from ..machine.picture_files import pictures_in
from ..progress import Progress
from . import preprocess
from .foreground import Heard, unheard
from .mask_files import mask_beside, read_cut_out
from .rigs import AZIMUTHS_DEG, front_camera, zero123plus_rig
from .transforms_json import read_transforms


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


def posed_views(transforms: Path, progress: Progress, heard: Heard = unheard) -> list[View]:
    """The views of a transforms.json; `heard` is told how each was cut out.

    Raises:
        InputImageError, CameraError: the files do not do; the line names the file and the remedy.
    """
    views = []
    frames = read_transforms(transforms)
    for index, frame in enumerate(frames):
        progress(index / len(frames), f"reading {frame.image.name}")
        image = read_cut_out(frame.image, frame.mask, heard)
        camera = frame.camera(image.shape[2], image.shape[1])
        limited = preprocess.limit_size(image, frame.image)
        known = frame.known(image.shape[2], image.shape[1])
        known = None if known is None else scaled(known, limited.shape[2] / image.shape[2])
        camera = camera.resized(limited.shape[2], limited.shape[1])
        views.append(View(frame.image, limited, camera, frame.weight, known, frame.ground, frame.varying_exposure))
    return views
