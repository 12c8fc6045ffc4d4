"""Render an asset under environment maps: stills, turntables, environments that turn, two of them side by side."""

import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import bpy

from ...errors import ArmError
from ...machine.files import distinct
from ...progress import Progress, part, silent
from ..asset.asset_file import linked_asset
from ..asset.blend_file import written_by_blender
from ..asset.studio import add_camera, bounding_sphere, light_by_environment, temporary_scene, turn_environment
from ..compat import use_cycles, use_eevee, use_neutral_view, use_png
from ..console import without_chatter
from .environments import environment_path
from .graphics_device import check_eevee
from .pictures import write_sheet

Engine = Literal["cycles", "eevee"]
Turning = Literal["object", "environment"]

PREVIEW_ENVIRONMENTS = ("studio", "sunset")
PREVIEW_TURNS = 2


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
    """Pictures in one full turn."""
    turning: Turning = "object"
    """What turns: the object under a light that stands still, or the environment around an object that does."""
    rotation_deg: float = 0.0
    """Of the environment at the start, counter-clockwise seen from above."""
    azimuth_deg: float = 30.0
    """Of the camera; 0 is Blender's front."""
    elevation_deg: float = 15.0
    """Of the camera, above the horizon."""

    def __post_init__(self) -> None:
        if self.engine not in ("cycles", "eevee"):
            raise ValueError(f"engine must be 'cycles' or 'eevee', got {self.engine!r}")
        if self.turning not in ("object", "environment"):
            raise ValueError(f"turning must be 'object' or 'environment', got {self.turning!r}")
        if min(self.resolution, self.samples, self.turntable) < 1:
            raise ValueError(f"resolution, samples and turntable must be at least 1, got {self}")
        if not all(map(math.isfinite, (self.rotation_deg, self.azimuth_deg, self.elevation_deg))):
            raise ValueError(f"angles must be finite, got {self}")


@dataclass(frozen=True)
class Frame:
    """One picture to come.

    Attributes:
        name: of its file, without the asset's.
        environments: one, or several to be shown side by side.
        turn: its place in the full turn, from 0.
    """

    name: str
    environments: tuple[Path, ...]
    turn: int


def frames(environments: Sequence[Path | str], config: RelightConfig, compare: bool = False) -> list[Frame]:
    """The pictures of a full turn, under each environment after the other, or under all of them side by side.

    Args:
        environments: files, or names of the maps that Blender ships ("forest", "studio", ...). Two files of one name
            are told apart by a number.
        compare: put the environments of each turn into one picture.
    Raises:
        InputImageError: an environment is not there.
    """
    paths = [environment_path(environment) for environment in environments]
    labels = distinct(path.stem for path in paths)
    single = [(label, (path,)) for label, path in zip(labels, paths, strict=True)]
    groups = [("_".join(labels), tuple(paths))] if compare else single
    return [Frame(f"{label}_{turn:03d}.png", held, turn) for label, held in groups for turn in range(config.turntable)]


def relight(
    source: bpy.types.Object | Path | str,
    environments: Sequence[Path | str],
    output: Path | str,
    config: RelightConfig = RelightConfig(),
    progress: Progress = silent,
    compare: bool = False,
) -> list[Path]:
    """Render an asset under each environment map, on a transparent background; side by side, on a grey one.

    The open file keeps its scenes, selection and datablocks.

    Args:
        source: a mesh object of the open file, or a file of an asset.
        environments, compare: as of `frames`.
        output: the folder for the pictures; made where it is missing.
        config: engine, size, quality, camera, and what turns.
        progress: told before each picture.
    Returns:
        `<asset>_<environment>_<turn>.png` for every environment and turn, in that order.
    Raises:
        ArmError: the asset cannot be read, or Eevee cannot run here.
        InputImageError: an environment map cannot be read.
        OutputError: a picture cannot be written.
    """
    return render_frames(source, frames(environments, config, compare), output, config, progress)


@without_chatter()
def render_frames(
    source: bpy.types.Object | Path | str,
    wanted: Sequence[Frame],
    output: Path | str,
    config: RelightConfig,
    progress: Progress = silent,
) -> list[Path]:
    """Some of the pictures of `relight`, which see."""
    if config.engine == "eevee":
        check_eevee()
    name = source.name if isinstance(source, bpy.types.Object) else Path(source).stem
    pictures = []
    worlds: dict[Path, bpy.types.World] = {}
    with temporary_scene("Relight") as scene, tempfile.TemporaryDirectory(prefix="arm-relight-") as folder:
        pivot = _show(scene, source, config)
        for number, frame in enumerate(wanted):
            said = part(progress, number / len(wanted), (number + 1) / len(wanted))
            degrees = 360.0 * frame.turn / config.turntable
            pivot.rotation_euler[2] = math.radians(degrees) if config.turning == "object" else 0.0
            renders = []
            for index, path in enumerate(frame.environments):
                said(index / len(frame.environments), f"Rendering {name} under {path.stem}")
                if path not in worlds:
                    worlds[path] = light_by_environment(scene, path)
                scene.world = worlds[path]
                turn_environment(
                    scene.world, config.rotation_deg + (degrees if config.turning == "environment" else 0.0)
                )
                renders.append(Path(folder) / f"{index}.png")
                render_scene(scene, renders[-1])
            pictures.append(Path(output) / f"{name}_{frame.name}")
            with written_by_blender(pictures[-1]) as partial:
                if len(renders) == 1:
                    partial.write_bytes(renders[0].read_bytes())
                else:
                    write_sheet(partial, [[render] for render in renders])
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
        source: a mesh object of the open file, or a file of an asset.
        picture: the PNG; (2 * resolution) pixels high.
        environments: files, or names of the maps that Blender ships.
        resolution: pixels a side of one render.
        samples: paths a pixel.
    Raises:
        ArmError: as `relight`.
    """
    config = RelightConfig(resolution=resolution, samples=samples, turntable=PREVIEW_TURNS)
    with tempfile.TemporaryDirectory() as folder:
        renders = relight(source, environments, folder, config)
        columns = [renders[i : i + PREVIEW_TURNS] for i in range(0, len(renders), PREVIEW_TURNS)]
        with written_by_blender(Path(picture)) as partial:
            write_sheet(partial, columns)


def _show(scene: bpy.types.Scene, source: bpy.types.Object | Path | str, config: RelightConfig) -> bpy.types.Object:
    """Put the asset into `scene` with a camera; returns the empty that turns it about the vertical."""
    shown = linked_asset(scene, source)
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
    render_alone(scene, config)
    use_neutral_view(scene)
    use_png(scene)
    render = scene.render
    render.resolution_x = render.resolution_y = config.resolution
    render.use_persistent_data = True
    return pivot


def render_alone(scene: bpy.types.Scene, config: RelightConfig) -> None:
    """By the engine that is asked for, the object before nothing, and as it comes out."""
    (use_cycles if config.engine == "cycles" else use_eevee)(scene, config.samples)
    scene.render.film_transparent = True
    scene.render.use_compositing = scene.render.use_sequencer = False


def render_scene(scene: bpy.types.Scene, picture: Path) -> None:
    """Writes what the scene's camera sees, as its settings say."""
    with written_by_blender(picture) as partial:
        scene.render.filepath = str(partial)
        bpy.ops.render.render(scene=scene.name, write_still=True)
