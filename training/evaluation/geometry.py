"""F-score and Chamfer distance between two surfaces (ARM, section 6), in the frame of the cameras.

The views are posed, so the prediction already lies in the truth's frame: nothing is aligned, and no search over poses
can flatter a result. The Chamfer distance is the sum of both mean distances, unsquared.
"""

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

from arm_blender.graphics.meshes import sample_surface
from arm_blender.structures import TriangleMesh

SAMPLES = 100_000
"""Points on each surface, as in the paper."""


@dataclass(frozen=True)
class GeometryScores:
    """How close a surface lies to the truth.

    Attributes:
        f_coarse: F-score at 0.1 world units, in [0, 1]; the paper's.
        f_fine: F-score at 0.02.
        chamfer: mean distance from prediction to truth plus mean distance from truth to prediction, world units.
    """

    f_coarse: float
    f_fine: float
    chamfer: float


def compare(predicted: TriangleMesh, truth: TriangleMesh, samples: int = SAMPLES, seed: int = 0) -> GeometryScores:
    """Scores of `predicted` against `truth`, both in one frame.

    Args:
        samples: points on each surface.
        seed: of the samples; the same one gives the same numbers.
    Raises:
        ValueError: a mesh has no area.
    """
    generator = torch.Generator().manual_seed(seed)
    a, b = (sample_surface(mesh.vertices, mesh.faces, samples, generator)[0].numpy() for mesh in (predicted, truth))
    to_truth, to_predicted = cKDTree(b).query(a)[0], cKDTree(a).query(b)[0]
    return GeometryScores(
        f_coarse=f_score(to_truth, to_predicted, 0.1),
        f_fine=f_score(to_truth, to_predicted, 0.02),
        chamfer=float(to_truth.mean() + to_predicted.mean()),
    )


def f_score(to_truth: np.ndarray, to_predicted: np.ndarray, threshold: float) -> float:
    """The harmonic mean of precision and recall.

    Args:
        to_truth: (P,) distance of every predicted point to the truth.
        to_predicted: (Q,) distance of every true point to the prediction.
        threshold: a point at most this far away counts as met.
    """
    precision, recall = float((to_truth <= threshold).mean()), float((to_predicted <= threshold).mean())
    return 2.0 * precision * recall / (precision + recall) if precision + recall > 0.0 else 0.0
