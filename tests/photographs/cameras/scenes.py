"""Photographs of a made-up still life: a painted box and a ball on a painted ground, by casting rays; and the truth."""

import functools
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

SIZE = 480, 360
"""Width and height in pixels."""

FOCAL = 400.0


@functools.cache
def noise(seed: int, side: int = 512) -> np.ndarray:
    """(side, side, 3) a pattern with detail of every size that repeats at its border only."""
    random = np.random.default_rng(seed)
    total = np.zeros((side, side, 3))
    for octave in range(2, 8):
        coarse = random.normal(size=(2**octave, 2**octave, 3))
        image = np.stack(
            [np.asarray(Image.fromarray(coarse[..., c].astype(np.float32)).resize((side, side), 3)) for c in range(3)],
            axis=-1,
        )
        total += image / octave**0.5
    return np.clip(0.5 + 0.22 * total, 0.0, 1.0)


@dataclass(frozen=True)
class StillLife:
    """What stands there.

    Attributes:
        seed: of the patterns.
        tiles: how often the ground's pattern repeats along 8 units; 0 is a plain ground.
        turn: radians by which the things are turned about the vertical.
        half: of the box, along x, y, z; it stands on z = 0.
    """

    seed: int = 0
    tiles: float = 1.0
    turn: float = 0.0
    half: tuple[float, float, float] = (0.6, 0.4, 0.7)

    def turned(self, turn: float) -> "StillLife":
        return replace(self, turn=turn)


def ring(count: int, elevations: tuple[float, ...] = (0.35, 0.7), distance: float = 4.0, seed: int = 0) -> np.ndarray:
    """(count, 4, 4) cameras in OpenGL axes around the things, held by hand."""
    random, cameras = np.random.default_rng(seed), []
    for index in range(count):
        azimuth = 2.0 * math.pi * (index + random.uniform(-0.15, 0.15)) / count
        elevation = elevations[index % len(elevations)] + random.uniform(-0.05, 0.05)
        away = distance * random.uniform(0.9, 1.1)
        eye = away * np.array(
            [math.cos(azimuth) * math.cos(elevation), math.sin(azimuth) * math.cos(elevation), math.sin(elevation)]
        )
        back = eye - np.array([*random.uniform(-0.1, 0.1, 2), 0.5])
        back /= np.linalg.norm(back)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        c2w = np.eye(4)
        c2w[:3] = np.stack([right, np.cross(back, right), back, eye], axis=1)
        cameras.append(c2w)
    return np.stack(cameras)


def photograph(scene: StillLife, c2w: np.ndarray, size=SIZE, focal=FOCAL) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) uint8 picture and (H, W) bool where the things are; two rays a pixel and direction."""
    width, height = size
    x, y = (np.arange(2 * width) + 0.5) / 2, (np.arange(2 * height) + 0.5) / 2
    column, row = np.meshgrid((x - width / 2) / focal, (height / 2 - y) / focal)
    rays = np.stack([column, row, -np.ones_like(row)], axis=-1) @ c2w[:3, :3].T
    color, solid = _shaded(scene, c2w[:3, 3], rays)
    averaged = color.reshape(height, 2, width, 2, 3).mean(axis=(1, 3))
    return (averaged * 255.0).round().astype(np.uint8), solid.reshape(height, 2, width, 2).mean(axis=(1, 3)) > 0.5


def _shaded(scene: StillLife, eye: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colours of rays, and whether each meets a thing."""
    cosine, sine = math.cos(-scene.turn), math.sin(-scene.turn)
    spin = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    box, box_at = _box(scene, spin @ eye, rays @ spin.T)
    ball, ball_at = _ball(scene, spin @ eye, rays @ spin.T)
    with np.errstate(divide="ignore", invalid="ignore"):
        ground_at = np.where(rays[..., 2] < 0.0, -eye[2] / rays[..., 2], np.inf)
    with np.errstate(invalid="ignore"):
        place = eye[:2] + rays[..., :2] * np.where(np.isfinite(ground_at), ground_at, 0.0)[..., None]
    ground = np.full(rays.shape, 0.6)
    if scene.tiles:
        ground = _sampled(noise(scene.seed + 50), place * scene.tiles / 8.0)
    color = np.where((np.isfinite(ground_at) & (np.abs(place) < 4.0).all(axis=-1))[..., None], ground, 0.8)
    solid_at = np.minimum(box_at, ball_at)
    things = np.where((box_at < ball_at)[..., None], box, ball)
    solid = solid_at < ground_at
    return np.where(solid[..., None], things, color), solid


def _sampled(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Bilinear, repeating."""
    side = len(texture)
    at = uv * side - 0.5
    low = np.floor(at).astype(int)
    part = (at - low)[..., None]
    (a, b), (i, j) = np.moveaxis(low % side, -1, 0), np.moveaxis((low + 1) % side, -1, 0)
    u, v = part[..., 0, :], part[..., 1, :]
    top = texture[a, b] * (1 - v) + texture[a, j] * v
    bottom = texture[i, b] * (1 - v) + texture[i, j] * v
    return top * (1 - u) + bottom * u


def _box(scene: StillLife, eye: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    half = np.array(scene.half)
    low, high = np.array([-half[0], -half[1], 0.0]), np.array([half[0], half[1], 2.0 * half[2]])
    with np.errstate(divide="ignore", invalid="ignore"):
        slabs = np.stack([(low - eye) / rays, (high - eye) / rays])
    near, far = slabs.min(axis=0), slabs.max(axis=0).min(axis=-1)
    side, at = near.argmax(axis=-1), near.max(axis=-1)
    hit = (at < far) & (at > 0.0)
    place = eye + rays * np.where(hit, at, 0.0)[..., None]
    color = np.zeros(rays.shape)
    for axis in range(3):
        others = [other for other in range(3) if other != axis]
        for sign in (False, True):
            found = hit & (side == axis) & ((place[..., axis] > (low + high)[axis] / 2) == sign)
            color[found] = _sampled(noise(scene.seed + 10 + 2 * axis + sign), place[found][:, others] / 2.0)
    return color, np.where(hit, at, np.inf)


def _ball(scene: StillLife, eye: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    center, radius = np.array([0.2, -0.65, 0.3]), 0.3
    a, b = (rays**2).sum(axis=-1), (rays * (eye - center)).sum(axis=-1)
    root = b**2 - a * (((eye - center) ** 2).sum() - radius**2)
    at = np.where(root > 0.0, (-b - np.sqrt(np.maximum(root, 0.0))) / a, np.inf)
    normal = (eye + rays * np.where(np.isfinite(at), at, 0.0)[..., None] - center) / radius
    uv = np.stack([np.arctan2(normal[..., 1], normal[..., 0]) / 6.3, normal[..., 2] / 3.0], axis=-1)
    return _sampled(noise(scene.seed + 20), uv), at


def capture(folder: Path, scenes: StillLife | list[StillLife], cameras: np.ndarray, size=SIZE, focal=FOCAL) -> Path:
    """Writes `folder`/images and `folder`/masks of one scene a camera, with the focal length in the EXIF."""
    (folder / "images").mkdir(parents=True)
    (folder / "masks").mkdir()
    scenes = scenes if isinstance(scenes, list) else [scenes] * len(cameras)
    for index, (scene, c2w) in enumerate(zip(scenes, cameras, strict=True)):
        picture, mask = photograph(scene, c2w, size, focal)
        image = Image.fromarray(picture)
        exif = image.getexif()
        exif.get_ifd(0x8769)[0xA405] = round(focal * math.hypot(36, 24) / math.hypot(*size))
        image.save(folder / "images" / f"IMG_{index:04d}.jpg", quality=93, exif=exif)
        Image.fromarray((mask * 255).astype(np.uint8)).save(folder / "masks" / f"IMG_{index:04d}.png")
    return folder / "images"
