"""The mesh of an object, copied out of Blender for a run that makes its appearance only."""

from collections.abc import Sequence
from typing import TypeVar

import bpy
import numpy as np
from numpy.typing import NDArray

from ...errors import ArmError, EmptyMeshError
from .generation_request import OwnMesh

MAXIMUM_TRIANGLES = 1_000_000
"""More is refused: what is asked for is a texture, and no view of ours shows a million triangles."""

Number = TypeVar("Number", bound=np.generic)

_FLAT = 1e-12
"""Determinant of an object's matrix, against the cube of its longest axis, below which it has no volume."""


def selected_mesh(context: bpy.types.Context) -> OwnMesh:
    """The active mesh object as it is seen: modifiers applied, in world space, whatever its scale.

    Raises:
        ArmError: another mode than Object, no mesh, no faces, or too many.
    """
    chosen = _object_mode(context)
    evaluated = chosen.evaluated_get(context.evaluated_depsgraph_get())
    matrix = np.array(evaluated.matrix_world)
    determinant = np.linalg.det(matrix[:3, :3])
    if abs(determinant) <= _FLAT * np.abs(matrix[:3, :3]).max() ** 3:
        raise ArmError(f"{chosen.name}: a scale of 0 makes it flat; correct its scale (N panel, Item)")
    mesh = evaluated.to_mesh()
    try:
        own = _arrays(chosen.name, mesh)
    finally:
        evaluated.to_mesh_clear()
    vertices = own.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    origin = tuple(matrix[:3, 3])
    if determinant > 0.0:
        return OwnMesh(own.name, vertices, own.faces, own.corner_uvs, origin)
    mirrored = None if own.corner_uvs is None else own.corner_uvs[:, ::-1]
    # A mirrored object's faces would look inwards.
    return OwnMesh(own.name, vertices, own.faces[:, ::-1], mirrored, origin)


def mesh_of_result(context: bpy.types.Context, frame: Sequence[float] | None) -> OwnMesh:
    """The active object's own mesh, in the frame of the cameras that it was made from.

    Its modifiers do not count: the atlas is that of the mesh itself.

    Args:
        frame: `AssetRecord.frame`; None where the object says none.
    Raises:
        ArmError: another mode than Object, no result of ours, or without its UVs.
    """
    chosen = _object_mode(context)
    if frame is None:
        raise ArmError(f"{chosen.name}: was not made by this panel; choose Selected Mesh to give it an appearance")
    own = _arrays(chosen.name, chosen.data)
    if own.corner_uvs is None:
        raise ArmError(f"{chosen.name}: its UVs are gone; choose Selected Mesh, which makes new ones")
    scale, *center = frame
    return OwnMesh(own.name, own.vertices * scale + np.array(center), own.faces, own.corner_uvs)


def _object_mode(context: bpy.types.Context) -> bpy.types.Object:
    """The active mesh object, ready to be read."""
    chosen = context.object
    if chosen is None or chosen.type != "MESH":
        raise ArmError("No mesh is selected; click one in the 3D view")
    if context.mode != "OBJECT":
        raise ArmError(f"{chosen.name}: is being edited; go back to Object Mode (Tab), then try again")
    return chosen


def _arrays(name: str, mesh: bpy.types.Mesh) -> OwnMesh:
    """Triangles and UVs of a mesh, in its own space."""
    triangles = len(mesh.loops) - 2 * len(mesh.polygons)  # Known before the triangulation, which takes a while.
    if not len(mesh.polygons):
        raise EmptyMeshError(f"{name}: has no faces; select a mesh with a surface")
    if triangles > MAXIMUM_TRIANGLES:
        raise ArmError(f"{name}: {triangles:,} triangles; decimate it to at most {MAXIMUM_TRIANGLES:,} first")
    mesh.calc_loop_triangles()
    vertices = _read(mesh.vertices, "co", 3, np.float32)
    faces = _read(mesh.loop_triangles, "vertices", 3, np.int32)
    layer = next((layer for layer in mesh.uv_layers if layer.active_render), None)
    if layer is None:
        return OwnMesh(name, vertices, faces, None)
    corners = _read(mesh.loop_triangles, "loops", 3, np.int32)
    return OwnMesh(name, vertices, faces, _read(layer.uv, "vector", 2, np.float32)[corners])


def _read(items: bpy.types.bpy_prop_collection, attribute: str, width: int, dtype: type[Number]) -> NDArray[Number]:
    """(N, width) of an attribute."""
    flat = np.empty(len(items) * width, dtype=dtype)
    items.foreach_get(attribute, flat)
    return flat.reshape(-1, width)
