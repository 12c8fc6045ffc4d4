"""From posed views to a relightable asset: the whole story, one call a stage (ARM, figure 2)."""

from dataclasses import replace
from functools import partial
from typing import Any, Literal

import torch

from . import networks
from .config import PRESETS, Settings
from .errors import CheckpointError, EmptyMeshError
from .graphics.surface.fairing import fair
from .graphics.surface.isosurface import extract
from .graphics.surface.sample_grid import Density, IsosurfaceConfig
from .light_check.rerendering import check_by_light
from .machine.memory import lower_if_short
from .machine.threads import seeded_threads
from .models import random_weights
from .models.atlas_cells import surface_cells
from .models.atlas_network import Painted
from .models.encoded import Encoded
from .models.network_views import network_views
from .models.small.finish import seen_points
from .progress import SHARES, Progress, part, silent
from .refinement.refined import refined
from .report import Report
from .structures import MaterialMaps, RelightableAsset, TexelMap, TexelViews, TriangleMesh, UvMesh, ViewSet
from .uv import maps
from .uv.backproject import backproject, texture_size_for
from .uv.blend import blend
from .uv.decimate import clean, decimate
from .uv.exposure import even
from .uv.finish import chosen_finishes
from .uv.given.winding import facing_out
from .uv.normal_map import detail
from .uv.off_colors import off_colors
from .uv.regions import regions_of
from .uv.texels import texel_map
from .uv.unwrap import UnwrapConfig, unwrap
from .views.doubts import hardly_seen, misfit
from .views.scene_frame import normalise

GLOSSY_TEXELS = 512
"""Texels a side of the roughness and metallic maps at most: the field behind them is no finer."""

POINTS_AT_ONCE = {"cpu": 2**14, "cuda": 2**18, "mps": 2**17}
"""Points in one call of a field: what the caches of a core, or the memory of a GPU, hold."""


def generate(
    views: ViewSet,
    settings: Settings,
    progress: Progress = silent,
    report: Report | None = None,
    mesh: TriangleMesh | UvMesh | None = None,
) -> tuple[RelightableAsset, Report]:
    """Reconstruct the object in `views`.

    Args:
        views: 1 to 32 posed views, in any frame.
        settings: what to make of them.
        progress: told of every stage; it may raise `Cancelled`.
        report: continued, if loading has begun one.
        mesh: of the user's, in the views' frame: it keeps its shape, and its UVs if it has them; only its appearance
            is made. None has the shape reconstructed.
    Returns:
        The asset, in the cameras' frame or as long as `views.length` says, and the report. Its name says where the
        weights were random.
    Raises:
        ArmError: the input does not do, weights are missing, the density has no surface, or no view sees `mesh`.
    """
    given = mesh is not None
    report = report or Report(settings.preset, settings.device, settings.seed)
    # What is missing is said before the work.
    networks.check_weights(settings, report, networks.needed(settings, len(views.chosen().cameras), given))
    with seeded_threads(settings.threads, settings.seed), torch.inference_mode():
        with lower_if_short("the views", "give fewer or smaller ones"):
            chosen = views.chosen()
            if len(chosen.cameras) < len(views.cameras):
                report.leave_out(f"{len(views.cameras) - len(chosen.cameras)} views", "their weight is 0")
            views, frame = normalise(chosen.to(settings.device))
        with report.stage("shape"), lower_if_short("the shape", "lower --grid or --quality"):
            dense: TriangleMesh | None = None
            if mesh is not None:
                mesh = own_shape(mesh.to(settings.device).moved(frame.boxed), views, report)
            else:
                dense = shape(views, settings, part(progress, *SHARES["shape"]), report)
                mesh = decimate(dense, settings.resolved.faces)
                dense = dense if settings.normal_map and mesh is not dense else None  # Else its memory is free.
        with report.stage("unwrap"), lower_if_short("unwrapping", "lower --faces"):
            mesh = atlas(mesh, settings, report, part(progress, *SHARES["unwrap"]))
        with report.stage("appearance"), lower_if_short("the material", "lower --texture-size"):
            material = appearance(mesh, views, settings, report, part(progress, *SHARES["appearance"]))
            if given and report.seen_share == 0.0:
                raise EmptyMeshError(f"{views.name}: no view sees the given mesh; bring it to where the object is")
        if settings.normal_map:
            with report.stage("normal map"), lower_if_short("the normal map", "go without --normal-map"):
                progress(SHARES["appearance"][1], "baking the normal map")
                material = detail(mesh, dense, material, report)
        with report.stage("check by light"):
            compared = check_by_light(mesh, material, views, report, part(progress, *SHARES["check by light"]))
    if not given and settings.random_weights is None:
        report.doubt(*misfit(mesh, views))
    mesh = frame.restored(mesh, None if given else views.length)
    report.faces, report.charts, report.texture_size = len(mesh.faces), mesh.charts, material.albedo.shape[-1]
    name = views.name if settings.random_weights is None else _meaningless(views.name, settings, report)
    return RelightableAsset(name, mesh, material, compared).to("cpu"), report


def _meaningless(name: str, settings: Settings, report: Report) -> str:
    """What the result of random weights is called: objects and files say so, wherever they go."""
    report.leave_out("trained weights", f"--random-weights {settings.random_weights}: the asset means nothing")
    return f"{name}-random-weights"


def own_shape(mesh: TriangleMesh | UvMesh, views: ViewSet, report: Report) -> TriangleMesh | UvMesh:
    """A user's mesh, in the frame of the views, with its faces looking outwards."""
    report.leave_out("reconstruction of the shape", "the shape is given")
    mesh, turned = facing_out(mesh, views.cameras)
    if turned > 0.0:
        report.leave_out(f"the side that {turned:.0%} of the faces looked to", "it was the inner one")
    return mesh


def shape(
    views: ViewSet, settings: Settings, progress: Progress = silent, report: Report | None = None
) -> TriangleMesh:
    """GeoRM, its iso-surface, cleaned and freed of the grid's steps (ARM, section 5.1), moved to meet the views."""
    report = report or Report(settings.preset, settings.device, settings.seed)
    surface = _surface(views, settings, report, part(progress, 0.0, 0.7))
    progress(0.7, "cleaning the mesh")
    mesh = fair(clean(surface), PRESETS[settings.preset].fairing)
    if settings.random_weights is not None:
        return mesh
    return refined(mesh, views, settings.resolved.refinement, report, part(progress, 0.75, 1.0))


def _surface(views: ViewSet, settings: Settings, report: Report, progress: Progress) -> TriangleMesh:
    """Where GeoRM's density is that of the surface, as it comes out of the grid."""
    field = density(views, settings, report, part(progress, 0.0, 0.25))
    config = IsosurfaceConfig(
        settings.resolved.grid, iso=0.0, dense=settings.dense, chunk=POINTS_AT_ONCE[settings.device]
    )
    try:
        return extract(field, config, part(progress, 0.25, 1.0), settings.device)
    except EmptyMeshError as error:
        raise EmptyMeshError(f"{views.name}: {error}") from error


def density(views: ViewSet, settings: Settings, report: Report, progress: Progress = silent) -> Density:
    """Logits raised until they fill the silhouettes of normalised `views`; the surface is where they are 0."""
    name = PRESETS[settings.preset].shape_network(len(views.cameras))
    if name != "georm":
        report.leave_out("GeoRM", "there are too few views to compare: the shape is one that such objects have")
    network, encoded = _encoded(name, views, settings, report, progress)
    chunk = POINTS_AT_ONCE[settings.device]
    field = network.filled_logit(encoded, chunk, part(progress, 0.6, 1.0))
    return field if settings.random_weights is None else random_weights.dented_ball(field, chunk, settings.device)


def _encoded(
    name: Literal["georm", "glossyrm", "ray_occupancy"],
    views: ViewSet,
    settings: Settings,
    report: Report,
    progress: Progress,
) -> tuple[Any, Encoded]:
    """A reconstruction model, and what it decodes points from; float32 from here on."""
    title = {"georm": "GeoRM", "glossyrm": "GlossyRM", "ray_occupancy": "Ray occupancy"}[name]
    with lower_if_short(title, "give fewer views, or choose --preset small"):
        progress(0.0, f"{title}: loading")
        network: Any = networks.load(name, settings)  # Of several classes, by the preset.
        reading = partial(progress, 0.2, f"{title}: reading the views")
        reading()
        pictures = network_views(views, network.config)
        reading()
        with networks.running(network, settings, report, reading):
            encoded = network.encode(pictures).float()
    _require_numbers(encoded.is_finite, name, views, settings)
    return network, encoded


def atlas(mesh: TriangleMesh | UvMesh, settings: Settings, report: Report, progress: Progress) -> UvMesh:
    """The mesh with a UV atlas; a user's own atlas is kept."""
    if isinstance(mesh, UvMesh):
        report.leave_out("unwrapping", "the mesh brings its own UVs")
        return mesh
    progress(0.0, "unwrapping")
    config = UnwrapConfig(texture_size=settings.resolved.texture_size, time_limit=settings.time_limit)
    unwrapped, packing = unwrap(mesh, config, progress)
    if packing != "xatlas":
        report.leave_out("xatlas", f"it failed, or took more than {settings.time_limit:g} s; charts stand on shelves")
    return unwrapped


def appearance(mesh: UvMesh, views: ViewSet, settings: Settings, report: Report, progress: Progress) -> MaterialMaps:
    """Albedo and baked colour by InstantAlbedo, roughness and metallic by GlossyRM (ARM, sections 5.1 to 5.3).

    Where a preset has no GlossyRM, both are read off what the views show.
    """
    size = texture_size_for(mesh, views, settings.resolved.texture_size)
    if size < settings.resolved.texture_size:
        report.leave_out(f"texels beyond {size} a side", "the views have no more pixels to fill them")
    progress(0.0, "back-projecting the views")
    texels = texel_map(mesh, size)
    seen = backproject(mesh, texels, views, progress=part(progress, 0.02, 0.22))
    if views.varying_exposure:
        views, seen = even(views, seen, report)
    progress(0.22, "blending the views")
    colors, weight = blend(seen, views.weights)
    known = (weight > 0.0) & texels.mask
    report.seen_share = float(known.sum() / texels.mask.sum().clamp(min=1))
    if settings.random_weights is None:
        report.doubt(*hardly_seen(report.seen_share, len(views.cameras)))
    report.doubt(*off_colors(seen, colors, views.called))
    if report.seen_share == 1.0:
        report.leave_out("in-painting", "every texel was seen")
    progress(0.26, "filling unseen texels")
    base = maps.diffuse_fill(colors, known, texels)
    albedo, baked, light = paint(views, texels, seen, base, settings, report, part(progress, 0.3, 0.6))
    del seen, base, colors, weight
    said = finish if PRESETS[settings.preset].gloss_network == "finish" else gloss
    roughness, metallic = said(mesh, views, texels, settings, report, part(progress, 0.6, 1.0))
    material = MaterialMaps(maps.pad(albedo, texels.mask), maps.pad(baked, texels.mask), roughness, metallic)
    material = replace(material, regions=regions_of(mesh, material, texels.mask), light=light)
    return chosen_finishes(material, settings.finish, report)


def paint(
    views: ViewSet,
    texels: TexelMap,
    seen: TexelViews,
    base: torch.Tensor,
    settings: Settings,
    report: Report,
    progress: Progress,
) -> Painted:
    """What InstantAlbedo says of the atlas, and of the light; the network's memory is free again afterwards."""
    progress(0.0, "InstantAlbedo: loading")
    network: Any = networks.load("instant_albedo", settings)
    painting = partial(progress, 0.1, "InstantAlbedo: painting")
    painting()
    with networks.running(network, settings, report, painting):
        found: Painted = network.painted(views.images, texels, seen, base)
    finite = all(bool(image.isfinite()[:, texels.mask].all()) for image in found[:2])
    finite = finite and (found.light is None or bool(found.light.isfinite().all()))
    _require_numbers(finite, "instant_albedo", views, settings)
    # Of random weights it means nothing.
    return found if settings.random_weights is None else found._replace(light=None)


def finish(
    mesh: UvMesh, views: ViewSet, texels: TexelMap, settings: Settings, report: Report, progress: Progress
) -> tuple[torch.Tensor | float, ...]:
    """Roughness and metallic by the evidence of the views: (1, n, n), or a value where the map is one."""
    progress(0.0, "Finish: loading")
    network: Any = networks.load("finish", settings)
    reading = partial(progress, 0.2, "Finish: reading the views")
    reading()
    surface = surface_cells(texels, min(len(texels.mask), network.config.resolution))
    points = seen_points(mesh, views, surface, network.config, reading)
    covered = surface[0] > 0.0
    if points is None:
        report.leave_out("roughness and metallic", "no view sees the surface: they are the usual ones")
    with networks.running(network, settings, report, reading):
        glossy = network.maps(surface, points)
    _require_numbers(bool(glossy[:, covered].isfinite().all()), "finish", views, settings)
    return maps.gloss_maps(glossy, covered, report)


def gloss(
    mesh: UvMesh, views: ViewSet, texels: TexelMap, settings: Settings, report: Report, progress: Progress
) -> tuple[torch.Tensor | float, ...]:
    """Roughness and metallic, decoded at the texels: (1, T, T), or a value where the map is one."""
    network, encoded = _encoded("glossyrm", views, settings, report, part(progress, 0.0, 0.7))
    if len(texels.mask) > GLOSSY_TEXELS:
        texels = texel_map(mesh, GLOSSY_TEXELS)
    points = texels.position[:, texels.mask].T
    chunks = points.split(POINTS_AT_ONCE[settings.device])
    values = []
    for index, chunk in enumerate(chunks):
        progress(0.7 + 0.3 * index / len(chunks), "GlossyRM: decoding texels")
        values.append(network(encoded, chunk[None])[0])
    glossy = texels.position.new_zeros(2, *texels.mask.shape)
    glossy[:, texels.mask] = torch.cat(values).T
    return maps.gloss_maps(glossy, texels.mask, report)


def _require_numbers(finite: bool, network: str, views: ViewSet, settings: Settings) -> None:
    """Raises `CheckpointError` where a network does not give numbers: what comes later could only be wrong."""
    if not finite:
        where = settings.weights(network)
        raise CheckpointError(f"{where}: overflows on {views.name}; use the weights as published, or train them again")
