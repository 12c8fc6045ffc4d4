"""`python -m training rasterized`: lit views that are rasterised on the fly beside Cycles' renders of the same scene.

Mesh, material, camera and light are the same: the finish is baked into an atlas for Blender, the environment is the map
that the rasteriser reads, suns are lamps. What differs is how light travels, and noise.
"""

import argparse
import logging
import math
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import torch
from torch import Tensor
from torch.nn import functional

from arm_blender.blender.asset.scene import build_object
from arm_blender.blender.asset.studio import add_view_camera, light_by_environment, temporary_scene
from arm_blender.blender.compat import use_cycles, use_exr
from arm_blender.commands.progress_line import Counted
from arm_blender.errors import ArmError
from arm_blender.graphics.cameras import Camera
from arm_blender.graphics.color import LUMINANCE, linear_from_srgb, srgb_from_linear
from arm_blender.graphics.meshes import face_normals
from arm_blender.graphics.raster.rasterize import rasterize_uv
from arm_blender.structures import MaterialMaps, RelightableAsset, TriangleMesh, UvMesh
from arm_blender.uv.maps import pad
from arm_blender.uv.texels import texel_map

from ..datasets import atlases
from ..documents import markdown_table, paragraphs, write_text
from ..evaluation.scores.image_scores import psnr_inside
from ..evaluation.tables.contact_sheet import tiled
from ..rasterized import pictures as rasterized
from ..rasterized.lights import Sun, lighting, random_sky
from ..rasterized.materials import Finish, random_finish
from ..rasterized.surface import CutConfig, Surface, surface_of
from ..rendering import shards
from ..rendering.camera_rigs import random_views
from .parametric import ball, parametric, ring, vase
from .shading_blender import read_linear, write_linear

logger = logging.getLogger(__name__)

TEXTURE = 1024
"""Texels a side of the baked finish."""


@dataclass(frozen=True)
class Scene:
    """One object under one light.

    Attributes:
        mesh: with an atlas. surface: the same, for the rasteriser. finish: of both.
        radiance: (3, H, W). suns: beside it.
    """

    mesh: UvMesh
    surface: Surface
    finish: Finish
    radiance: Tensor
    suns: tuple[Sun, ...]


def baked(scene: Scene) -> MaterialMaps:
    """The finish on the atlas."""
    texels = texel_map(scene.mesh, TEXTURE)
    face = rasterize_uv(scene.mesh.uvs, scene.mesh.face_uvs, TEXTURE).face_id[texels.mask]
    nearest = torch.cdist(scene.mesh.vertices, scene.surface.vertices).argmin(dim=1)
    part = scene.surface.part[nearest][scene.mesh.faces[:, 0]]
    normals = face_normals(scene.mesh.vertices, scene.mesh.faces)
    values, _ = scene.finish(texels.position[:, texels.mask].T, normals[face], part[face])
    image = torch.zeros(5, TEXTURE, TEXTURE)
    image[:, texels.mask] = values.T
    image = pad(image, texels.mask)
    return MaterialMaps(image[:3], image[:3], image[3:4], image[4:])


def by_cycles(scene: Scene, cameras: tuple[Camera, ...], samples: int, folder: Path) -> Tensor:
    """(V, 4, H, W) linear with straight alpha."""
    pictures = []
    with temporary_scene("rasterized") as place:
        placed = build_object(RelightableAsset("object", scene.mesh, baked(scene)), {}, place)
        placed.data.set_sharp_from_angle(angle=math.radians(CutConfig.sharp_deg))
        write_linear(folder / "sky.exr", scene.radiance)
        light_by_environment(place, folder / "sky.exr")
        for sun in scene.suns:
            lamp = bpy.data.lights.new("sun", "SUN")
            strongest = float(sun.power.max())
            lamp.energy, lamp.color, lamp.angle = strongest, tuple((sun.power / strongest).tolist()), 2.0 * sun.radius
            hung = bpy.data.objects.new("sun", lamp)
            hung.rotation_mode = "QUATERNION"
            hung.rotation_quaternion = rotation_to(sun.direction)
            place.collection.objects.link(hung)
        use_cycles(place, samples, denoise=True)
        place.cycles.max_bounces, place.cycles.pixel_filter_type = 4, "BOX"
        place.render.film_transparent = True
        place.render.use_compositing = place.render.use_sequencer = False
        place.render.threads_mode, place.render.threads = "FIXED", torch.get_num_threads()
        place.view_settings.view_transform = "Standard"
        use_exr(place)
        for camera in cameras:
            add_view_camera(place, camera)
            place.render.filepath = str(folder / "view.exr")
            bpy.ops.render.render(scene=place.name, write_still=True)
            image = read_linear(folder / "view.exr")
            pictures.append(torch.cat([image[:3] / image[3:].clamp(min=1e-4), image[3:]]))
    return torch.stack(pictures)


def rotation_to(direction: Tensor) -> tuple[float, float, float, float]:
    """The rotation, as w, x, y, z, that turns +Z, where a sun lamp shines from, to a unit vector (3,)."""
    x, y, z = direction.tolist()
    if z < -0.99999:
        return 0.0, 1.0, 0.0, 0.0
    w = math.sqrt(0.5 * (1.0 + z))
    return w, -y / (2.0 * w), x / (2.0 * w), 0.0


def ours(scene: Scene, cameras: tuple[Camera, ...], shadows: bool = True) -> Tensor:
    """(V, 4, H, W) linear with straight alpha; without shadows nothing hides any light."""
    surface, suns = scene.surface, scene.suns
    if not shadows:
        surface = replace(surface, visible=torch.ones_like(surface.visible))
        suns = ()
    rgba = torch.from_numpy(rasterized.rig_of(surface, cameras, scene.finish, lighting(scene.radiance, suns))["rgba"])
    rgba = rgba.permute(0, 3, 1, 2) / 255.0
    return torch.cat([linear_from_srgb(rgba[:, :3]), rgba[:, 3:]], dim=1)


def brightness(found: Tensor, truth: Tensor, inside: Tensor) -> float:
    """Mean luminance over that of the truth; both clipped at 1, as pictures are."""
    weights = truth.new_tensor(LUMINANCE)
    return float((weights @ found[:3, inside].clamp(0, 1)).mean() / (weights @ truth[:3, inside].clamp(0, 1)).mean())


def shapes(folder: Path | None, count: int, generator: torch.Generator) -> Iterator[tuple[str, UvMesh]]:
    """Random objects of a folder of shards, with an atlas; without a folder surfaces that any machine can make."""
    if folder is None:
        for name, point in list({"ring": ring, "vase": vase, "ball": ball}.items())[:count]:
            yield name, parametric(point, 128, 64)
        return
    meshes = shards.meshes(folder)
    for index in torch.randperm(len(meshes), generator=generator).tolist():
        mesh = atlases.unwrapped(meshes[index], atlases.AtlasConfig(size=TEXTURE)) if count else None
        if mesh is not None:
            count -= 1
            yield meshes[index].parent.name, mesh


def scene_of(mesh: UvMesh, library: rasterized.Library, generator: torch.Generator) -> Scene:
    """A mesh under a random finish and light."""
    surface = surface_of(TriangleMesh(mesh.vertices, mesh.faces))
    finish = random_finish(library.textures, generator)
    return Scene(mesh, surface, finish, *random_sky(library.environments, generator))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--shards", type=Path, help="folder of objects with mesh.npz; without it, shapes are made")
    parser.add_argument(
        "--data", type=Path, help="textures and environments; ARM_DATA by default, else made ones alone"
    )
    parser.add_argument("--objects", type=int, default=10, help="each is seen twice")
    parser.add_argument("--resolution", type=int, default=160, help="pixels a side")
    parser.add_argument("--samples", type=int, default=64, help="of Cycles, a pixel")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path, default=Path("out/rasterized"))


def run(args: argparse.Namespace) -> int:
    """Render, compare, and write the table and the picture."""
    library = rasterized.read_library(args.data)
    rows: list[tuple[str, list[float]]] = []
    pictures: list[tuple[str, Tensor]] = []
    generator = torch.Generator().manual_seed(args.seed)
    count = Counted(args.objects, logger.info)
    for number, (name, mesh) in enumerate(shapes(args.shards, args.objects, generator)):
        scene = scene_of(mesh, library, generator)
        cameras = random_views(args.resolution, torch.Generator().manual_seed(args.seed + number))[4:6]
        with tempfile.TemporaryDirectory() as folder:
            truth = by_cycles(scene, cameras, args.samples, Path(folder))
        found, bare = ours(scene, cameras), ours(scene, cameras, shadows=False)
        for view in range(len(cameras)):
            row, shown = compared(truth[view], found[view], bare[view])
            rows.append((f"{name}, {view}", row))
            captions = (f"Cycles {name}"[:26], f"ours {row[0]:.1f} dB", "4 x difference")
            pictures += zip(captions, shown, strict=True)
        count(name)
    if not rows:
        raise ArmError(f"{args.shards}: no object could be unwrapped; render more with `python -m training render`")
    means = [sum(numbers) / len(rows) for numbers in zip(*(row for _, row in rows), strict=True)]
    header = ["object, view", "ours, dB", "ours without shadows, dB", "brightness, ours over Cycles"]
    text = paragraphs(
        "# Rasterised views against Cycles",
        markdown_table(header, [[title, *row] for title, row in [*rows, ("**mean**", means)]]),
        f"Made by `{args.command}`.",
    )
    write_text(args.output / "comparison.md", text)
    rows_of_six = [pictures[i : i + 6] for i in range(0, len(pictures), 6)]
    tiled(rows_of_six, 6, args.resolution).save(args.output / "comparison.png")
    print(text)
    return 0


def compared(truth: Tensor, found: Tensor, bare: Tensor) -> tuple[list[float], list[Tensor]]:
    """Numbers of a view (4, H, W): dB of ours, dB without shadows, brightness; pictures of Cycles, ours, difference.

    Along the outline the filters differ; what is compared lies a pixel inside of it.
    """
    alpha = torch.minimum(truth[3], found[3])
    inside = -functional.max_pool2d(-alpha[None, None], 3, stride=1, padding=1)[0, 0] > 0.999
    numbers = [psnr_inside(found, truth, inside), psnr_inside(bare, truth, inside), brightness(found, truth, inside)]
    shown = [srgb_from_linear(x[:3]) * x[3:] + 1.0 - x[3:] for x in (truth, found)]
    return numbers, [*shown, 4.0 * (shown[0] - shown[1]).abs()]
