"""A ball with white dots before a plain wall, photographed through lenses whose formulas stand here once more.

The formulas are those of https://colmap.github.io/cameras.html, written down independently of any library.
"""

import math
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from arm_blender.graphics.cameras import look_at
from arm_blender.photographs.capture import Capture, Lens, PosedPhotograph

WIDTH, HEIGHT = 320, 240
RADIUS = 0.6
DOT = 0.06
"""Radius of a dot, radians of the ball."""

LENSES = {
    "SIMPLE_PINHOLE": (300.0, 158.0, 123.0),
    "PINHOLE": (300.0, 310.0, 158.0, 123.0),
    "SIMPLE_RADIAL": (300.0, 158.0, 123.0, -0.2),
    "RADIAL": (300.0, 158.0, 123.0, -0.25, 0.1),
    "OPENCV": (300.0, 310.0, 158.0, 123.0, -0.25, 0.1, 0.004, -0.006),
    "FULL_OPENCV": (300.0, 310.0, 158.0, 123.0, -0.25, 0.1, 0.004, -0.006, 0.02, 0.01, 0.0, 0.0),
    "OPENCV_FISHEYE": (260.0, 265.0, 158.0, 123.0, 0.05, -0.02, 0.01, 0.0),
    "SIMPLE_RADIAL_FISHEYE": (260.0, 158.0, 123.0, 0.05),
}


def lens(model: str) -> Lens:
    return Lens(model, LENSES[model], WIDTH, HEIGHT)


def dots(count: int = 60) -> np.ndarray:
    """(N, 3) unit, spread over the ball (a golden spiral)."""
    index = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * index / count, math.pi * (1.0 + math.sqrt(5.0)) * index
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)


def distorted(x: np.ndarray, y: np.ndarray, one: Lens) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of the rays whose tangents are `x` and `y` (down)."""
    parameters = list(one.parameters)
    single = one.model.startswith("SIMPLE") or one.model.startswith("RADIAL")
    focal_x, focal_y = (parameters[0], parameters[0]) if single else parameters[:2]
    center_x, center_y, *bends = parameters[1:] if single else parameters[2:]
    r2 = x * x + y * y
    if one.model.endswith("FISHEYE"):
        r = np.sqrt(r2)
        theta = np.arctan(r)
        bent = theta * (1.0 + sum(k * theta ** (2 * power + 2) for power, k in enumerate(bends)))
        scale = np.where(r > 1e-9, bent / np.maximum(r, 1e-9), 1.0)
        return focal_x * x * scale + center_x, focal_y * y * scale + center_y
    k1, k2, p1, p2, k3, k4, k5, k6 = [*bends, *[0.0] * 8][:8]
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    bent_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return focal_x * bent_x + center_x, focal_y * bent_y + center_y


def rays(one: Lens) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) tangents of the rays of all pixels: `distorted` undone by fixed-point iteration."""
    column, row = np.meshgrid(np.arange(one.width) + 0.5, np.arange(one.height) + 0.5)
    focal = one.parameters[0]
    x, y = (column - one.width / 2) / focal, (row - one.height / 2) / focal
    for _ in range(60):
        u, v = distorted(x, y, one)
        x, y = x + 0.7 * (column - u) / focal, y + 0.7 * (row - v) / focal
    return x, y


def photograph(c2w: np.ndarray, one: Lens, blur: int = 0, supersampled: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) uint8 sRGB of the ball, and (H, W) uint8, its mask."""
    fine = Lens(one.model, one.parameters, one.width, one.height)
    x, y = rays(fine)
    colors, masks = [], []
    offsets = (np.arange(supersampled) + 0.5) / supersampled - 0.5
    step_x, step_y = np.gradient(x, axis=1), np.gradient(y, axis=0)
    for dx in offsets:
        for dy in offsets:
            color, mask = _cast(c2w, x + dx * step_x, y + dy * step_y)
            colors.append(color)
            masks.append(mask)
    color, mask = np.mean(colors, axis=0), np.mean(masks, axis=0)
    for _ in range(blur):
        color = (color + np.roll(color, 1, 1) + np.roll(color, -1, 1)) / 3.0
    return (color * 255 + 0.5).astype(np.uint8), (mask * 255 + 0.5).astype(np.uint8)


def orbit(count: int, distance: float = 3.0, elevations_deg: tuple[float, ...] = (10.0, 40.0)) -> list[np.ndarray]:
    """(4, 4) c2w on rings around the ball, not quite aimed at its middle."""
    poses = []
    for index in range(count):
        ring = index % len(elevations_deg)
        turn = 2 * math.pi * (index + 0.3 * ring) / count
        lift = math.radians(elevations_deg[ring])
        eye = distance * torch.tensor(
            [math.cos(turn) * math.cos(lift), math.sin(turn) * math.cos(lift), math.sin(lift)]
        )
        target = 0.03 * torch.tensor([math.sin(3.0 * index), math.cos(5.0 * index), 0.0])
        poses.append(look_at(eye, target).double().numpy())
    return poses


def write_capture(
    folder: Path, poses: list[np.ndarray], one: Lens, blurred: tuple[int, ...] = (), masks: bool = False
) -> Capture:
    """Photographs in `folder`, posed, with files of their masks or without; and no points."""
    folder.mkdir(parents=True, exist_ok=True)
    posed = []
    for index, c2w in enumerate(poses):
        path = folder / f"IMG_{index:04d}.png"
        color, alpha = photograph(c2w, one, 12 if index in blurred else 0)
        Image.fromarray(color).save(path)
        mask = path.with_suffix(".mask.png") if masks else None
        if mask is not None:
            Image.fromarray(alpha).save(mask)
        posed.append(PosedPhotograph(path, torch.tensor(c2w), one, mask))
    return Capture(tuple(posed), torch.zeros(0, 3, dtype=torch.float64))


def _cast(c2w: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """sRGB colours and hits of rays with tangents `x`, `y` (down) from a camera."""
    rotation, eye = c2w[:3, :3], c2w[:3, 3]
    local = np.stack([x, -y, -np.ones_like(x)], axis=-1)
    direction = local @ rotation.T
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    along = direction @ eye
    depth = along**2 - (eye @ eye - RADIUS**2)
    hit = depth > 0
    point = (eye + direction * (-along - np.sqrt(np.maximum(depth, 0.0)))[..., None]) / RADIUS
    dotted = (point @ dots().T).max(-1) > math.cos(DOT)
    color = np.where(dotted[..., None], [1.0, 1.0, 1.0], [0.55, 0.1, 0.08])
    return np.where(hit[..., None], color, [0.6, 0.62, 0.6]), hit
