"""One object through the pipeline and its baselines, every result compared with the truth."""

import logging
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import torch

from arm_blender import pipeline
from arm_blender.config import Settings
from arm_blender.errors import ArmError, EmptyMeshError
from arm_blender.graphics.color import linear_from_srgb, srgb_from_linear
from arm_blender.structures import RelightableAsset, TriangleMesh, UvMesh, ViewSet
from arm_blender.views import ViewOptions, load_views

from ..scores.alignment import align, moved_by
from ..scores.geometry import FAILED, GeometryScores, ceiling, compare
from ..scores.image_scores import MISSED, ImageScores, ViewMoments, compare_pictures, mask_overlap, moments
from ..scores.light import LightScores, irradiance_psnr, seen_normals, true_light
from ..scores.relighting import under_lights
from ..truth.objects import EvaluationObject
from ..truth.protocol import EXPOSURE, UNMEASURED, EvaluationEntry
from ..truth.truth import FRONT, Appearance, Truth
from .asset_pictures import map_pictures, vertex_pictures
from .baselines import colored_hull, plain_blend
from .trial import Trial

logger = logging.getLogger(__name__)

OURS, HULL, BLEND, ONE_VIEW, PICTURE, PROVIDER = "ours", "hull", "plain blend", "one view", "bare picture", "provider"
SCALED = "albedo scaled"
MAPS = ("albedo", "roughness", "metallic", "lit", "relit")


@dataclass(frozen=True)
class SystemResult:
    """What one system reached on one object.

    Attributes:
        geometry: in the cameras' own frame; None where the system does not know that.
        aligned: after the paper's alignment; None where it was not tried.
        overlap: of the masks in the test views, in [0, 1].
        maps: scores by the name of the map; of `SCALED` after one scale for all of the object's albedo. Roughness and
            metallic are missing where the truth has none, lit colours where they were not rendered.
    """

    geometry: GeometryScores | None
    aligned: GeometryScores | None = None
    overlap: float = 0.0
    maps: dict[str, ImageScores] = field(default_factory=dict)


@dataclass(frozen=True)
class ObjectResult:
    """What was measured on one object.

    Attributes:
        name: the object's id. kind: the set that it is of.
        systems: by name.
        ceiling: what a perfect outer surface scores.
        moments: of true roughness and metallic where ours shows the object too, for constants to be judged.
        seconds: of the pipeline from six views, by stage.
        light: that was taken off the six views; None where none was predicted.
    """

    name: str
    kind: str
    systems: dict[str, SystemResult]
    ceiling: GeometryScores
    moments: dict[str, list[ViewMoments]]
    seconds: dict[str, float]
    light: LightScores | None = None


@dataclass(frozen=True)
class Shown:
    """What sheets are made of: of one object, the input views, and by system the pictures and shapes."""

    views: ViewSet
    truth: Truth
    pictures: dict[str, Appearance]
    shapes: dict[str, TriangleMesh]


def measure(entry: EvaluationEntry, item: EvaluationObject, truth: Truth, trial: Trial) -> tuple[ObjectResult, Shown]:
    """Everything that the trial asks for, on one object.

    Raises:
        ArmError: weights are missing or the views do not do. Where a system finds no surface it scores nothing.
    """
    views, surface = item.views(), item.truth()
    shown = Shown(views, truth, {}, {"truth": surface})
    asset, seconds, rerendering = _generate(views, trial.settings)
    kept, measured, light = None, {}, None
    if asset is None:
        systems = {OURS: _failed(truth, entry), BLEND: _failed(truth, entry)}
    else:
        kept = _score_asset(OURS, asset, entry, shown, trial, cycles=trial.cycles)
        blended = _score_asset(BLEND, plain_blend(asset, views), entry, shown, trial, kept)
        # In the table ours stands for its shape.
        systems = {OURS: kept, BLEND: replace(blended, geometry=None, aligned=None)}
        light = _score_light(asset, shown, rerendering)
        if entry.has_material:
            alpha, tests = shown.pictures[OURS].alpha, truth.tests
            measured = {name: moments(getattr(tests, name), alpha, tests.alpha) for name in ("roughness", "metallic")}
    systems[HULL] = score_hull(entry, shown, trial)
    for name, settings in trial.others.items():
        # What brings no weights of the shape has ours; making it anew would take most of the time.
        mesh, same = (asset.mesh, kept) if asset is not None and has_our_shape(settings, trial) else (None, None)
        other, *_ = _generate(views, settings, mesh)
        systems[name] = _failed(truth, entry) if other is None else _score_asset(name, other, entry, shown, trial, same)
    if trial.one_view:
        systems |= _single_views(entry, item, shown, trial)
    best = ceiling(surface, trial.points, trial.seed)
    return ObjectResult(entry.name, entry.kind, systems, best, measured, seconds, light), shown


def score_pictures(found: Appearance, truth: Appearance, entry: EvaluationEntry, trial: Trial) -> SystemResult:
    """The scores of what a system shows, its shape left out."""
    maps = {}
    for name in MAPS:
        if name in ("roughness", "metallic") and not entry.has_material:
            continue
        own, true = getattr(found, name), getattr(truth, name)
        if own is not None and true is not None:
            maps[name] = compare_pictures(own, true, found.alpha, truth.alpha, trial.perceptual)
    scaled = scaled_albedo(found, truth)
    maps[SCALED] = compare_pictures(scaled, truth.albedo, found.alpha, truth.alpha, trial.perceptual)
    return SystemResult(None, None, mask_overlap(found.alpha, truth.alpha), maps)


def scaled_albedo(found: Appearance, truth: Appearance) -> torch.Tensor:
    """(V, 3, N, N) sRGB: the albedo times the one linear factor for all views that brings it nearest to the truth."""
    own, true = linear_from_srgb(found.albedo), linear_from_srgb(truth.albedo)
    both = (found.mask & truth.mask).expand_as(own)
    factor = (own * true)[both].sum() / own[both].square().sum().clamp(min=1e-9)
    return srgb_from_linear(own * factor)


def has_our_shape(settings: Settings, trial: Trial) -> bool:
    """Whether settings give the shape that those of the trial give: they differ in weights of the appearance alone."""
    own = settings.weights("georm") == trial.settings.weights("georm")
    return own and replace(settings, weights_folder=trial.settings.weights_folder) == trial.settings


def _generate(
    views: ViewSet, settings: Settings, mesh: UvMesh | None = None
) -> tuple[RelightableAsset | None, dict[str, float], float | None]:
    """The asset, the seconds of each stage, and the re-rendering PSNR; None and {} where there is no surface."""
    try:
        asset, report = pipeline.generate(views, settings, mesh=mesh)
    except EmptyMeshError as error:
        logger.warning("%s: %s", views.name, error)
        return None, {}, None
    return asset, report.seconds, None if report.light is None else report.light["psnr"]


def _score_light(asset: RelightableAsset, shown: Shown, rerendering: float | None) -> LightScores | None:
    """The light that was taken off the views against that of the truth; None where none was predicted."""
    if asset.maps.light is None or rerendering is None:
        return None
    true, normals = true_light(shown.truth.input_light, EXPOSURE), seen_normals(shown.shapes["truth"], shown.views)
    return LightScores(irradiance_psnr(asset.maps.light, true, normals), rerendering)


def _failed(truth: Truth, entry: EvaluationEntry) -> SystemResult:
    names = [name for name in (*MAPS, SCALED) if entry.has_material or name not in ("roughness", "metallic")]
    return SystemResult(FAILED, FAILED, 0.0, dict.fromkeys(names, MISSED))


def _score_asset(
    name: str,
    asset: RelightableAsset,
    entry: EvaluationEntry,
    shown: Shown,
    trial: Trial,
    same: SystemResult | None = None,
    cycles: bool = False,
) -> SystemResult:
    """An asset in the cameras' frame; what it shows is kept.

    Args:
        same: of a system that has the same shape; its scores of that are taken.
        cycles: render it under the truth's lights.
    """
    tests, surface = shown.truth.tests, shown.shapes["truth"]
    found = map_pictures(asset, tests.cameras)
    relit: dict[str, ImageScores] = {}
    if cycles:
        from .asset_render_blender import asset_lights

        show, render = partial(map_pictures, asset), partial(asset_lights, asset, protocol=trial.protocol)
        found, relit = under_lights(found, show, render, shown.truth, trial.perceptual)
    shown.pictures[name], shown.shapes[name] = found, _shape(asset.mesh)
    result = score_pictures(found, tests, entry, trial)
    result = replace(result, maps=result.maps | relit)
    if same is not None:
        return replace(result, geometry=same.geometry, aligned=same.aligned)
    result = replace(result, geometry=compare(shown.shapes[name], surface, trial.points, trial.seed))
    if not trial.align:
        return result
    motion = moved_by(align(shown.shapes[name], surface, trial.seed, trial.alignment))
    return replace(result, aligned=compare(shown.shapes[name].moved(motion), surface, trial.points, trial.seed))


def score_hull(entry: EvaluationEntry, shown: Shown, trial: Trial) -> SystemResult:
    """The visual hull with the views' colours; what it shows is kept."""
    tests = shown.truth.tests
    hull = colored_hull(shown.views, trial.settings.resolved.grid, UNMEASURED)
    show = partial(vertex_pictures, hull.mesh, hull.colors, UNMEASURED)
    found = show(tests.cameras)
    relit: dict[str, ImageScores] = {}
    if trial.cycles:
        from .asset_render_blender import colored_lights

        render = partial(colored_lights, hull, protocol=trial.protocol)
        found, relit = under_lights(found, show, render, shown.truth, trial.perceptual)
    shown.pictures[HULL], shown.shapes[HULL] = found, hull.mesh
    result = score_pictures(found, tests, entry, trial)
    shape = compare(hull.mesh, shown.shapes["truth"], trial.points, trial.seed)
    return replace(result, geometry=shape, maps=result.maps | relit)


def _single_views(
    entry: EvaluationEntry, item: EvaluationObject, shown: Shown, trial: Trial
) -> dict[str, SystemResult]:
    """The one true view with its camera; the bare picture, aligned; and, where a provider is given, its six views."""
    front = item.folder / FRONT
    picture = entry.picture or front / "000.png"
    asset, *_ = _generate(load_views(front, ViewOptions()), trial.settings)
    if asset is None:
        systems = {ONE_VIEW: _failed(shown.truth, entry)}
    else:
        found = map_pictures(asset, shown.truth.front.cameras)
        shown.pictures[ONE_VIEW], shown.shapes[ONE_VIEW] = found, _shape(asset.mesh)
        scores = compare(shown.shapes[ONE_VIEW], shown.shapes["truth"], trial.points, trial.seed)
        systems = {ONE_VIEW: replace(score_pictures(found, shown.truth.front, entry, trial), geometry=scores)}
    systems[PICTURE] = _unposed(PICTURE, picture, ViewOptions(), entry, shown, trial)
    if trial.provider is not None:
        systems[PROVIDER] = _unposed(PROVIDER, picture, trial.provider(entry.name), entry, shown, trial)
    return systems


def _unposed(
    name: str, picture: Path, options: ViewOptions, entry: EvaluationEntry, shown: Shown, trial: Trial
) -> SystemResult:
    """From a picture without a camera: aligned as the paper does, then shown as it stands."""
    try:
        asset, *_ = _generate(load_views(picture, options), trial.settings)
    except ArmError as error:
        logger.warning("%s, %s: %s", entry.name, name, error)
        asset = None
    if asset is None:
        return replace(_failed(shown.truth, entry), geometry=None)
    surface, tests = shown.shapes["truth"], shown.truth.tests
    moved = replace(
        asset, mesh=asset.mesh.moved(moved_by(align(_shape(asset.mesh), surface, trial.seed, trial.alignment)))
    )
    shown.pictures[name], shown.shapes[name] = map_pictures(moved, tests.cameras), _shape(moved.mesh)
    scores = compare(shown.shapes[name], surface, trial.points, trial.seed)
    return replace(score_pictures(shown.pictures[name], tests, entry, trial), aligned=scores)


def _shape(mesh: UvMesh) -> TriangleMesh:
    return TriangleMesh(mesh.vertices, mesh.faces)
