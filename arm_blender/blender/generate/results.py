"""What becomes of a run's result in the open file."""

from dataclasses import replace
from typing import Any

import bpy
import torch

from ...asset_record import AssetRecord
from ...errors import ArmError
from ...version import VERSION
from ...views.placement import on_the_ground
from ...views.scene_frame import IDENTITY, SceneFrame
from ..asset.asset_preview import mark_as_asset
from ..asset.scene import build_object, replace_maps
from ..input.generation_request import GenerationRequest
from ..input.request import blend_folder, stored_record
from .generation import Generated


def add_result(context: bpy.types.Context, made: Generated, wanted: GenerationRequest) -> bpy.types.Object:
    """Add the result as a new object, placed as the panel says; an own mesh's stays where that mesh is."""
    settings = context.scene.arm
    asset, frame = made.asset, made.frame
    stood, location = IDENTITY, (0.0, 0.0, 0.0)
    if wanted.mesh is not None:
        stood, location = SceneFrame(torch.tensor(wanted.mesh.origin).float(), 1.0), wanted.mesh.origin
        asset = replace(asset, mesh=asset.mesh.moved(stood.boxed))
    elif settings.placement == "ground":
        asset, stood = on_the_ground(asset, settings.size)
        cursor = context.scene.cursor.location
        location = (cursor.x, cursor.y, 0.0)
    frame = SceneFrame(frame.restore(stood.center), frame.scale * stood.scale)  # First back to where it was.
    created = build_object(asset, _kept(made, wanted.record([frame.scale, *frame.center.tolist()])))
    created.location = location
    if settings.as_asset:
        mark_as_asset(created, asset)
    return created


def renew_appearance(made: Generated, wanted: GenerationRequest) -> bpy.types.Object:
    """Give the object whose own mesh went into a run the maps of that run.

    The report of the run that made its shape is kept as `shape_report`.

    Raises:
        ArmError: the object is gone, or its mesh is another one by now.
        ValueError: no mesh went into the run.
    """
    if wanted.mesh is None:
        raise ValueError("a new appearance needs the mesh that it is for")
    name = wanted.mesh.name
    shown = bpy.data.objects.get(name)
    if shown is None or shown.type != "MESH":
        raise ArmError(f"{name}: was removed or renamed while its appearance was made; generate it anew")
    if len(shown.data.loops) - 2 * len(shown.data.polygons) != len(wanted.mesh.faces):  # Its triangles.
        raise ArmError(f"{name}: its mesh was changed while its appearance was made; regenerate it once more")
    first = stored_record(shown)
    kept = replace(wanted.record(first.frame), mesh=first.mesh, shape_report=first.shape_report or first.report)
    replace_maps(shown, made.asset.maps, _kept(made, kept))
    if shown.asset_data is not None:
        mark_as_asset(shown, made.asset)
    return shown


def _kept(made: Generated, record: AssetRecord) -> dict[str, Any]:
    """A record with what made the result."""
    versions = {"arm": VERSION, "blender": bpy.app.version_string, "torch": str(torch.__version__)}
    return replace(record, report=made.report.as_dict(), versions=versions).as_json(blend_folder())
