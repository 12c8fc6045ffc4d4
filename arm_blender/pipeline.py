"""From posed views to a relightable asset: the whole story, one call a stage (ARM, figure 2)."""

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor, nn

from . import checkpoints
from .config import Settings
from .errors import EmptyMeshError
from .graphics.isosurface import extract
from .graphics.sample_grid import IsosurfaceConfig
from .models.georm import GeoRM
from .models.glossyrm import GlossyRM
from .models.instant_albedo import InstantAlbedo, InstantAlbedoConfig
from .models.reconstruction import ReconstructionConfig, network_views
from .progress import Progress, part, silent
from .report import Report
from .structures import MaterialMaps, RelightableAsset, TexelMap, TriangleMesh, UvMesh, ViewSet
from .threads import cpu_threads
from .uv import maps
from .uv.backproject import BLENDS, backproject, blend, texture_size_for
from .uv.decimate import clean, decimate
from .uv.mesh_file import read_mesh
from .uv.normal_map import bake_normal_map
from .uv.texels import texel_map
from .uv.unwrap import UnwrapConfig, unwrap
from .views.scene_frame import normalise

NETWORKS: dict[str, tuple[type[nn.Module], type]] = {
    "georm": (GeoRM, ReconstructionConfig),
    "glossyrm": (GlossyRM, ReconstructionConfig),
    "instant_albedo": (InstantAlbedo, InstantAlbedoConfig),
}
"""Each network and the config that its checkpoint carries."""

GLOSSY_TEXELS = 512
"""Texels a side of the roughness and metallic maps at most: the field behind them is no finer."""

DETAIL_TEXELS = 512
"""Texels a side of the normal map at most: twice as many take four times as long, and gain little
(docs/normal-map.md)."""

CONSTANT_TOLERANCE = 0.02
"""A roughness or metallic map that stays this close to one value becomes the value; the eye sees no difference."""

POINTS_AT_ONCE = {"cpu": 2**14, "cuda": 2**18, "mps": 2**17}
"""Points in one call of a field: what the caches of a core, or the memory of a GPU, hold."""


def generate(
    views: ViewSet, settings: Settings, progress: Progress = silent, report: Report | None = None
) -> tuple[RelightableAsset, Report]:
    """Reconstruct the object in `views`.

    Args:
        views: 1 to 16 posed views, in any frame.
        settings: what to make of them.
        progress: told of every stage; it may raise `Cancelled`.
        report: continued, if loading has begun one.
    Returns:
        The asset, in the cameras' frame, and the report.
    Raises:
        ArmError: the input does not do, weights are missing, or the density has no surface.
    """
    report = report or Report(settings.preset, settings.device, settings.seed)
    for name in NETWORKS:
        if name != "georm" or settings.mesh is None:
            checkpoints.read_header(settings.weights(name))  # What is missing is said before the work.
    with _running(settings), torch.inference_mode():
        chosen = views.chosen()
        if len(chosen.cameras) < len(views.cameras):
            report.leave_out(f"{len(views.cameras) - len(chosen.cameras)} views", "their weight is 0")
        views, frame = normalise(chosen.to(settings.device))
        with report.stage("shape"):
            if settings.mesh is None:
                dense = shape(views, settings, part(progress, 0.0, 0.35))
                progress(0.35, "reducing the mesh")
                mesh = decimate(dense, settings.resolved.faces)
            else:
                report.leave_out("reconstruction of the shape", f"{settings.mesh.name} is the shape")
                mesh = dense = read_mesh(settings.mesh).moved(frame.boxed)
        reduced = mesh is not dense
        with report.stage("unwrap"):
            mesh = atlas(mesh, settings, report, part(progress, 0.4, 0.6))
        with report.stage("appearance"):
            material = appearance(mesh, views, settings, report, part(progress, 0.6, 0.95))
            if settings.mesh is not None and report.seen_share == 0.0:
                raise EmptyMeshError(f"{settings.mesh}: no view sees it; bring it to where the object is in the views")
        if settings.normal_map and reduced:
            with report.stage("normal map"):
                progress(0.95, "baking the normal map")
                material = replace(material, normal=detail(mesh, dense, material, report))
        elif settings.normal_map:
            report.leave_out("normal map", "no face was taken from the mesh")
    mesh = mesh.moved(frame.restore)
    report.faces, report.charts, report.texture_size = len(mesh.faces), mesh.charts, material.albedo.shape[-1]
    return RelightableAsset(views.name, mesh, material).to("cpu"), report


def shape(views: ViewSet, settings: Settings, progress: Progress = silent) -> TriangleMesh:
    """GeoRM and its iso-surface, cleaned (ARM, section 4.1)."""
    progress(0.0, "GeoRM: reading the views")
    network = _network("georm", settings)
    encoded = network.encode(network_views(views, network.config))
    config = IsosurfaceConfig(
        settings.resolved.grid, iso=0.0, dense=settings.dense, chunk=POINTS_AT_ONCE[settings.device]
    )
    try:
        field = network.filled_logit(encoded, config.chunk)
        surface = extract(field, config, part(progress, 0.2, 0.95), settings.device)
    except EmptyMeshError as error:
        raise EmptyMeshError(f"{views.name}: {error}") from error
    progress(0.95, "cleaning the mesh")
    return clean(surface)


def detail(mesh: UvMesh, dense: TriangleMesh, material: MaterialMaps, report: Report) -> Tensor:
    """(3, T, T) the normals of the dense mesh on the reduced one; see `bake_normal_map`."""
    size = min(material.albedo.shape[-1], DETAIL_TEXELS)
    normal, share = bake_normal_map(mesh, dense, size)
    if share < 1.0:
        report.leave_out("a part of the normal map", f"{1.0 - share:.2%} of the texels lie off the dense surface")
    return normal


def atlas(mesh: TriangleMesh | UvMesh, settings: Settings, report: Report, progress: Progress) -> UvMesh:
    """The mesh with a UV atlas; a user's own atlas is kept."""
    if isinstance(mesh, UvMesh):
        report.leave_out("unwrapping", "the mesh brings its own UVs")
        return mesh
    config = UnwrapConfig(texture_size=settings.resolved.texture_size, time_limit=settings.time_limit)
    unwrapped, packing = unwrap(mesh, config, progress)
    if packing != "xatlas":
        report.leave_out("xatlas", f"it failed, or took more than {settings.time_limit:g} s; charts stand on shelves")
    return unwrapped


def appearance(mesh: UvMesh, views: ViewSet, settings: Settings, report: Report, progress: Progress) -> MaterialMaps:
    """Albedo and baked colour by InstantAlbedo, roughness and metallic by GlossyRM (ARM, sections 4.2 and 5)."""
    size = texture_size_for(mesh, views, settings.resolved.texture_size)
    if size < settings.resolved.texture_size:
        report.leave_out(f"texels beyond {size} a side", "the views have no more pixels to fill them")
    progress(0.0, "back-projecting the views")
    texels = texel_map(mesh, size)
    seen = backproject(mesh, texels, views)
    colors, weight = blend(seen, views.weights, BLENDS[settings.blend])
    known = (weight > 0.0) & texels.mask
    report.seen_share = float(known.sum() / texels.mask.sum().clamp(min=1))
    if report.seen_share == 1.0:
        report.leave_out("in-painting", "every texel was seen")
    base = maps.diffuse_fill(colors, known, texels)
    progress(0.3, "InstantAlbedo")
    painter = _network("instant_albedo", settings)
    albedo, baked = painter(views.images, texels, seen, base)
    progress(0.6, "GlossyRM")
    roughness, metallic = gloss(mesh, views, texels, settings, report, part(progress, 0.6, 1.0))
    return MaterialMaps(maps.pad(albedo, texels.mask), maps.pad(baked, texels.mask), roughness, metallic)


def gloss(
    mesh: UvMesh, views: ViewSet, texels: TexelMap, settings: Settings, report: Report, progress: Progress
) -> tuple[torch.Tensor, torch.Tensor]:
    """Roughness and metallic (1, T, T), decoded at the texels; small where the map is one value."""
    network = _network("glossyrm", settings)
    encoded = network.encode(network_views(views, network.config))
    if len(texels.mask) > GLOSSY_TEXELS:
        texels = texel_map(mesh, GLOSSY_TEXELS)
    points = texels.position[:, texels.mask].T
    chunks = points.split(POINTS_AT_ONCE[settings.device])
    values = []
    for index, chunk in enumerate(chunks):
        progress(index / len(chunks), "GlossyRM: decoding texels")
        values.append(network(encoded, chunk[None])[0])
    glossy = texels.position.new_zeros(2, *texels.mask.shape)
    glossy[:, texels.mask] = torch.cat(values).T
    result = []
    for name, image in zip(("roughness", "metallic"), maps.pad(glossy, texels.mask).split(1), strict=True):
        constant = maps.constant_value(image, texels.mask, CONSTANT_TOLERANCE)
        if constant is not None:
            report.leave_out(f"{name} texture", f"it is {constant:.2f} everywhere")
            image = image.new_full((1, maps.CONSTANT_SIDE, maps.CONSTANT_SIDE), constant)
        result.append(image)
    return result[0], result[1]


@functools.lru_cache(maxsize=3)
def _load(path: Path, name: str, device: str) -> nn.Module:
    """A network with its weights, ready to run; the next item of a batch finds it loaded."""
    network, config_type = NETWORKS[name]
    config, state = checkpoints.load(path, config_type)
    module = network(config)
    checkpoints.restore(module, state, path)
    return module.to(device).eval().requires_grad_(False)


def _network(name: str, settings: Settings) -> nn.Module:
    return _load(settings.weights(name), name, settings.device)


@contextmanager
def _running(settings: Settings) -> Iterator[None]:
    """The run's number of threads and its seed; the caller's own come back afterwards."""
    random = torch.get_rng_state()
    with cpu_threads(settings.threads):
        torch.manual_seed(settings.seed)
        try:
            yield
        finally:
            torch.set_rng_state(random)
