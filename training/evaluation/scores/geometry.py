"""F-score and Chamfer distance between two surfaces (ARM, section 6), in the frame of the cameras.

The views are posed, so the prediction already lies in the truth's frame: nothing is aligned here, and no search over
poses can flatter a result (`alignment` is for shapes whose frame is unknown). The Chamfer distance is the sum of both
mean distances, unsquared. Normals are compared where a predicted point lies nearest to the truth, without their sign:
scans have faces that are turned over.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from arm_blender.graphics.meshes import face_normals, sample_surface
from arm_blender.structures import TriangleMesh, UvMesh

from ...rendering.occupancy import in_front, views_around

SAMPLES = 100_000
"""Points on each surface, as in the paper."""


@dataclass(frozen=True)
class GeometryScores:
    """How close a surface lies to the truth.

    Attributes:
        f_coarse: F-score at 0.1 world units, in [0, 1]; the paper's.
        f_fine: F-score at 0.02.
        chamfer: mean distance from prediction to truth plus mean distance from truth to prediction, world units.
        angle: between the normals of predicted points and those of the nearest true ones, degrees in [0, 90], mean.
    """

    f_coarse: float
    f_fine: float
    chamfer: float
    angle: float


FAILED = GeometryScores(f_coarse=0.0, f_fine=0.0, chamfer=float("inf"), angle=90.0)
"""Of an object without a surface: it stays in the means."""

MEASURES = {"f_coarse": "F@0.1", "f_fine": "F@0.02", "chamfer": "CD", "angle": "normals °"}
"""The scores' names in tables."""

LOWER_IS_BETTER = ("chamfer", "angle")


def compare(
    predicted: TriangleMesh | UvMesh, truth: TriangleMesh, samples: int = SAMPLES, seed: int = 0
) -> GeometryScores:
    """Scores of `predicted` against `truth`, both in one frame.

    Args:
        samples: points on each surface.
        seed: of the samples; the same one gives the same numbers.
    Raises:
        ValueError: a mesh has no area.
    """
    generator = torch.Generator().manual_seed(seed)
    return compare_points(*(Points.on(mesh, samples, generator) for mesh in (predicted, truth)))


@dataclass(frozen=True)
class Points:
    """Points on a surface.

    Attributes:
        position: (P, 3) world.
        normal: (P, 3) unit, of the face that each lies on.
    """

    position: NDArray[np.float32]
    normal: NDArray[np.float32]

    @staticmethod
    def on(mesh: TriangleMesh | UvMesh, count: int, generator: torch.Generator) -> "Points":
        """Spread evenly over a mesh.

        Raises:
            ValueError: it has no area.
        """
        position, face, _ = sample_surface(mesh.vertices, mesh.faces, count, generator)
        return Points(position.numpy(), face_normals(mesh.vertices, mesh.faces)[face].numpy())

    def __getitem__(self, chosen: NDArray[np.bool_] | slice) -> "Points":
        return Points(self.position[chosen], self.normal[chosen])


def compare_points(a: Points, b: Points) -> GeometryScores:
    """Scores of points on a predicted surface against points on the true one."""
    to_truth, nearest = cKDTree(b.position).query(a.position)
    to_predicted = cKDTree(a.position).query(b.position)[0]
    cosine = np.abs((a.normal * b.normal[nearest]).sum(axis=1)).clip(0.0, 1.0)
    return GeometryScores(
        f_coarse=f_score(to_truth, to_predicted, 0.1),
        f_fine=f_score(to_truth, to_predicted, 0.02),
        chamfer=float(to_truth.mean() + to_predicted.mean()),
        angle=float(np.degrees(np.arccos(cosine)).mean()),
    )


def ceiling(truth: TriangleMesh, samples: int = SAMPLES, seed: int = 0) -> GeometryScores:
    """What a perfect outer surface scores: that part of the truth which some view from outside sees, against all of it.

    Hidden interiors cannot be reconstructed from pictures, and count in the scores all the same.

    Raises:
        ValueError: the mesh has no area.
    """
    generator = torch.Generator().manual_seed(seed)
    points, whole = (Points.on(truth, n, generator) for n in (2 * samples, samples))
    views, pixel = views_around(truth)
    seen = in_front(torch.from_numpy(points.position), views, -pixel).numpy()
    return compare_points(points[seen][:samples], whole)


def f_score(to_truth: NDArray[np.float64], to_predicted: NDArray[np.float64], threshold: float) -> float:
    """The harmonic mean of precision and recall.

    Args:
        to_truth: (P,) distance of every predicted point to the truth.
        to_predicted: (Q,) distance of every true point to the prediction.
        threshold: a point at most this far away counts as met.
    """
    precision, recall = float((to_truth <= threshold).mean()), float((to_predicted <= threshold).mean())
    return 2.0 * precision * recall / (precision + recall) if precision + recall > 0.0 else 0.0
