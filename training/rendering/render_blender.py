"""One object, rendered: the task that `python -m training render` hands to its processes, here or on other machines.

Two layouts, one renderer. *Samples* for training: an object's mesh and rigs of views, a part of a tar shard. *Views*
for evaluation: `OUTPUT/<id>/` as a user would bring it, `transforms.json` and PNGs of the Zero123++ v1.2 rig, with the
true mesh beside them.
"""

import tempfile
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import bpy
import numpy as np
import torch
from numpy.typing import NDArray

from arm_blender.commands import interrupts
from arm_blender.errors import ArmError
from arm_blender.graphics.cameras import Camera
from arm_blender.graphics.color import linear_from_srgb
from arm_blender.machine.quiet import STDOUT, silenced
from arm_blender.views.image_io import write_png
from arm_blender.views.rigs import zero123plus_rig
from arm_blender.views.transforms_json import write_transforms

from . import shard_writer
from .asset_filter import unwanted_shape, unwanted_views
from .assets import Asset
from .camera_rigs import paper_rig, varied_rig
from .lighting_blender import add_area_lights, blender_environments, mean_radiance, set_world
from .passes_blender import SCRATCH, RenderConfig, configure_cycles, render_view
from .scene_blender import (
    add_aovs,
    complete_materials,
    has_finish_map,
    import_object,
    loose_points,
    materials,
    normalise,
    principled,
    reduce_to_brdf,
    triangles,
    vary_material,
)
from .shards import Arrays, save_arrays


@dataclass(frozen=True)
class SampleConfig:
    """What is rendered of an object."""

    cameras: Literal["paper", "varied"] = "paper"
    """The paper's two sets, the same under every lighting; or six and four of a rig drawn anew for each."""
    views: int = 32
    """Random views of the paper's second set."""
    lightings: int = 1
    """Rigs an object, each under its own light."""
    distance: float = 6.0
    """Of the Zero123++ rig, world units."""
    area_lights: bool = True
    """Beside the environment."""
    any_material: bool = False
    """Take objects without a roughness or metallic map, and draw their finish."""
    max_triangles: int | None = None
    """Larger objects are left out."""
    seed: int = 0
    """Of everything that is drawn, together with the object's key: not with the order or the process."""


def answer(item: dict[str, Any], words: dict[str, Any]) -> dict[str, Any]:
    """Render one object into a part of a shard, or record why not.

    Args:
        item: an `Asset`, as a dictionary.
        words: "output", a folder; "render" and "sample", the configs; "hdris", files; "own_hdris", whether Blender's
            are drawn from as well.
    Returns:
        "key", and "dropped": the reason or None.
    """
    asset, started = Asset(**item), time.monotonic()
    render, sample = RenderConfig(**words["render"]), SampleConfig(**words["sample"])
    hdris = [Path(path) for path in words["hdris"]] + (blender_environments() if words["own_hdris"] else [])
    blender = bpy.app.version_string  # It decides what a render looks like.
    record: dict[str, Any] = {"key": asset.key, "source": asset.source, "dropped": None, "blender": blender}
    files: dict[str, Arrays] = {}
    rendering = 0.0
    try:
        with silenced(STDOUT):  # Blender prints a line for every view.
            for rig in range(sample.lightings):
                arrays, told, seconds = render_rig(asset, hdris, rig, render, sample)
                files |= arrays
                rendering += seconds
                record.setdefault("lightings", []).append(told)
        record["views"] = len(files["rig_0.npz"]["rgba"])
    except (ArmError, RuntimeError) as error:  # Blender's operators raise RuntimeError.
        record["dropped"], files = str(error), {}
    shard_writer.save_part(
        Path(words["output"]),
        record,
        files,
        {"rendering": round(rendering, 3), "all": round(time.monotonic() - started, 3)},
    )
    return {"key": asset.key, "dropped": record["dropped"]}


def render_rig(
    asset: Asset, hdris: list[Path], rig: int, render: RenderConfig, sample: SampleConfig
) -> tuple[dict[str, Arrays], dict[str, Any], float]:
    """One object under one light: the arrays of its npz, what was drawn, the seconds of rendering.

    Raises:
        ArmError: the object is left out; the message is the reason.
    """
    seed = [sample.seed, zlib.crc32(asset.key.encode())]
    light = np.random.default_rng([*seed, 1, rig])
    # The finish and the paper's views stay, so that lights can be compared; varied rigs vary in everything.
    scene = np.random.default_rng([*seed, 0, rig if sample.cameras == "varied" else 0])
    vertices, faces = prepare_object(asset, scene, sample, check=rig == 0)
    cameras = (
        paper_rig(scene, render.resolution, sample.views, sample.distance)
        if sample.cameras == "paper"
        else varied_rig(scene, render.resolution)
    )
    hdri = hdris[int(light.integers(len(hdris)))]
    told = {"hdri": hdri.name, **illuminate(hdri, light)}
    configure_cycles(render)
    told["area_lights"] = add_area_lights(light) if sample.area_lights else []
    started = time.monotonic()
    views = render_views(cameras, interrupts.check)
    seconds = time.monotonic() - started
    arrays = {key: np.stack([view[key] for view in views]) for key in views[0]}
    if unwanted := unwanted_views(arrays["rgba"][..., 3]):
        raise ArmError(unwanted)
    arrays["c2w"] = torch.stack([camera.c2w for camera in cameras]).numpy()
    arrays["K"] = torch.stack([camera.K for camera in cameras]).numpy()
    mesh = {} if rig else {"mesh.npz": {"vertices": vertices, "faces": faces.astype(np.int32)}}
    return mesh | {f"rig_{rig}.npz": arrays}, told, seconds


def prepare_object(
    asset: Asset, rng: np.random.Generator, sample: SampleConfig, check: bool
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Import and normalise one object, with its finish and its AOVs: vertices (N, 3) float32 world, faces (F, 3) int64.

    Args:
        rng: of the finish, for an object that has none.
        check: leave out what the paper's selection leaves out.
    Raises:
        ArmError: it is left out; the message is the reason.
    """
    objects = import_object(Path(asset.path), asset.up)
    loose = loose_points(objects)
    if loose and not any(len(ob.data.polygons) for ob in objects):
        raise ArmError(f"a point cloud: {loose} points and no face")
    normalise(objects)
    vertices, faces = triangles(objects)
    if check and (unwanted := unwanted_shape(vertices, faces, loose, sample.max_triangles)):
        raise ArmError(unwanted)
    complete_materials(objects)
    used = materials(objects)
    unknown = [material.name for material in used if principled(material) is None]
    if check and unknown:
        raise ArmError(f"the albedo of material {unknown[0]} is not known: it has no Principled BSDF")
    measured = any(map(has_finish_map, used)) if asset.own_finish is None else asset.own_finish
    if not measured and not sample.any_material:
        raise ArmError("no roughness or metallic map")
    for material in used:
        reduce_to_brdf(material)
        if not measured:
            vary_material(material, rng)
    add_aovs()
    return vertices, faces


def illuminate(hdri: Path, rng: np.random.Generator) -> dict[str, float]:
    """Light the scene by an environment map, turned and exposed at random; what was drawn."""
    rotation_deg, exposure = rng.uniform(0.0, 360.0), rng.uniform(0.6, 1.4)
    set_world(hdri, rotation_deg, exposure / max(mean_radiance(hdri), 1e-3))
    return {"rotation_deg": rotation_deg, "exposure": exposure}


def render_views(cameras: Sequence[Camera], check: Callable[[], None] = lambda: None) -> list[Arrays]:
    """The scene from every camera; `check` is called before each and may raise."""
    views = []
    with tempfile.TemporaryDirectory(dir=SCRATCH) as scratch:
        for camera in cameras:
            check()
            views.append(render_view(camera, Path(scratch)))
    return views


def render_evaluation_views(asset: Asset, hdri: Path, output: Path, distance: float, config: RenderConfig) -> None:
    """The six true views of an evaluation object in the Zero123++ v1.2 rig, as a user's folder.

    Raises:
        ArmError: it cannot be imported.
    """
    rng = np.random.default_rng(zlib.crc32(asset.key.encode()))
    vertices, faces = prepare_object(replace(asset, own_finish=True), rng, SampleConfig(), check=False)
    illuminate(hdri, rng)
    configure_cycles(config)
    cameras = zero123plus_rig(distance=distance, size=config.resolution)
    views = render_views(cameras)
    save_arrays(output / asset.key / "mesh.npz", {"vertices": vertices, "faces": faces.astype(np.int32)})
    write_views(output / asset.key, views, cameras)


def write_views(folder: Path, views: Sequence[Arrays], cameras: Sequence[Camera]) -> None:
    """Pictures with their cameras, as a user would bring them; `transforms.json` comes last."""
    folder.mkdir(parents=True, exist_ok=True)
    names = [f"{index:03d}.png" for index in range(len(views))]
    for name, view in zip(names, views, strict=True):
        rgba = torch.from_numpy(view["rgba"]).permute(2, 0, 1) / 255.0
        write_png(folder / name, torch.cat([linear_from_srgb(rgba[:3]), rgba[3:]]), srgb=True)
    write_transforms(folder / "transforms.json", names, tuple(cameras))
