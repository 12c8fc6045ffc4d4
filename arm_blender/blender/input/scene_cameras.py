"""Cameras of the scene as views, by their background images, and views as cameras of the scene."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ...errors import CameraError, InputImageError
from .generation_request import CameraPicture

PlacedPicture = tuple[str, NDArray[np.float32], NDArray[np.float32], int, int, Path | None]
"""Of a camera that is to be made its name, c2w (4, 4), K (3, 3) in pixels with square pixels, width and height of its
picture in pixels, and the picture's file, or None."""

_SENSOR = 24.0
"""Millimetres of the height of the cameras that are made; nothing depends on it."""

_SHEAR = 1e-4

GROUND = 1.5
"""World units, half of the side of a ground that is shown: half as much again as the object."""


def cameras_with_pictures(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The cameras of a scene that have a background image, by name."""
    cameras = (item for item in scene.objects if item.type == "CAMERA")
    return sorted((item for item in cameras if _backgrounds(item.data)), key=lambda item: item.name)


def camera_pictures(
    scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, names: Iterable[str] | None = None
) -> tuple[CameraPicture, ...]:
    """What the cameras of a scene see, as far as they have a background image.

    Args:
        scene: its render size says how the images lie in the cameras' frames.
        depsgraph: of that scene, so that parents and constraints count.
        names: of the cameras, in this order; None takes all that have an image.
    Raises:
        CameraError: there is none, one is gone, or one is no pinhole camera.
        InputImageError: an image has no pixels.
    """
    cameras = cameras_with_pictures(scene)
    if names is not None:
        by_name = {camera.name: camera for camera in cameras}
        names = list(names)
        gone = [name for name in names if name not in by_name]
        if gone:
            raise CameraError(f"{gone[0]}: no such camera with a background image; press Refresh above the views")
        cameras = [by_name[name] for name in names]
    if not cameras:
        raise CameraError("No camera of the scene has a background image; add one in the camera's properties")
    return tuple(_picture(scene, camera, camera.evaluated_get(depsgraph).matrix_world) for camera in cameras)


def add_cameras(scene: bpy.types.Scene, name: str, views: Sequence[PlacedPicture]) -> list[bpy.types.Object]:
    """Put cameras into a scene, in a collection of their own; nothing else changes, the scene's camera included.

    Args:
        scene: where they go.
        name: of the collection.
        views: one for each camera.
    """
    collection = bpy.data.collections.new(name)
    scene.collection.children.link(collection)
    render = scene.render
    frame = render.resolution_x * render.pixel_aspect_x / (render.resolution_y * render.pixel_aspect_y)
    made = []
    for label, c2w, K, width, height, picture in views:
        lens = bpy.data.cameras.new(label)
        lens.sensor_fit = "VERTICAL"
        lens.sensor_height = _SENSOR
        lens.lens = float(K[1, 1]) * _SENSOR / height
        lens.shift_x = (width / 2.0 - float(K[0, 2])) / height
        lens.shift_y = (float(K[1, 2]) - height / 2.0) / height
        if picture is not None:
            background = lens.background_images.new()
            background.image = bpy.data.images.load(str(picture), check_existing=True)
            # In both cases the picture is as high as the frame, which is what the lens is set for.
            background.frame_method = "FIT" if frame >= width / height else "CROP"
            lens.show_background_images = True
        camera = bpy.data.objects.new(label, lens)
        camera.matrix_world = Matrix(np.asarray(c2w, dtype=float).tolist())
        collection.objects.link(camera)
        made.append(camera)
    return made


def placed_views(folder: Path) -> tuple[list[PlacedPicture], float | None]:
    """The views of a folder with transforms.json, to be put into a scene, and the height of the ground, where known.

    Raises:
        CameraError, InputImageError: as `read_transforms` and `read_orientation`.
    """
    from ...views.image_io import read_orientation
    from ...views.transforms_json import TRANSFORMS, read_transforms

    placed: list[PlacedPicture] = []
    frames = read_transforms(folder / TRANSFORMS)
    for frame in frames:
        width, height, _ = read_orientation(frame.image)
        camera = frame.camera(width, height)
        placed.append((frame.image.stem, camera.c2w.numpy(), camera.K.numpy(), width, height, frame.image))
    return placed, frames[0].ground


def add_ground(collection: bpy.types.Collection, height: float) -> bpy.types.Object:
    """A square at the height of what the object stands on, drawn as lines and never rendered."""
    corners = [(x * GROUND, y * GROUND, 0.0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    mesh = bpy.data.meshes.new("ARM ground")
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    ground = bpy.data.objects.new("ARM ground", mesh)
    ground.location.z, ground.display_type, ground.hide_render = height, "WIRE", True
    collection.objects.link(ground)
    return ground


def _backgrounds(lens: bpy.types.Camera) -> list[bpy.types.CameraBackgroundImage]:
    """The images behind a camera, of which the first counts; their own switch in the viewport does not matter."""
    return [one for one in lens.background_images if one.source == "IMAGE" and one.image is not None]


def _picture(scene: bpy.types.Scene, camera: bpy.types.Object, matrix: Matrix) -> CameraPicture:
    name, background = camera.name, _backgrounds(camera.data)[0]
    if camera.data.type != "PERSP":
        raise CameraError(f"{name}: is no perspective camera; change its lens type, or remove its background image")
    moved = any(background.offset) or background.scale != 1.0 or background.rotation
    if moved or background.use_flip_x or background.use_flip_y:
        raise CameraError(f"{name}: its background image is moved, scaled or flipped; set that back")
    image = background.image
    width, height = image.size
    if not width * height:
        raise InputImageError(f"{name}: its background image {image.name} has no pixels; reload it, or choose another")
    pixels = np.empty(4 * width * height, dtype=np.float32)
    image.pixels.foreach_get(pixels)
    return CameraPicture(
        name=name,
        pixels=pixels.reshape(height, width, 4),
        encoded=not image.is_float and image.colorspace_settings.name == "sRGB",
        premultiplied=image.is_float,
        c2w=_rigid(matrix, name),
        K=_intrinsics(scene, camera.data, background, width, height),
    )


def _rigid(matrix: Matrix, name: str) -> NDArray[np.float64]:
    """(4, 4) of a camera's matrix without its scale, which does not change what it sees."""
    c2w = np.array(matrix)
    lengths = np.linalg.norm(c2w[:3, :3], axis=0)
    rotation = c2w[:3, :3] / np.maximum(lengths, 1e-12)
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > _SHEAR or np.linalg.det(rotation) < 0.0:
        raise CameraError(f"{name}: is mirrored or sheared; apply the scale of the camera and of its parents")
    c2w[:3, :3] = rotation
    return c2w


def _intrinsics(
    scene: bpy.types.Scene,
    lens: bpy.types.Camera,
    background: bpy.types.CameraBackgroundImage,
    width: int,
    height: int,
) -> NDArray[np.float64]:
    """(3, 3) K in pixels of a background image, from where it lies in the camera's frame."""
    corners = np.array(lens.view_frame(scene=scene))  # Lens shift, sensor fit and pixel aspect are in it.
    low, high, depth = corners.min(axis=0)[:2], corners.max(axis=0)[:2], -corners[0, 2]
    middle, frame = (low + high) / 2.0, high - low
    size = frame.copy()
    aspect = width / height
    if background.frame_method != "STRETCH":
        wider = aspect > frame[0] / frame[1]
        if wider == (background.frame_method == "FIT"):
            size[1] = frame[0] / aspect
        else:
            size[0] = frame[1] * aspect
    left, top = middle[0] - size[0] / 2.0, middle[1] + size[1] / 2.0
    scale_x, scale_y = width / size[0], height / size[1]
    return np.array([[depth * scale_x, 0.0, -left * scale_x], [0.0, depth * scale_y, top * scale_y], [0.0, 0.0, 1.0]])
