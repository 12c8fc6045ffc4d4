"""What becomes of a run's result in the open file."""

from dataclasses import replace

import bpy
import torch

from ...errors import ArmError
from ...version import VERSION
from ...views.placement import on_the_ground
from ...views.scene_frame import IDENTITY, SceneFrame
from ..asset.asset_preview import mark_as_asset
from ..asset.scene import build_object, replace_maps
from ..input.generation_request import GenerationRequest
from ..input.request import stored_settings
from .generation import Generated


def add_result(context: bpy.types.Context, made: Generated, wanted: GenerationRequest) -> bpy.types.Object:
    """Add the result as a new object, placed as the panel says; an own mesh's stays where that mesh is.

    The object carries, besides what `build_object` keeps, `arm_frame`: scale and centre that bring its own coordinates
    into the frame of the views' cameras.
    """
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
    created = build_object(asset, _settings(made, wanted))
    created.location = location
    created["arm_frame"] = [frame.scale, *frame.center.tolist()]
    if settings.as_asset:
        mark_as_asset(created, asset)
    return created


def renew_appearance(name: str, made: Generated, wanted: GenerationRequest) -> None:
    """Give the object `name` the maps of a run that its own mesh went into.

    The report of the run that made its shape is kept as `shape_report`.

    Raises:
        ArmError: the object is gone, or its mesh is another one by now.
    """
    shown = bpy.data.objects.get(name)
    if shown is None or shown.type != "MESH":
        raise ArmError(f"{name}: was removed or renamed while its appearance was made; generate it anew")
    if len(shown.data.loops) - 2 * len(shown.data.polygons) != len(wanted.mesh.faces):  # Its triangles.
        raise ArmError(f"{name}: its mesh was changed while its appearance was made; regenerate it once more")
    kept = stored_settings(shown)
    first = {"mesh": kept.get("mesh"), "shape_report": kept.get("shape_report", kept.get("report"))}
    replace_maps(shown, made.asset.maps, _settings(made, wanted) | first)
    if shown.asset_data is not None:
        mark_as_asset(shown, made.asset)


def _settings(made: Generated, wanted: GenerationRequest) -> dict[str, object]:
    versions = {"arm": VERSION, "blender": bpy.app.version_string, "torch": str(torch.__version__)}
    return wanted.as_settings() | {"report": made.report.as_dict(), "versions": versions}
