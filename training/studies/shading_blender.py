"""`python -m training shading`: our direct light against Cycles', on surfaces that any machine can make.

Cycles renders the assets as Blender shows them (Principled BSDF, GGX) under one small environment map, without bounces;
our shading sums the same map texel by texel. What differs is noise, filters, and the form of the BRDF.
"""

import argparse
import logging
import math
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import bpy
import OpenImageIO as oiio
import torch
from torch import Tensor
from torch.nn import functional as F

from arm_blender.blender.asset.scene import build_object
from arm_blender.blender.asset.studio import add_view_camera, light_by_environment, temporary_scene
from arm_blender.blender.compat import use_cycles, use_exr
from arm_blender.blender.relight.environments import environment_path
from arm_blender.commands.progress_line import Counted
from arm_blender.graphics.cameras import Camera, look_at, orbit_camera, project, view_directions
from arm_blender.graphics.color import srgb_from_linear
from arm_blender.graphics.light.brdf import Form
from arm_blender.graphics.light.environment import Environment, Lights, shade
from arm_blender.graphics.meshes import vertex_normals
from arm_blender.graphics.raster.rasterize import Fragments, interpolate, rasterize
from arm_blender.structures import MaterialMaps, RelightableAsset, UvMesh
from arm_blender.views.image_io import write_png

from ..documents import markdown_table, paragraphs, write_text
from ..evaluation.scores.image_scores import psnr_inside
from . import furnace
from .parametric import ball, parametric, ring, vase

logger = logging.getLogger(__name__)

SKY = (24, 48)
"""Texels of the environment map: so few that each can cast its own shadow."""
FINER = 2
"""Our sum takes so many texels for each of the map's along a side: a glossy lobe is smaller than one of those."""
OVERSAMPLING = 2
"""Of our picture along a side, for Cycles averages over a pixel."""
SHADOW_DISTANCE, SHADOW_SIZE, SHADOW_BIAS = 60.0, 384, 0.012


@dataclass(frozen=True)
class Subject:
    """A surface with maps that vary over it.

    Attributes:
        name: in tables. mesh: within the unit ball. shadows: whether it can hide light from itself.
    """

    name: str
    mesh: UvMesh
    shadows: bool


def subjects() -> Iterator[Subject]:
    yield Subject("ball", parametric(ball, 192, 96), shadows=False)
    yield Subject("ring", parametric(ring, 192, 96), shadows=True)
    yield Subject("vase", parametric(vase, 192, 192), shadows=True)


def maps(size: int = 256) -> MaterialMaps:
    """Colours, roughness from 0.35 to 0.95, and bands of metal, all smooth."""
    axis = (torch.arange(size) + 0.5) / size * 2.0 * math.pi
    v, u = torch.meshgrid(-axis, axis, indexing="ij")
    albedo = torch.stack([0.5 + 0.4 * (2.0 * u).sin(), 0.45 + 0.35 * (3.0 * v).cos(), 0.5 + 0.3 * (u + 2.0 * v).sin()])
    roughness = 0.65 + 0.3 * (u + v).cos()
    metallic = (0.5 + 1.5 * (2.0 * v + u).sin()).clamp(0.0, 1.0)
    return MaterialMaps(albedo, albedo, roughness[None], metallic[None])


def read_linear(path: Path) -> Tensor:
    """(C, H, W) of an EXR or HDR file as it is stored: above 1 and premultiplied, as light is."""
    return torch.from_numpy(oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)).permute(2, 0, 1)


def write_linear(path: Path, image: Tensor) -> None:
    """A float EXR of (3, H, W)."""
    pixels = oiio.ImageBuf(oiio.ImageSpec(image.shape[2], image.shape[1], 3, oiio.FLOAT))
    pixels.set_pixels(pixels.roi, image.permute(1, 2, 0).contiguous().numpy())
    pixels.write(str(path))


def small_sky(path: Path) -> Tensor:
    """(3, H, W) radiance of an environment map at `SKY` texels, at a mean of 0.6."""
    radiance = F.interpolate(read_linear(path)[None, :3].clamp(min=0.0), size=SKY, mode="area")[0]
    return radiance * (0.6 / radiance.mean())


def sky_of(radiance: Tensor) -> tuple[Environment, Tensor]:
    """The map in finer texels of the same values, and which of the map's texels each is: (finer H * W,)."""
    index = torch.arange(radiance[0].numel()).view(1, 1, *radiance.shape[1:]).double()
    fine = F.interpolate(index, scale_factor=FINER, mode="nearest").flatten().long()
    return Environment(F.interpolate(radiance[None], scale_factor=FINER, mode="nearest")[0]), fine


def lit(mesh: UvMesh, points: Tensor, normals: Tensor, lights: Lights) -> Tensor:
    """(P, L) bool: whether the mesh lets each light reach each of its points (P, 3), by one z-buffer a light."""
    found = torch.empty(len(points), len(lights.direction), dtype=torch.bool)
    focal = 0.95 * SHADOW_SIZE / 2.0 * SHADOW_DISTANCE
    K = torch.tensor([[focal, 0.0, SHADOW_SIZE / 2.0], [0.0, focal, SHADOW_SIZE / 2.0], [0.0, 0.0, 1.0]])
    lifted = points + SHADOW_BIAS * normals
    for index, direction in enumerate(lights.direction):
        camera = Camera(look_at(SHADOW_DISTANCE * direction), K, SHADOW_SIZE, SHADOW_SIZE)
        buffer = rasterize(mesh.vertices, mesh.faces, camera).depth
        where, depth = project(lifted, camera)
        column, row = where.long().clamp(0, SHADOW_SIZE - 1).unbind(1)
        found[:, index] = depth <= buffer[row, column] + SHADOW_BIAS
    return found


def ours(subject: Subject, finish: MaterialMaps, radiance: Tensor, camera: Camera) -> dict[str, Tensor]:
    """(4, H, W) pictures, linear with alpha, one for each form of the BRDF."""
    sharp = camera.resized(camera.width * OVERSAMPLING, camera.height * OVERSAMPLING)
    mesh = subject.mesh
    fragments: Fragments = rasterize(mesh.vertices, mesh.faces, sharp)
    inside = fragments.mask
    point = interpolate(mesh.vertices, mesh.faces, fragments)[:, inside].T
    normal = F.normalize(interpolate(vertex_normals(mesh.vertices, mesh.faces), mesh.faces, fragments)[:, inside].T)
    uv = interpolate(mesh.uvs, mesh.face_uvs, fragments)[:, inside].T
    grid = torch.stack([2.0 * uv[:, 0] - 1.0, 1.0 - 2.0 * uv[:, 1]], dim=1)[None, None]
    texture = torch.cat([finish.image(name) for name in ("albedo", "roughness", "metallic")])[None]
    found = F.grid_sample(texture, grid, padding_mode="border", align_corners=False)[0, :, 0].T
    sky, coarse = sky_of(radiance)
    visible = None
    if subject.shadows:
        visible = lit(mesh, point, normal, Environment(radiance).texels())[:, coarse]
    pictures = {}
    for form in get_args(Form):
        color = shade(
            normal,
            view_directions(point, sharp),
            found[:, :3],
            found[:, 3:4],
            found[:, 4:],
            sky.texels(),
            visible,
            form,
        )
        picture = torch.zeros(4, sharp.height, sharp.width)
        picture[:3, inside], picture[3, inside] = color.T, 1.0
        pictures[form] = F.avg_pool2d(picture[None], OVERSAMPLING)[0]
    return pictures


def by_cycles(subject: Subject, finish: MaterialMaps, sky: Path, camera: Camera, samples: int) -> Tensor:
    """(4, H, W) linear, premultiplied: what Cycles renders of the asset as Blender holds it."""
    with temporary_scene("shading") as scene, tempfile.TemporaryDirectory() as folder:
        placed = build_object(RelightableAsset(subject.name, subject.mesh, finish), {}, scene)
        placed.visible_diffuse = placed.visible_glossy = False
        placed.cycles.shadow_terminator_offset = placed.cycles.shadow_terminator_geometry_offset = 0.0
        surface = next(n for n in placed.active_material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
        surface.distribution = "GGX"
        light_by_environment(scene, sky)
        next(n for n in scene.world.node_tree.nodes if n.type == "TEX_ENVIRONMENT").interpolation = "Closest"
        use_cycles(scene, samples, denoise=False)
        scene.cycles.max_bounces, scene.cycles.pixel_filter_type = 0, "BOX"
        add_view_camera(scene, camera)
        render = scene.render
        render.film_transparent = True
        render.use_compositing = render.use_sequencer = False
        scene.view_settings.view_transform = "Standard"
        use_exr(scene)
        render.filepath = str(Path(folder) / "view.exr")
        bpy.ops.render.render(scene=scene.name, write_still=True)
        return read_linear(Path(render.filepath))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--environment", default="forest", help="a .hdr or .exr file, or the name of one of Blender's")
    parser.add_argument("--resolution", type=int, default=96, help="pixels a side")
    parser.add_argument("--samples", type=int, default=1024, help="of Cycles, a pixel")
    parser.add_argument("--output", type=Path, default=Path("docs/shading.md"))


def run(args: argparse.Namespace) -> int:
    """Render, compare, and write the table and the picture."""
    radiance, finish = small_sky(environment_path(args.environment)), maps()
    camera = orbit_camera(25.0, 20.0, 4.5, 30.0, args.resolution, args.resolution)
    rows, sheet = [], []
    with tempfile.TemporaryDirectory() as folder:
        sky = Path(folder) / "sky.exr"
        write_linear(sky, radiance)
        made = list(subjects())
        count = Counted(len(made), logger.info)
        for subject in made:
            truth = by_cycles(subject, finish, sky, camera, args.samples)
            pictures = ours(subject, finish, radiance, camera)
            # Along the outline the filters differ; what is compared is shading.
            inner = -F.max_pool2d(-truth[None, 3:], 3, stride=1, padding=1)[0, 0] > 0.999
            rows.append([subject.name, *(psnr_inside(pictures[form], truth, inner) for form in get_args(Form))])
            difference = (srgb_from_linear(pictures["cycles"][:3]) - srgb_from_linear(truth[:3])).abs() * 8.0
            sheet.append(
                torch.cat([srgb_from_linear(truth[:3]), srgb_from_linear(pictures["cycles"][:3]), difference], 2)
            )
            count(subject.name)
    picture = args.output.parent / "images" / "shading.png"
    whole = torch.cat(sheet, dim=1).clamp(0.0, 1.0)
    write_png(picture, torch.cat([whole, torch.ones_like(whole[:1])]), srgb=False)
    curve = args.output.parent / "images" / "furnace.png"
    furnace.plot(curve)
    text = paragraphs(
        "# Shading against Cycles",
        "PSNR in dB of our direct light (`graphics.light.environment.shade`) against Cycles' render of the same asset, "
        "Principled BSDF with GGX, no bounces, over the pixels inside of the outline, as sRGB. Roughness runs from "
        "0.35 to 0.95 over each surface, with bands of metal.",
        markdown_table(["surface", *get_args(Form)], rows),
        f"![Cycles, ours, and eight times the difference](images/{picture.name})",
        "From left to right: Cycles, our form `cycles`, eight times their difference.",
        "## The white furnace",
        "What a white surface sends on out of uniform light of 1. Above 1 energy is made of nothing: only the formulas "
        "as the paper prints them do that. They take nothing from the diffuse term, so that plastic gains what the "
        "lobe gives; and their density of normals is not normalised, so that the lobe gains by itself.",
        f"![Light sent on, by cosine of the view](images/{curve.name})",
        f"Made by `{args.command}`.",
    )
    write_text(args.output, text)
    print(text)
    return 0
