"""Seconds of the rasteriser: pictures and atlases, beside plain enumeration of bounding boxes.

python -m benchmarks.bench_rasterize [--threads N]
"""

import torch
import trimesh
from torch import Tensor

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.raster.rasterize import rasterize, rasterize_uv, rasterize_views
from arm_blender.uv.unwrap import UnwrapConfig, unwrap
from training.documents import markdown_table, paragraphs

from .measure import Section, median_seconds, run
from .shapes import wavy_ball

ATLAS_FACES = 20_000


def bounding_boxes(uvs: Tensor, face_uvs: Tensor, size: int) -> Tensor:
    """(size, size) int32 faces of an atlas, by trying every texel of every bounding box: the plain way."""
    corner = uvs[face_uvs] * size
    low, high = corner.amin(dim=1).floor().long(), corner.amax(dim=1).ceil().long()
    extent = (high - low).clamp(min=1)
    counts = extent.prod(dim=1)
    face = torch.repeat_interleave(counts)
    local = torch.arange(len(face)) - (counts.cumsum(0) - counts)[face]
    texel = low[face] + torch.stack([local % extent[face, 0], local // extent[face, 0]], dim=1)
    center, corner = texel + 0.5, corner[face]
    turn = []
    for k in range(3):
        side, offset = corner[:, (k + 1) % 3] - corner[:, k], center - corner[:, k]
        turn.append(side[:, 0] * offset[:, 1] - side[:, 1] * offset[:, 0])
    inside = torch.stack(turn).amin(dim=0) >= 0.0
    result = torch.full((size, size), -1, dtype=torch.int32)
    result[texel[inside, 1].clamp(0, size - 1), texel[inside, 0].clamp(0, size - 1)] = face[inside].int()
    return result


def pictures() -> list[list[object]]:
    """Rows of meshes in views."""
    rows = []
    for subdivisions, size in ((5, 512), (7, 512), (7, 1024)):
        sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
        vertices, faces = torch.tensor(sphere.vertices, dtype=torch.float32), torch.tensor(sphere.faces)
        vertices = vertices * (0.8 + 0.1 * torch.sin(12.0 * vertices).prod(dim=1, keepdim=True))
        cameras = [orbit_camera(60.0 * i, 20.0, 4.0, 30.0, size, size) for i in range(6)]
        alone = median_seconds(lambda v=vertices, f=faces, c=cameras[0]: rasterize(v, f, c))
        together = median_seconds(lambda v=vertices, f=faces, c=cameras: rasterize_views(v, f, c), 3) / 6
        rows.append([f"{len(faces):,}", f"{size}²", f"{alone:.3f}", f"{together:.3f}"])
    return rows


def atlases() -> list[list[object]]:
    """Rows of atlases."""
    atlas, _ = unwrap(wavy_ball(ATLAS_FACES), UnwrapConfig())
    rows = []
    for size in (1024, 2048):
        ours = median_seconds(lambda s=size: rasterize_uv(atlas.uvs, atlas.face_uvs, s))
        boxes = median_seconds(lambda s=size: bounding_boxes(atlas.uvs, atlas.face_uvs, s))
        rows.append([f"{ATLAS_FACES:,}", f"{size}²", f"{ours:.3f}", f"{boxes:.3f}", f"{boxes / ours:.1f}"])
    return rows


def section() -> Section:
    """The tables as Markdown."""
    views, textures = pictures(), atlases()
    text = paragraphs(
        "## Rasteriser",
        "A bumpy sphere in views, alone and six at once:",
        markdown_table(["triangles", "pixels", "seconds", "seconds a view, six at once"], views),
        "The atlas of the wavy ball. Ours also gives barycentric coordinates and settles ties; *boxes*: every texel of "
        "every triangle's bounding box is tried, in torch as well, for the face alone.",
        markdown_table(["triangles", "texels", "seconds", "boxes s", "times faster"], textures),
    )
    triangles, size, seconds, _ = views[1]
    highlights = [(f"rasterise {triangles} triangles in a view of {size}", f"{seconds} s")]
    for faces, size, seconds, boxes, _ in textures:
        highlights.append((f"rasterise an atlas of {faces} faces at {size}", f"{seconds} s; bounding boxes {boxes} s"))
    return Section(text, highlights)


if __name__ == "__main__":
    run(section, __doc__)
