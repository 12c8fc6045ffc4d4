"""The paper's alignment of a shape whose frame is unknown: rotations and scales are tried, the best are refined by ICP.

Both shapes are normalised to [-1, 1]^3 first. A candidate replaces a better one only by more than noise, and the pose
as it is comes first: a symmetric shape stays as it is instead of turning by chance. Correspondences go both ways, so
that a prediction cannot shrink into a point of the truth.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from arm_blender.graphics.meshes import sample_surface
from arm_blender.graphics.similarity import similarity
from arm_blender.structures import TriangleMesh


@dataclass(frozen=True)
class AlignmentConfig:
    """How thoroughly the best pose is looked for."""

    scales: tuple[float, ...] = (0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4)
    """Tried with every rotation; the paper's range."""
    points: int = 2_000
    """On each surface while poses are tried. Fewer leave the scale a percent off; more cost time."""
    refined: int = 6
    """Candidates that ICP goes on with. One alone may lie in the wrong basin."""
    rounds: int = 30
    """Of ICP."""
    noise: float = 0.1
    """By how much a candidate has to win, as a share of the Chamfer distance of two samples of the truth: ICP fits
    samples a little better than their surfaces, and a ball would turn to where it does."""


def align(
    predicted: TriangleMesh, truth: TriangleMesh, seed: int = 0, config: AlignmentConfig = AlignmentConfig()
) -> Tensor:
    """(4, 4) similarity from the prediction's frame into the truth's, at the lowest Chamfer distance found.

    Args:
        seed: of the points compared.
    Raises:
        ValueError: a mesh has no area.
    """
    to_unit, truth_to_unit = _normalising(predicted), _normalising(truth)
    generator = torch.Generator().manual_seed(seed)
    source, target = (
        _moved(sample_surface(mesh.vertices, mesh.faces, config.points, generator)[0].double().numpy(), motion)
        for mesh, motion in ((predicted, to_unit), (truth, truth_to_unit))
    )
    tree = cKDTree(target)
    again = _moved(sample_surface(truth.vertices, truth.faces, config.points, generator)[0].numpy(), truth_to_unit)
    margin = config.noise * _distance(again, target, tree)
    candidates = [(_distance(_moved(source, pose), target, tree), pose) for pose in poses(config.scales)]
    # The pose as it is always goes on; the sort is stable, so that among equals the first of the list wins.
    order = [candidates[0], *sorted(candidates[1:], key=lambda candidate: candidate[0])]
    best, chosen = candidates[0]
    for _, pose in order[: config.refined]:
        refined = _icp(source, target, tree, pose, config)
        distance = _distance(_moved(source, refined), target, tree)
        if distance < best - margin:
            best, chosen = distance, refined
    return torch.from_numpy(np.linalg.inv(truth_to_unit) @ chosen @ to_unit).float()


def moved_by(motion: Tensor) -> Callable[[Tensor], Tensor]:
    """A motion (4, 4) of vertices (N, 3)."""
    return lambda vertices: vertices @ motion[:3, :3].T + motion[:3, 3]


def poses(scales: tuple[float, ...]) -> Iterator[NDArray[np.float64]]:
    """(4, 4) similarities about the origin, the identity first: quarter turns of a cube, and each eighth about Z."""
    yield np.eye(4)
    for rotation in [*_cube_rotations(), *(_about_z(np.pi / 4 + np.pi / 2 * k) for k in range(4))]:
        for scale in sorted(scales, key=lambda s: abs(s - 1.0)):
            pose = np.eye(4)
            pose[:3, :3] = scale * rotation
            yield pose


def similarity_between(source: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) of `graphics.similarity`, from points (P, 3) to (P, 3)."""
    scale, rotation, shift = similarity(torch.from_numpy(source), torch.from_numpy(target))
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = scale * rotation.numpy(), shift.numpy()
    return motion


def _icp(
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    tree: cKDTree,
    pose: NDArray[np.float64],
    config: AlignmentConfig,
) -> NDArray[np.float64]:
    """The pose after iterated closest points, both ways."""
    low, high = min(config.scales), max(config.scales)
    for _ in range(config.rounds):
        moved = _moved(source, pose)
        nearest, back = tree.query(moved)[1], cKDTree(moved).query(target)[1]
        step = similarity_between(np.concatenate([moved, moved[back]]), np.concatenate([target[nearest], target]))
        after = step @ pose
        if not low <= np.cbrt(np.linalg.det(after[:3, :3])) <= high:  # Beyond what may be tried.
            return pose
        if np.abs(after - pose).max() < 1e-5:
            return after
        pose = after
    return pose


def _normalising(mesh: TriangleMesh) -> NDArray[np.float64]:
    """(4, 4) that centres the bounding box and brings its longest side to 2; a single point only moves."""
    used = mesh.vertices[mesh.faces.unique()].double().numpy()
    low, high = used.min(axis=0), used.max(axis=0)
    extent = float((high - low).max())
    motion = np.eye(4)
    motion[:3, :3] *= 2.0 / extent if extent > 1e-12 else 1.0
    motion[:3, 3] = -motion[0, 0] * (low + high) / 2.0
    return motion


def _moved(points: NDArray[np.float64], motion: NDArray[np.float64]) -> NDArray[np.float64]:
    return points @ motion[:3, :3].T + motion[:3, 3]


def _distance(moved: NDArray[np.float64], target: NDArray[np.float64], tree: cKDTree) -> float:
    """Chamfer distance of two sets of points."""
    return float(tree.query(moved)[0].mean() + cKDTree(moved).query(target)[0].mean())


def _cube_rotations() -> Iterator[NDArray[np.float64]]:
    """The 24 rotations that keep a cube, the identity first."""
    for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)):
        for signs in range(8):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = [1.0 - 2.0 * (signs >> axis & 1) for axis in range(3)]
            if np.linalg.det(matrix) > 0.0:
                yield matrix


def _about_z(angle: float) -> NDArray[np.float64]:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
