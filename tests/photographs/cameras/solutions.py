"""Solutions whose truth is known: cameras around a box that is given by its masks and by points."""

import math

import torch

from arm_blender.photographs.cameras.solver import Solution
from arm_blender.photographs.capture import Lens

WIDTH, HEIGHT, FOCAL = 240, 180, 200.0
LENS = Lens("SIMPLE_RADIAL", (FOCAL, WIDTH / 2, HEIGHT / 2, 0.0), WIDTH, HEIGHT)


def w2c_ring(count: int, elevation: float = 0.5, distance: float = 4.0) -> torch.Tensor:
    """(count, 4, 4) float64, OpenCV axes, around the origin of a world whose Z is up."""
    found = []
    for index in range(count):
        azimuth = 2.0 * math.pi * index / count
        eye = torch.tensor(
            [math.cos(azimuth) * math.cos(elevation), math.sin(azimuth) * math.cos(elevation), math.sin(elevation)]
        ).double()
        forward = -eye
        right = torch.nn.functional.normalize(torch.linalg.cross(forward, forward.new_tensor([0.0, 0.0, 1.0])), dim=0)
        rotation = torch.stack([right, torch.linalg.cross(forward, right), forward])
        w2c = torch.eye(4, dtype=torch.float64)
        w2c[:3, :3], w2c[:3, 3] = rotation, -rotation @ (distance * eye)
        found.append(w2c)
    return torch.stack(found)


def pixels(w2c: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    """(P, 2) of points (P, 3) in one camera."""
    local = points @ w2c[:3, :3].T + w2c[:3, 3]
    return FOCAL * local[:, :2] / local[:, 2:] + torch.tensor([WIDTH / 2, HEIGHT / 2], dtype=torch.float64)


def box(half: tuple[float, float, float], samples: int = 30) -> torch.Tensor:
    """(P, 3) samples of a solid box around the origin."""
    axes = [torch.linspace(-side, side, samples, dtype=torch.float64) for side in half]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1).view(-1, 3)


def masks_of(w2c: torch.Tensor, solid: torch.Tensor) -> list[torch.Tensor]:
    """(HEIGHT, WIDTH) float of each camera."""
    masks = []
    for one in w2c:
        at = pixels(one, solid).long()
        inside = (at[:, 0] >= 0) & (at[:, 1] >= 0) & (at[:, 0] < WIDTH) & (at[:, 1] < HEIGHT)
        mask = torch.zeros(HEIGHT, WIDTH)
        mask[at[inside, 1], at[inside, 0]] = 1.0
        masks.append(torch.nn.functional.max_pool2d(mask[None], 3, stride=1, padding=1)[0])
    return masks


def solution(w2c: torch.Tensor, points: torch.Tensor, allowed: float = 1.0) -> Solution:
    """Cameras that see all `points`, with 100 matches in every two pictures, of which the share `allowed` fits."""
    count = len(w2c)
    seen = torch.cat(
        [
            torch.cat(
                [
                    torch.full((len(points), 1), float(index)).double(),
                    torch.arange(len(points)).double()[:, None],
                    pixels(one, points),
                ],
                dim=1,
            )
            for index, one in enumerate(w2c)
        ]
    )
    pairs = [[a, b, 100.0, 100.0 * allowed] for a in range(count) for b in range(a)]
    names = tuple(f"{index:04d}.png" for index in range(count))
    return Solution(names, w2c, (LENS,) * count, points, seen, torch.tensor(pairs).double(), 0.5)
