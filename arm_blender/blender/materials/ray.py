"""Which region of an object lies under a ray."""

import bpy
from mathutils import Vector
from mathutils.geometry import barycentric_transform, intersect_point_tri

from ..asset.regions import number_of, regions_image


def region_under(
    shown: bpy.types.Object, depsgraph: bpy.types.Depsgraph, origin: Vector, direction: Vector
) -> int | None:
    """The region that a ray meets first on an object, with its modifiers; others do not hide it.

    Args:
        origin, direction: world.
    Returns:
        its number, 0 where the surface is of no region, None where the ray misses.
    """
    evaluated = shown.evaluated_get(depsgraph)
    inverse = evaluated.matrix_world.inverted_safe()
    start = inverse @ origin
    towards = (inverse.to_3x3() @ direction).normalized()
    hit, place, _, polygon = evaluated.ray_cast(start, towards)
    if not hit:
        return None
    uv = _uv_at(evaluated.data, polygon, place)
    image = regions_image(shown.active_material)
    if uv is None or image is None or 0 in image.size:
        return 0
    width, height = image.size
    column, row = int(uv.x % 1.0 * width), int(uv.y % 1.0 * height)
    first = (min(row, height - 1) * width + min(column, width - 1)) * image.channels
    return number_of(image.pixels[first])


def _uv_at(mesh: bpy.types.Mesh, polygon: int, place: Vector) -> Vector | None:
    """(u, v, 0) of a point of a polygon; None where the mesh has no UV map."""
    layer = mesh.uv_layers.active
    if layer is None:
        return None
    corners = mesh.polygons[polygon].loop_indices
    points = [mesh.vertices[mesh.loops[corner].vertex_index].co for corner in corners]
    uvs = [layer.uv[corner].vector.to_3d() for corner in corners]
    fan = range(1, len(points) - 1)
    inside = (i for i in fan if intersect_point_tri(place, points[0], points[i], points[i + 1]) is not None)
    i = next(inside, 1)
    return barycentric_transform(place, points[0], points[i], points[i + 1], uvs[0], uvs[i], uvs[i + 1])
