"""Another system's meshes against the truth, by the same rules."""

from dataclasses import replace
from pathlib import Path

import torch

from arm_blender.errors import ArmError
from arm_blender.structures import TriangleMesh
from arm_blender.uv.mesh_file import read_mesh

from ..scores.alignment import align, moved_by
from ..scores.geometry import ceiling, compare
from ..scores.image_scores import moments
from ..scores.relighting import relighting_scores
from ..truth.entries import MODELS
from ..truth.objects import EvaluationObject
from ..truth.protocol import EvaluationEntry
from ..truth.truth import Truth
from .measure import HULL, OURS, ObjectResult, Shown, score_hull, score_pictures
from .trial import Trial


def mesh_of(folder: Path, name: str) -> Path:
    """The file of one object in a system's folder: `<id>.glb`, or `<id>/<anything>.glb` where that is the only one.

    Raises:
        ArmError: there is none, or several.
    """
    found = [path for suffix in MODELS if (path := folder / f"{name}{suffix}").is_file()]
    found = found or sorted(path for path in (folder / name).glob("*") if path.suffix.lower() in MODELS)
    if len(found) != 1:
        raise ArmError(f"{folder}: {len(found)} meshes of {name}; give {name}.glb, or leave the object out with --ids")
    return found[0]


def measure_file(
    meshes: Path, entry: EvaluationEntry, item: EvaluationObject, truth: Truth, trial: Trial
) -> tuple[ObjectResult, Shown]:
    """The other system's mesh of an object, from its folder `meshes`, in the place of ours, beside the hull.

    Raises:
        ArmError: there is no one file, or it does not do.
    """
    path = mesh_of(meshes, entry.name)
    shown = Shown(item.views(), truth, {}, {"truth": item.truth()})
    surface = shown.shapes["truth"]
    mesh = read_mesh(path)
    shape = TriangleMesh(mesh.vertices, mesh.faces)
    motion = align(shape, surface, trial.seed, trial.alignment)
    aligned = compare(shape.moved(moved_by(motion)), surface, trial.points, trial.seed)
    from .asset_render_blender import file_appearance

    place = torch.eye(4) if trial.own_frame else motion
    if truth.relighting is None:
        lights = truth.input_light, truth.other_light
        found, relit = file_appearance(path, place, truth.tests.cameras, lights, trial.protocol), {}
    else:
        relighting = truth.relighting

        def show(light: Path) -> tuple[torch.Tensor, torch.Tensor]:
            appearance = file_appearance(path, place, relighting.cameras, (light,), trial.protocol)
            assert appearance.lit is not None  # A light was given.
            return appearance.lit, appearance.alpha

        found = file_appearance(path, place, truth.tests.cameras, (truth.input_light,), trial.protocol)
        relit = {"relit": relighting_scores(relighting, show, trial.perceptual)}
    shown.shapes[OURS], shown.pictures[OURS] = shape.moved(moved_by(place)), found
    result = score_pictures(found, truth.tests, entry, trial)
    ours = replace(
        result,
        maps=result.maps | relit,
        geometry=compare(shape, surface, trial.points, trial.seed) if trial.own_frame else None,
        aligned=aligned,
    )
    measured = {}
    if entry.has_material:
        names = ("roughness", "metallic")
        measured = {name: moments(getattr(truth.tests, name), found.alpha, truth.tests.alpha) for name in names}
    systems = {OURS: ours, HULL: score_hull(entry, shown, trial)}
    best = ceiling(surface, trial.points, trial.seed)
    return ObjectResult(entry.name, entry.kind, systems, best, measured, {}), shown
