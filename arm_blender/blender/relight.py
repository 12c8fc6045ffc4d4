"""Render an asset under environment maps, and a contact sheet of it."""

import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import bpy
import numpy as np

from ..errors import ArmError
from ..progress import Progress, silent
from .compat import reason, use_cycles, use_eevee, use_neutral_view, use_png
from .console import without_chatter
from .export import written_by_blender
from .studio import add_camera, bounding_sphere, environment_path, light_by_environment, temporary_scene

Engine = Literal["cycles", "eevee"]

PREVIEW_ENVIRONMENTS = ("studio", "sunset")
PREVIEW_TURNS = 2
PREVIEW_BACKDROP = 0.82
"""sRGB grey behind the object."""


@dataclass(frozen=True)
class RelightConfig:
    """How an asset is rendered."""

    engine: Engine = "cycles"
    """Eevee is fast on a graphics device and slow or impossible without one."""
    resolution: int = 512
    """Pixels a side."""
    samples: int = 32
    """Paths a pixel; fewer than 16 leave blotches after denoising."""
    turntable: int = 1
    """Pictures in one full turn of the object under a light that stands still."""
    azimuth_deg: float = 30.0
    """Of the camera; 0 is Blender's front."""
    elevation_deg: float = 15.0
    """Of the camera, above the horizon."""

    def __post_init__(self) -> None:
        if self.engine not in ("cycles", "eevee"):
            raise ValueError(f"engine must be 'cycles' or 'eevee', got {self.engine!r}")
        if min(self.resolution, self.samples, self.turntable) < 1:
            raise ValueError(f"resolution, samples and turntable must be at least 1, got {self}")


@without_chatter()
def relight(
    source: bpy.types.Object | Path | str,
    environments: Sequence[Path | str],
    output: Path | str,
    config: RelightConfig = RelightConfig(),
    progress: Progress = silent,
) -> list[Path]:
    """Render an asset under each environment map, on a transparent background.

    The open file keeps its scenes, selection and datablocks.

    Args:
        source: a mesh object of the open file, or a .blend, .glb or .gltf file.
        environments: files, or names of the maps that Blender ships ("forest", "studio", ...).
        output: the folder for the pictures; made where it is missing.
        config: engine, size, quality and camera.
        progress: told before each picture.
    Returns:
        `<asset>_<environment>_<turn>.png` for every environment and turn, in that order.
    Raises:
        ArmError: the asset cannot be read.
        InputImageError: an environment map cannot be read.
        OutputError: a picture cannot be written.
    """
    maps = [environment_path(environment) for environment in environments]
    name = source.name if isinstance(source, bpy.types.Object) else Path(source).stem
    pictures = []
    with temporary_scene("Relight") as scene:
        pivot = _show(scene, source, config)
        total = len(maps) * config.turntable
        for path in maps:
            light_by_environment(scene, path)
            for turn in range(config.turntable):
                progress(len(pictures) / total, f"Rendering {name} under {path.stem}")
                pivot.rotation_euler[2] = 2.0 * math.pi * turn / config.turntable
                picture = Path(output) / f"{name}_{path.stem}_{turn:03d}.png"
                _render(scene, picture)
                pictures.append(picture)
    return pictures


@without_chatter()
def preview(
    source: bpy.types.Object | Path | str,
    picture: Path | str,
    environments: Sequence[Path | str] = PREVIEW_ENVIRONMENTS,
    resolution: int = 384,
    samples: int = 16,
) -> None:
    """One PNG of an asset: a column for each environment map, a row for each of two opposite sides.

    Args:
        source: a mesh object of the open file, or a .blend, .glb or .gltf file.
        picture: the PNG; (2 * resolution) pixels high.
        environments: files, or names of the maps that Blender ships.
        resolution: pixels a side of one render.
        samples: paths a pixel.
    Raises:
        as `relight`.
    """
    config = RelightConfig(resolution=resolution, samples=samples, turntable=PREVIEW_TURNS)
    with tempfile.TemporaryDirectory() as folder:
        renders = [_read_pixels(path) for path in relight(source, environments, folder, config)]
    columns = [np.concatenate(renders[i : i + PREVIEW_TURNS][::-1]) for i in range(0, len(renders), PREVIEW_TURNS)]
    sheet = np.concatenate(columns, axis=1)
    sheet[..., :3] = sheet[..., :3] * sheet[..., 3:] + PREVIEW_BACKDROP * (1.0 - sheet[..., 3:])
    sheet[..., 3] = 1.0
    with written_by_blender(Path(picture)) as partial:
        _write_pixels(partial, sheet)


def _show(scene: bpy.types.Scene, source: bpy.types.Object | Path | str, config: RelightConfig) -> bpy.types.Object:
    """Put the asset into `scene` with a camera; returns the empty that turns it about the vertical."""
    if isinstance(source, bpy.types.Object):
        shown = [_copied(scene, source)]
    else:
        shown = _loaded(scene, Path(source))
    layer = scene.view_layers[0]
    layer.update()  # Otherwise the world matrices of what was just linked are those of the file, or unit.
    meshes = [item for item in shown if item.type == "MESH" and len(item.data.vertices) > 0]
    if not meshes:
        raise ArmError(f"{source}: has no mesh with vertices; give an asset that `generate` wrote")
    center, radius = bounding_sphere(meshes)
    pivot = bpy.data.objects.new("Turntable", None)
    pivot.location = center
    scene.collection.objects.link(pivot)
    layer.update()
    for item in shown:
        if item.parent is None:
            item.parent = pivot
            item.matrix_parent_inverse = pivot.matrix_world.inverted()
    add_camera(scene, center, radius, config.azimuth_deg, config.elevation_deg)
    (use_cycles if config.engine == "cycles" else use_eevee)(scene, config.samples)
    use_neutral_view(scene)
    use_png(scene)
    render = scene.render
    render.resolution_x = render.resolution_y = config.resolution
    render.film_transparent = True
    render.use_persistent_data = True
    render.use_compositing = render.use_sequencer = False
    return pivot


def _copied(scene: bpy.types.Scene, source: bpy.types.Object) -> bpy.types.Object:
    """A copy that shares the mesh and the materials, so that the user's object is not moved."""
    copied = source.copy()
    copied.animation_data_clear()
    copied.parent = None
    copied.matrix_world = source.matrix_world
    copied.hide_render = False
    scene.collection.objects.link(copied)
    return copied


def _loaded(scene: bpy.types.Scene, path: Path) -> list[bpy.types.Object]:
    """The objects of a file but its cameras and lamps, linked to `scene`."""
    path = path.absolute()
    kind = path.suffix.lower()
    if not path.is_file():
        raise ArmError(f"{path}: no such asset; give a .blend, .glb or .gltf file")
    try:
        if kind == ".blend":
            with bpy.data.libraries.load(str(path), link=False) as (available, wanted):
                wanted.objects = list(available.objects)
            loaded = [item for item in wanted.objects if item is not None]
            for item in loaded:
                scene.collection.objects.link(item)
        elif kind in (".glb", ".gltf"):
            layer = scene.view_layers[0]
            with bpy.context.temp_override(
                scene=scene, view_layer=layer, collection=scene.collection, layer_collection=layer.layer_collection
            ):
                bpy.ops.import_scene.gltf(filepath=str(path))
            loaded = list(scene.collection.all_objects)
        else:
            raise ArmError(f"{path}: not an asset; give a .blend, .glb or .gltf file")
    except (OSError, RuntimeError) as error:
        raise ArmError(f"{path}: Blender cannot read this asset ({reason(error)}); generate it again") from error
    for item in [item for item in loaded if item.type in ("CAMERA", "LIGHT", "LIGHT_PROBE")]:
        loaded.remove(item)
        bpy.data.objects.remove(item)
    return loaded


def _render(scene: bpy.types.Scene, picture: Path) -> None:
    with written_by_blender(picture) as partial:
        scene.render.filepath = str(partial)
        bpy.ops.render.render(scene=scene.name, write_still=True)


def _read_pixels(path: Path) -> np.ndarray:
    """(H, W, 4) float32 of a picture as it is stored, bottom row first."""
    image = bpy.data.images.load(str(path), check_existing=False)
    try:
        pixels = np.empty(len(image.pixels), dtype=np.float32)
        image.pixels.foreach_get(pixels)
        return pixels.reshape(image.size[1], image.size[0], 4)
    finally:
        bpy.data.images.remove(image)


def _write_pixels(path: Path, pixels: np.ndarray) -> None:
    """Write (H, W, 4) in [0, 1], bottom row first, as an 8-bit PNG."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new("sheet", width, height, alpha=True)
    try:
        image.pixels.foreach_set(np.ascontiguousarray(pixels, dtype=np.float32).ravel())
        image.filepath_raw = str(path)
        image.file_format = "PNG"
        image.save()
    finally:
        bpy.data.images.remove(image)
