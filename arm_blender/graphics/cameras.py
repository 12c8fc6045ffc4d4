"""Pinhole cameras: projection, rays, and the rigid motions between frames."""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor


@dataclass(frozen=True)
class Camera:
    """One pinhole camera without distortion.

    Attributes:
        c2w: (4, 4) float32, camera to world, OpenGL axes (looks along -Z, +Y up); rigid.
        K: (3, 3) float32, intrinsics in pixels, pixel centres at +0.5, row 0 on top.
        width: pixels.
        height: pixels.
    """

    c2w: Tensor
    K: Tensor
    width: int
    height: int

    def __post_init__(self) -> None:
        if self.c2w.shape != (4, 4) or self.K.shape != (3, 3):
            raise ValueError(f"c2w must be (4, 4) and K (3, 3), got {tuple(self.c2w.shape)}, {tuple(self.K.shape)}")

    @property
    def center(self) -> Tensor:
        """(3,) world position of the pinhole."""
        return self.c2w[:3, 3]

    @property
    def w2c(self) -> Tensor:
        """(4, 4) world to camera."""
        rotation = self.c2w[:3, :3].T
        w2c = torch.eye(4, dtype=self.c2w.dtype, device=self.c2w.device)
        w2c[:3, :3] = rotation
        w2c[:3, 3] = -rotation @ self.center
        return w2c

    @property
    def fovy(self) -> float:
        """Vertical field of view, radians."""
        return 2.0 * math.atan(self.height / (2.0 * float(self.K[1, 1])))

    def to(self, device: torch.device | str) -> "Camera":
        """The same on another device."""
        return replace(self, c2w=self.c2w.to(device), K=self.K.to(device))

    def resized(self, width: int, height: int) -> "Camera":
        """The same camera with another number of pixels."""
        scale = torch.tensor([width / self.width, height / self.height, 1.0], dtype=self.K.dtype, device=self.K.device)
        return replace(self, K=self.K * scale[:, None], width=width, height=height)


def intrinsics_from_fovy(fovy: float, width: int, height: int) -> Tensor:
    """(3, 3) K in pixels with square pixels and a centred principal point; `fovy` in radians."""
    focal = height / (2.0 * math.tan(fovy / 2.0))
    return torch.tensor([[focal, 0.0, width / 2.0], [0.0, focal, height / 2.0], [0.0, 0.0, 1.0]])


def look_at(eye: Tensor, target: Tensor | None = None) -> Tensor:
    """(4, 4) c2w of a camera at `eye` (3,) that looks at `target` (the origin by default) with world Z up."""
    target = torch.zeros(3) if target is None else target
    back = torch.nn.functional.normalize(eye - target, dim=0)
    up = torch.tensor([0.0, 0.0, 1.0])
    if abs(float(back[2])) > 0.9999:  # Straight from above or below: any right vector will do; Blender takes +X.
        up = torch.tensor([0.0, 1.0, 0.0])
    right = torch.nn.functional.normalize(torch.linalg.cross(up, back), dim=0)
    c2w = torch.eye(4)
    c2w[:3, :3] = torch.stack([right, torch.linalg.cross(back, right), back], dim=1)
    c2w[:3, 3] = eye
    return c2w


def orbit_camera(
    azimuth_deg: float, elevation_deg: float, distance: float, fovy_deg: float, width: int, height: int
) -> Camera:
    """A camera on a sphere around the origin that looks at it.

    Azimuth 0 lies on -Y (Blender's front) and grows counter-clockwise seen from above.
    """
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    eye = distance * torch.tensor(
        [
            math.sin(azimuth) * math.cos(elevation),
            -math.cos(azimuth) * math.cos(elevation),
            math.sin(elevation),
        ]
    )
    return Camera(look_at(eye), intrinsics_from_fovy(math.radians(fovy_deg), width, height), width, height)


def front_on_x(coordinates: Tensor, dim: int) -> Tensor:
    """World coordinates in a frame whose front is +X instead of -Y: a quarter turn about Z.

    Args:
        coordinates: x, y, z and whatever follows them along `dim`; of c2w the rows (-2), of points the last dimension.
    """
    x, y, *others = coordinates.unbind(dim)
    return torch.stack([-y, x, *others], dim=dim)


def project(points: Tensor, camera: Camera) -> tuple[Tensor, Tensor]:
    """Pixel coordinates and depth of world points.

    Args:
        points: (..., 3) world.
    Returns:
        (..., 2) pixel coordinates (x right, y down) and (...,) depth along the view axis. Points at or behind the
        pinhole keep their non-positive depth; their pixel coordinates are finite and meaningless.
    """
    local = points @ camera.w2c[:3, :3].T + camera.w2c[:3, 3]
    depth = -local[..., 2]
    safe = torch.where(depth.abs() < 1e-8, torch.full_like(depth, 1e-8), depth)
    return image_points(local, safe, camera.K), depth


def image_points(local: Tensor, depth: Tensor, K: Tensor) -> Tensor:
    """(..., 2) pixels of points (..., 3) in a camera's frame, at a `depth` (...,) that is not 0; K is (..., 3, 3)."""
    x = K[..., 0, 0] * local[..., 0] / depth + K[..., 0, 2]
    y = K[..., 1, 2] - K[..., 1, 1] * local[..., 1] / depth
    return torch.stack([x, y], dim=-1)


def unproject(pixels: Tensor, depth: Tensor, camera: Camera) -> Tensor:
    """(..., 3) world points at pixel coordinates (..., 2) and depths (...,) along the view axis; undoes `project`."""
    x = (pixels[..., 0] - camera.K[0, 2]) / camera.K[0, 0] * depth
    y = (camera.K[1, 2] - pixels[..., 1]) / camera.K[1, 1] * depth
    return torch.stack([x, y, -depth], dim=-1) @ camera.c2w[:3, :3].T + camera.center


def view_directions(points: Tensor, camera: Camera) -> Tensor:
    """(..., 3) unit vectors from world `points` (..., 3) towards the camera."""
    return directions_to(camera.center, points)


def directions_to(eye: Tensor, points: Tensor) -> Tensor:
    """(..., 3) unit vectors towards `eye` (3,) from `points` (..., 3); zero at the eye itself."""
    towards = eye - points
    x, y, z = towards.unbind(dim=-1)  # A reduction over three numbers takes torch several times as long.
    return towards / (x.square() + y.square() + z.square()).sqrt().clamp(min=1e-12)[..., None]
