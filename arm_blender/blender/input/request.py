"""From the panel's settings, or from those that a result was made with, to a request."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy

from ...asset_record import AssetRecord, read_record
from ...errors import ArmError
from ...knobs import Knobs, ViewKnobs
from ...knobs.finishes import words_of
from ..asset.finish_nodes import finishes
from ..asset.regions import known_regions
from ..setup import runtime
from .generation_request import CameraPicture, GenerationRequest
from .panel_knobs import panel_values


def from_panel(context: bpy.types.Context, filepath: str = "") -> GenerationRequest:
    """What the panel asks for.

    Args:
        context: its scene holds the settings; the active object is the mesh, where one is wanted.
        filepath: views instead of those that the panel names.
    Raises:
        ArmError: no views are chosen, or the selected mesh or the cameras do not do.
    """
    settings = context.scene.arm
    wanted = views_from_panel(context, filepath)
    if settings.shape == "MESH":
        from .own_mesh import selected_mesh

        mesh = selected_mesh(context)
        wanted = replace(wanted, mesh=mesh, name=mesh.name)
    return replace(
        wanted,
        weights=panel_weights(context, wanted),
        **panel_values(settings, Knobs),
        **_machine(),
    )


def views_from_panel(context: bpy.types.Context, filepath: str = "") -> GenerationRequest:
    """The part of a request that says which views there are.

    Raises:
        ArmError: none are chosen, or a camera does not do.
    """
    settings = context.scene.arm
    if settings.source == "CAMERAS" and not filepath:
        listed = settings.views_of == cameras_key(context) and [view.name for view in settings.views]
        return GenerationRequest(_cameras(context, listed or None), name=context.scene.name)
    chosen = filepath or settings.views_path
    if not chosen:
        raise ArmError("Choose pictures first, or press Example")
    return GenerationRequest(Path(bpy.path.abspath(chosen)), **panel_values(settings, ViewKnobs))


def panel_weights(context: bpy.types.Context, request: GenerationRequest) -> tuple[float, ...] | None:
    """The ticks and weights of the panel's list, where it is that of the request's views; else None."""
    settings = context.scene.arm
    if settings.views_kind == "photographs":  # Which become fewer views.
        return None
    if not len(settings.views) or settings.views_of != views_key(context, request):
        return None
    return tuple(view.weight if view.use else 0.0 for view in settings.views)


def views_key(context: bpy.types.Context, request: GenerationRequest) -> str:
    """What the panel's list is known by, to be the list of a request's views."""
    return path_key(str(request.views)) if isinstance(request.views, Path) else cameras_key(context)


def path_key(path: str) -> str:
    """As `views_key`, of files; a folder's slash at the end, and `//` for that of the .blend, do not matter."""
    return str(Path(bpy.path.abspath(path)))


def cameras_key(context: bpy.types.Context) -> str:
    """As `views_key`, of the cameras of the scene."""
    return f"cameras of {context.scene.name}"


def from_result(context: bpy.types.Context) -> GenerationRequest:
    """The request that the active object answered, for its appearance alone: its mesh stays.

    Ticks and weights are those of the panel where it lists the same views, else those of the first time.

    Raises:
        ArmError: the object is no result, its mesh or its cameras do not do, or its settings cannot be read.
    """
    from .own_mesh import mesh_of_result

    shown = context.object
    kept = stored_record(shown) if shown is not None and "arm_settings" in shown else AssetRecord({})
    mesh = mesh_of_result(context, kept.frame)  # Which refuses what is no result.
    views: Path | tuple[CameraPicture, ...] = kept.views or _cameras(context, kept.cameras)
    wanted = GenerationRequest(views, name=mesh.name, mesh=mesh, mesh_in_place=True, **kept.chosen, **_machine())
    return replace(wanted, weights=panel_weights(context, wanted) or wanted.weights)


def stored_record(made: bpy.types.Object) -> AssetRecord:
    """What a result says of how it was made, whichever version and whoever made it, and what is set of its regions now.

    Raises:
        ArmError: it says nothing that can be read.
    """
    kept = read_record(made.name, made.get("arm_settings"), blend_folder(made.library), made.get("arm_frame"))
    material = made.active_material
    if material is None or not known_regions(material).regions:
        return kept
    return replace(kept, chosen=kept.chosen | {"finish": words_of(finishes(material)) or None})


def blend_folder(library: bpy.types.Library | None = None) -> Path | None:
    """The folder of the open .blend, or of the one that something is linked from; None before it is saved."""
    saved = bpy.data.filepath if library is None else bpy.path.abspath(library.filepath)
    return Path(saved).parent if saved else None


def _cameras(context: bpy.types.Context, names: Iterable[str] | None) -> tuple[CameraPicture, ...]:
    from .scene_cameras import camera_pictures

    return camera_pictures(context.scene, context.evaluated_depsgraph_get(), names)


def _machine() -> dict[str, Any]:
    """The fields of a request that are this machine's, and not kept with a result."""
    return {"device": runtime.device(), "threads": runtime.threads()}
