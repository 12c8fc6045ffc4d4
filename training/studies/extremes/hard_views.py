"""Views that are few, alike, or against each other: what the pipeline makes of a ball that they show."""

from collections.abc import Iterator
from dataclasses import replace

import torch

from arm_blender.config import PRESETS
from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.raster.rasterize import rasterize, rasterize_views
from arm_blender.graphics.surface.isosurface import extract
from arm_blender.graphics.surface.sample_grid import IsosurfaceConfig
from arm_blender.models.network_views import network_views
from arm_blender.models.small.volume_georm import VolumeGeoRM
from arm_blender.structures import ViewSet
from arm_blender.uv.backproject import backproject
from arm_blender.uv.blend import blend
from arm_blender.uv.decimate import clean
from arm_blender.uv.texels import texel_map
from arm_blender.uv.unwrap import UnwrapConfig, unwrap

from ...documents import Row
from .ball import RADIUS, VOLUME, ball, open_edges, volume
from .precision import built


@torch.no_grad()
def strange_views() -> Iterator[Row]:
    """`small` on views of a ball that are few, alike, against each other, or taken from where no camera should be."""
    mesh = extract(lambda p: ball(p, 10.0, 10.0), IsosurfaceConfig(resolution=48))
    rig = tuple(orbit_camera(60.0 * k, (20.0, -10.0)[k % 2], 6.0, 30.0, 160, 160) for k in range(6))
    masks = torch.stack([rasterize(mesh.vertices, mesh.faces, camera).mask for camera in rig]).float()
    six = torch.cat([torch.full((6, 3, 160, 160), 0.3), masks[:, None]], dim=1)
    full = torch.cat([torch.full((1, 3, 160, 160), 0.3), torch.ones(1, 1, 160, 160)], dim=1)
    moved, black, white = six.clone(), six.clone(), six.clone()
    moved[0, 3] = masks[0].roll(16, dims=1)
    black[:, :3], white[:, :3] = 0.0, 1.0
    touching, inside = (orbit_camera(0.0, 0.0, distance, 60.0, 160, 160) for distance in (RADIUS + 0.01, 0.2))
    every = [k % 6 for k in range(16)]
    cases = {
        "six views": (six, rig),
        "six views of a black ball": (black, rig),
        "six views of a white ball": (white, rig),
        "one view": (six[:1], rig[:1]),
        "the same view six times": (six[[0] * 6], rig[:1] * 6),
        "sixteen views, most of them twice or thrice": (six[every], tuple(rig[k] for k in every)),
        "one of six masks moved by a tenth of the picture": (moved, rig),
        "a seventh camera, 0.01 from the surface": (torch.cat([six, full]), (*rig, touching)),
        "a seventh camera inside of the ball": (torch.cat([six, full]), (*rig, inside)),
    }
    georm, config = built("georm", PRESETS["small"].georm, True), IsosurfaceConfig(64, iso=0.0, chunk=2**14)
    assert isinstance(georm, VolumeGeoRM)  # As the preset says.
    for name, (images, cameras) in cases.items():
        views = ViewSet(images, cameras, torch.ones(len(cameras)), "ball")
        encoded = georm.encode(network_views(views, georm.config))
        sparse, dense = (
            extract(georm.filled_logit(encoded, config.chunk), replace(config, dense=dense)) for dense in (False, True)
        )
        shape = clean(sparse)
        drawn = rasterize_views(shape.vertices, shape.faces, cameras).mask
        alike = float((drawn & (images[:, 3] > 0)).sum() / (drawn | (images[:, 3] > 0)).sum())
        yield (
            f"{name}, through GeoRM at 64³",
            "volume over the ball's; overlap of the shape's outlines and the masks (IoU); open edges; faces that the "
            "sparse iso-surface has not and the dense one has",
            f"{volume(shape) / VOLUME:.2f}; {alike:.3f}; {open_edges(shape)}; "
            f"{len(dense.faces) - len(sparse.faces)} of {len(dense.faces):,}",
        )


def conflicting_views() -> Iterator[Row]:
    """Six views of a green ball, of which some say that it is red."""
    mesh, _ = unwrap(extract(lambda p: ball(p, 10.0, 10.0), IsosurfaceConfig(resolution=24)), UnwrapConfig())
    texels = texel_map(mesh, 128)
    cameras = tuple(orbit_camera(60.0 * k, (20.0, -10.0)[k % 2], 6.0, 30.0, 160, 160) for k in range(6))
    masks = torch.stack([rasterize(mesh.vertices, mesh.faces, camera).mask for camera in cameras]).float()
    for wrong in range(4):
        images = torch.zeros(6, 4, 160, 160)
        images[:wrong, 0], images[wrong:, 1], images[:, 3] = 1.0, 1.0, masks
        seen = backproject(mesh, texels, ViewSet(images, cameras, torch.ones(6), "ball"))
        color, _ = blend(seen, torch.ones(6))
        red, green = seen.visibility[:wrong].sum(dim=0), seen.visibility[wrong:].sum(dim=0)
        decided = (red + green >= 3) & (red != green)
        agrees = (color[1] > color[0]) == (green > red)
        yield (
            f"{wrong} of 6 views show another colour",
            "texels that three or more views see; share of them with the colour of most of their views",
            f"{int(decided.sum()):,}; {agrees[decided].float().mean().item():.3f}",
        )
