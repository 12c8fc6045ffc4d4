"""`python -m training render`: objects to posed views with depth, normal, albedo, roughness and metallic, by Cycles.

Two layouts, one renderer. *Samples* for training: `OUTPUT/<id>/mesh.npz` and `OUTPUT/<id>/rig_<k>.npz`, six input views
of a random rig and four more (the paper's N = 10). *Views* for evaluation: `OUTPUT/<id>/` as a user would bring it,
`transforms.json` and PNGs of the Zero123++ v1.2 rig, with the true mesh beside them.
"""

import argparse
import logging
import math
import os
import tempfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
import OpenImageIO as oiio
import torch

from arm_blender.blender.compat import use_cycles, use_exr
from arm_blender.blender.studio import add_view_camera, aim_view_camera
from arm_blender.errors import ArmError
from arm_blender.graphics.cameras import Camera, orbit_camera
from arm_blender.graphics.color import bytes_from_unit, linear_from_srgb, srgb_from_linear
from arm_blender.views.image_io import write_png
from arm_blender.views.rigs import zero123plus_rig
from arm_blender.views.transforms_json import write_transforms

from .manifest import read_manifest
from .scene_blender import (
    add_aovs,
    blender_environments,
    import_object,
    make_opaque,
    mean_radiance,
    normalise,
    set_world,
    triangles,
    vary_material,
)
from .shards import save_arrays

logger = logging.getLogger(__name__)

INPUT_VIEWS, EXTRA_VIEWS = 6, 4

SCRATCH = "/dev/shm" if os.path.isdir("/dev/shm") else None
"""Where Blender leaves its EXRs for a moment: in memory where the system has such a place."""


@dataclass(frozen=True)
class RenderConfig:
    """How one view is rendered."""

    resolution: int = 192
    """Pixels a side."""
    samples: int = 16
    """Cycles samples a pixel. Fewer leave noise that the texture inherits."""
    denoise: bool = True
    """OpenImageDenoise where this Blender has it."""


def configure_cycles(config: RenderConfig) -> None:
    """Set up the scene for one-pass rendering into a multilayer EXR, with a camera."""
    scene = bpy.context.scene
    render = scene.render
    use_cycles(scene, config.samples, config.denoise)
    render.film_transparent = True
    render.use_persistent_data = True
    render.use_compositing = render.use_sequencer = False
    render.dither_intensity = 0.0
    scene.view_settings.view_transform = "Standard"
    cycles = scene.cycles
    cycles.max_bounces, cycles.use_auto_tile = 4, False
    cycles.pixel_filter_type = "BOX"
    if cycles.use_denoising:
        cycles.denoising_prefilter, cycles.denoising_quality = "FAST", "FAST"
    use_exr(scene, layers=True)
    add_view_camera(scene, orbit_camera(0.0, 0.0, 1.0, 30.0, config.resolution, config.resolution))


def read_layers(path: Path) -> dict[str, np.ndarray]:
    """Channels of a multilayer EXR by `Layer.Channel`; Blender 5.0 and later write one part a pass."""
    file = oiio.ImageInput.open(str(path))
    if file is None:
        raise ArmError(f"{path}: cannot be read; was the disk full?")
    layers, part = {}, 0
    while file.seek_subimage(part, 0):
        spec = file.spec()
        pixels = file.read_image(part, 0, 0, spec.nchannels, "float")
        for index, channel in enumerate(spec.channelnames):
            layers[".".join(channel.split(".")[-2:])] = pixels[..., index]
        part += 1
    file.close()
    return layers


def channels(layers: dict[str, np.ndarray], name: str, suffixes: str) -> np.ndarray:
    """(H, W, C) of one pass, whichever of the equivalent suffixes this version of Blender wrote."""
    planes = [layers[f"{name}.{s}"] for s in suffixes if f"{name}.{s}" in layers]
    return np.stack(planes, axis=-1)


def byte_image(values: np.ndarray, srgb: bool) -> np.ndarray:
    """uint8 of [0, 1]; linear colours encoded to sRGB on the way where `srgb`."""
    image = torch.from_numpy(np.ascontiguousarray(values))
    return bytes_from_unit(srgb_from_linear(image) if srgb else image).numpy()


def render_view(camera: Camera, scratch: Path) -> dict[str, np.ndarray]:
    """One view: rgba (H, W, 4) uint8 sRGB straight, albedo uint8 sRGB, roughness, metallic uint8, depth, normal."""
    aim_view_camera(bpy.context.scene, camera)
    bpy.context.scene.render.filepath = str(scratch / "view.exr")
    bpy.ops.render.render(write_still=True)
    layers = read_layers(scratch / "view.exr")
    premultiplied, alpha = channels(layers, "Combined", "RGB"), layers["Combined.A"].clip(0.0, 1.0)
    coverage = np.maximum(alpha, 1e-4)[..., None]
    depth = channels(layers, "Depth", "ZV")[..., 0]
    return {
        "rgba": np.dstack([byte_image(premultiplied / coverage, srgb=True), byte_image(alpha, srgb=False)]),
        "albedo": byte_image(channels(layers, "arm_albedo", "RGB") / coverage, srgb=True),
        # A scalar AOV is named X or V by version; both hold the premultiplied value.
        "roughness": byte_image(channels(layers, "arm_roughness", "XV")[..., 0] / coverage[..., 0], srgb=False),
        "metallic": byte_image(channels(layers, "arm_metallic", "XV")[..., 0] / coverage[..., 0], srgb=False),
        "depth": np.where(depth > 1e4, np.inf, depth).astype(np.float16),
        "normal": (np.clip(channels(layers, "Normal", "XYZ"), -1.0, 1.0) * 127.0).astype(np.int8),
    }


def random_rig(rng: np.random.Generator, size: int) -> tuple[Camera, ...]:
    """Six input views, of a turned Zero123++ rig or of a free rig, and four more from anywhere.

    Fields of view go from 18° to 55° and distances from 2.6 to 9, as users bring them. A ball of radius 1.14 to 1.79
    around the origin fills the frame, so that a mask cuts off no more than the corners of a full box.
    """
    # Objects are photographed and modelled along their axes: half of the rigs stand as users' do.
    turn = 90.0 * rng.integers(4) if rng.random() < 0.5 else rng.uniform(0.0, 360.0)

    def framed(azimuth_deg: float, elevation_deg: float, fovy_deg: float, fill: float) -> Camera:
        distance = float(np.clip(1.25 / (fill * math.sin(math.radians(fovy_deg) / 2.0)), 1.8, 9.0))
        return orbit_camera(azimuth_deg, elevation_deg, distance, fovy_deg, size, size)

    if rng.random() < 0.6:
        fill = rng.uniform(0.7, 1.1)
        views = [framed(turn + 30.0 + 60.0 * i, (20.0, -10.0)[i % 2], 30.0, fill) for i in range(INPUT_VIEWS)]
    else:
        fovy_deg = rng.uniform(18.0, 55.0)
        views = [
            framed(
                turn + 60.0 * i + rng.uniform(-25.0, 25.0),
                rng.uniform(-25.0, 55.0),
                fovy_deg,
                rng.uniform(0.7, 1.05),
            )
            for i in range(INPUT_VIEWS)
        ]
    views += [
        framed(rng.uniform(0.0, 360.0), math.degrees(math.asin(rng.uniform(-0.6, 0.95))), rng.uniform(25.0, 50.0), 0.95)
        for _ in range(EXTRA_VIEWS)
    ]
    return tuple(views)


def prepare_scene(
    path: Path, has_materials: bool, hdri: Path, rng: np.random.Generator, config: RenderConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Import, normalise and light one object: vertices (N, 3) float32 world, faces (F, 3) int64."""
    radiance = mean_radiance(hdri)
    objects = import_object(path)
    normalise(objects)
    vertices, faces = triangles(objects)
    for material in bpy.data.materials:
        make_opaque(material)
        if not has_materials:
            vary_material(material, rng)
    configure_cycles(config)
    add_aovs()
    set_world(hdri, rng.uniform(0.0, 360.0), rng.uniform(0.6, 1.4) / max(radiance, 1e-3))
    return vertices, faces


def render_sample(entry: dict, data: Path, hdri: Path, output: Path, rig: int, config: RenderConfig) -> None:
    """One training sample of one object: a random rig, light and finish, all drawn from the object's own seed."""
    rng = np.random.default_rng(zlib.crc32(f"{entry['id']}/{rig}".encode()))
    vertices, faces = prepare_scene(data / entry["main"], entry["set"] == "pbr", hdri, rng, config)
    cameras = random_rig(rng, config.resolution)
    with tempfile.TemporaryDirectory(dir=SCRATCH) as scratch:
        views = [render_view(camera, Path(scratch)) for camera in cameras]
    folder = output / entry["id"]
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "mesh.npz").exists():
        save_arrays(folder / "mesh.npz", {"vertices": vertices, "faces": faces.astype(np.int32)})
    arrays = {key: np.stack([view[key] for view in views]) for key in views[0]}
    arrays["c2w"] = torch.stack([camera.c2w for camera in cameras]).numpy()
    arrays["K"] = torch.stack([camera.K for camera in cameras]).numpy()
    save_arrays(folder / f"rig_{rig}.npz", arrays)


def render_views(entry: dict, data: Path, hdri: Path, output: Path, distance: float, config: RenderConfig) -> None:
    """The six true views of an evaluation object in the Zero123++ v1.2 rig, as a user's folder."""
    rng = np.random.default_rng(zlib.crc32(entry["id"].encode()))
    vertices, faces = prepare_scene(data / entry["main"], True, hdri, rng, config)
    cameras = zero123plus_rig(distance=distance, size=config.resolution)
    names = [f"{index:03d}.png" for index in range(len(cameras))]
    folder = output / entry["id"]
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=SCRATCH) as scratch:
        for name, camera in zip(names, cameras, strict=True):
            rgba = torch.from_numpy(render_view(camera, Path(scratch))["rgba"]).permute(2, 0, 1) / 255.0
            write_png(folder / name, torch.cat([linear_from_srgb(rgba[:3]), rgba[3:]]), srgb=True)
    save_arrays(folder / "mesh.npz", {"vertices": vertices, "faces": faces.astype(np.int32)})
    write_transforms(folder / "transforms.json", names, cameras)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--data", type=Path, help="folder with manifest.json; ARM_DATA by default")
    parser.add_argument("--output", type=Path, required=True, help="folder of samples or views")
    parser.add_argument("--split", choices=("train", "eval"), default="train")
    parser.add_argument("--set", nargs="*", default=("pbr", "gso", "flat"), help="sets of the manifest")
    parser.add_argument("--ids", nargs="*", help="only these objects")
    parser.add_argument("--layout", choices=("samples", "views"), default="samples")
    parser.add_argument("--rigs", type=int, default=1, help="samples an object")
    parser.add_argument("--first-rig", type=int, default=0)
    parser.add_argument("--distance", type=float, default=6.0, help="of the evaluation rig")
    parser.add_argument("--resolution", type=int, default=192)
    parser.add_argument("--samples", type=int, default=16)
    parser.add_argument("--max-triangles", type=int, default=120_000, help="larger objects are left out")


def run(args: argparse.Namespace) -> int:
    """Render every chosen object; what is whole already is skipped, what fails is named and skipped."""
    manifest = read_manifest(args.data)
    # Objects of evaluation are lit by evaluation HDRIs, and training never sees one of those.
    hdris = [args.data / h["files"][0] for h in manifest["hdris"] if h["split"] == args.split]
    if args.split == "train":
        hdris += blender_environments()
    entries = [
        e
        for e in manifest["objects"]
        if e["split"] == args.split
        and e["set"] in args.set
        and (not args.ids or e["id"] in args.ids)
        and (e.get("n_triangles") or 0) <= args.max_triangles
    ]
    if not entries or not hdris:
        what = "object" if not entries else "environment map"
        raise ArmError(f"{args.data}: no {what} to render; check --split, --set, --ids and --max-triangles")
    entries.sort(key=lambda e: zlib.crc32(e["id"].encode()))  # A fixed mixture, so that any prefix is a fair sample.
    config = RenderConfig(resolution=args.resolution, samples=args.samples)
    attempted = failed = 0
    for rig in range(args.first_rig, args.first_rig + args.rigs):
        for index, entry in enumerate(entries):
            whole = args.output / entry["id"] / (f"rig_{rig}.npz" if args.layout == "samples" else "transforms.json")
            if whole.exists():
                continue
            attempted += 1
            hdri = hdris[zlib.crc32(f"{entry['id']}:{rig}".encode()) % len(hdris)]
            try:
                if args.layout == "samples":
                    render_sample(entry, args.data, hdri, args.output, rig, config)
                else:
                    render_views(entry, args.data, hdri, args.output, args.distance, config)
            except (ArmError, RuntimeError) as error:  # Blender's operators raise RuntimeError on a broken file.
                failed += 1
                logger.warning("%s: left out: %s", entry["id"], error)
            logger.info("rig %d: %d of %d, %s", rig, index + 1, len(entries), entry["id"])
    return 1 if attempted and failed == attempted else 0
