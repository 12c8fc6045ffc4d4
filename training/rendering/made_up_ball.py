"""A ball in closed form, as the renderer would leave it: for trying what learns from shards where there are none."""

from pathlib import Path

import torch
import trimesh
from torch import Tensor

from arm_blender.graphics.cameras import orbit_camera

from ..volume_rendering import pixel_rays
from .shards import Arrays, save_arrays

VIEWS = 10


def ball_views(radius: float, center: Tensor, size: int) -> Arrays:
    """A ball seen from ten sides; its upper half is metal.

    Args:
        radius: of the ball, which lies in the box from -1 to 1.
        center: (3,).
        size: pixels a side.
    Returns:
        The arrays of a `rig_<k>.npz`, see `shards`.
    """
    cameras = [orbit_camera(36.0 * i, 40.0 * (i % 3 - 1), 4.0, 35.0, size, size) for i in range(VIEWS)]
    c2w, K = torch.stack([c.c2w for c in cameras]), torch.stack([c.K for c in cameras])
    row, column = torch.meshgrid(torch.arange(size) + 0.5, torch.arange(size) + 0.5, indexing="ij")
    rays = pixel_rays(torch.stack([column, row], dim=-1).flatten(0, 1).expand(VIEWS, -1, -1), c2w, K)
    middle = ((center - rays.origins) * rays.directions).sum(dim=-1)
    inside = radius**2 - (rays.origins + middle[..., None] * rays.directions - center).square().sum(dim=-1)
    distance = middle - inside.clamp(min=0.0).sqrt()
    normal = (rays.origins + distance[..., None] * rays.directions - center) / radius
    cosine = (rays.directions * -c2w[:, None, :3, 2]).sum(dim=-1)
    mask = inside > 0.0
    shape = (VIEWS, size, size)
    rgba = torch.cat([torch.full((*mask.shape, 3), 150), mask[..., None] * 255], dim=-1)
    return {
        "rgba": rgba.view(*shape, 4).to(torch.uint8).numpy(),
        "albedo": rgba.view(*shape, 4)[..., :3].to(torch.uint8).numpy(),
        "depth": torch.where(mask, distance * cosine, torch.inf).view(shape).half().numpy(),
        "roughness": (mask * 60).view(shape).to(torch.uint8).numpy(),
        "metallic": (mask * (normal[..., 2] > 0.0) * 255).view(shape).to(torch.uint8).numpy(),
        "normal": (torch.where(mask[..., None], normal, 0.0) * 127.0).view(*shape, 3).to(torch.int8).numpy(),
        "c2w": c2w.numpy(),
        "K": K.numpy(),
    }


def write_ball(folder: Path, radius: float, center: tuple[float, float, float], size: int) -> None:
    """One object of shards: `mesh.npz` and `rig_0.npz`."""
    sphere = trimesh.creation.icosphere(subdivisions=2)
    vertices = radius * torch.from_numpy(sphere.vertices.copy()).float() + torch.tensor(center)
    folder.mkdir(parents=True, exist_ok=True)
    save_arrays(folder / "mesh.npz", {"vertices": vertices.numpy(), "faces": sphere.faces})
    save_arrays(folder / "rig_0.npz", ball_views(radius, torch.tensor(center), size))
