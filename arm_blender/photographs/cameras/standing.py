"""The frame of a solution as a user wants it: Z up, the object standing on the ground, its longest side 2."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import normalize

from ..masks.joint_hull import JointHull
from .solver import Solution

LONGEST = 2.0
"""World units of the object's longest side: it fits [-1, 1]^3, as the networks want it."""

_TRIALS = 1500
"""Planes that are tried."""

_THICKNESS = 0.008
"""Of the distance to the cameras: how far a point of the ground may lie off the plane."""

_TILT_DEG = 40.0
"""Between the ground's normal and the cameras' mean up, at most: nobody holds a phone so slanted all around."""

_HELD = 0.6
"""Length of the mean of the cameras' ups below which they do not agree: around an object, 53° above it, it is that."""

_ENOUGH, _SHARE = 30, 0.25
"""Points of a ground at least, and of those that may be the ground's."""

_OBJECT, _GROUND, _EITHER = 0.7, 0.2, 0.5
"""Of a point's observations, the share inside masks from which it is the object's, up to which the ground's, and up to
which it may be the ground's where masks took the things that lie there along."""

_BELOW = 0.03
"""Of the object's points that may lie below its ground."""

_AROUND = 1.2
"""How far from the object's axis a ground's points lie, the median, beside how far nine tenths of all others do, where
it is not known which points are the object's."""


@dataclass(frozen=True)
class Upright:
    """How a solution comes to stand: x -> scale * rotation @ x + shift.

    Attributes:
        rotation: (3, 3) float64.
        scale: new units of one of the solution's.
        shift: (3,) float64.
        ground: height (Z) of the ground in the new frame; None where none was found and up is the mean of the cameras'.
    """

    rotation: Tensor
    scale: float
    shift: Tensor
    ground: float | None

    def moved(self, points: Tensor) -> Tensor:
        """(..., 3) points of the solution's frame."""
        return self.scale * points @ self.rotation.T + self.shift

    def c2w(self, w2c: Tensor) -> Tensor:
        """(V, 4, 4) camera to world in OpenGL axes of `w2c` in OpenCV axes and the solution's frame."""
        turned = w2c[:, :3, :3].transpose(1, 2)
        centers = -(turned @ w2c[:, :3, 3:])[..., 0]
        c2w = torch.eye(4, dtype=w2c.dtype).repeat(len(w2c), 1, 1)
        c2w[:, :3, :3] = self.rotation @ turned @ torch.diag(w2c.new_tensor([1.0, -1.0, -1.0]))
        c2w[:, :3, 3] = self.moved(centers)
        return c2w


def upright(solution: Solution, masks: list[Tensor] | None, hull: JointHull | None, seed: int) -> Upright:
    """Where the object stands.

    Args:
        solution: with at least one point.
        masks: of its pictures, (H, W) float each; None where there are none.
        hull: of those masks.
        seed: of the planes that are tried.
    """
    inside = _inside(solution, masks)
    solved = solution.points[inside >= _OBJECT] if masks is not None else _near_points(solution)
    if len(solved) < _ENOUGH:
        solved = _near_points(solution)
    own = hull.core if hull is not None and len(hull.core) else solved
    middle = own.median(dim=0).values
    distance = float((solution.centers - middle).norm(dim=1).median())
    up = _held_up(solution, middle)
    near = (solution.points - middle).norm(dim=1) < 1.5 * distance
    candidates = solution.points[near & (inside <= _GROUND)]
    thickness = _THICKNESS * distance
    plane = _ground(candidates, candidates, solved, up, solution.centers, thickness, seed)
    if plane is None:  # Bad masks may have taken along what lies there.
        points, drawn = solution.points[near], solution.points[near & (inside <= _EITHER)]
        plane = _ground(drawn, points, points, up, solution.centers, thickness, seed)
        plane = plane if plane is not None and _lies_around(plane, points, thickness) else None
    if plane is not None:
        up = plane[0]
    rotation = _turn(up, -solution.w2c[0, 2, :3])
    turned = own @ rotation.T
    low, high = (turned.quantile(share, dim=0) for share in (0.002, 0.998))
    # Seen from above, a hull reaches below the ground: the rays through the object's foot go on.
    foot = (solved @ up).quantile(0.01) if plane is None else plane[1]
    low[2] = torch.minimum(torch.maximum(low[2], foot), high[2] - 1e-3 * distance)
    scale = LONGEST / max(float((high - low).max()), 1e-12)
    shift = -scale * (low + high) / 2.0
    ground = None if plane is None else scale * float(plane[1]) + float(shift[2])
    return Upright(rotation, scale, shift, ground)


def _held_up(solution: Solution, middle: Tensor) -> Tensor:
    """(3,) up, by how the cameras were held; where that says little, as they were turned, they are above the object."""
    own = -solution.w2c[:, 1, :3].mean(dim=0)
    towards = normalize(solution.centers - middle, dim=1).mean(dim=0)
    return normalize(own if float(own.norm()) >= _HELD else towards, dim=0)


def _inside(solution: Solution, masks: list[Tensor] | None) -> Tensor:
    """(P,) of each point's observations, the share inside the masks."""
    count, held = torch.zeros(len(solution.points)), torch.zeros(len(solution.points))
    if masks is None:
        return held
    picture, point = solution.seen[:, 0].long(), solution.seen[:, 1].long()
    for index, (mask, lens) in enumerate(zip(masks, solution.lenses, strict=True)):
        own = picture == index
        column = (solution.seen[own, 2] * mask.shape[1] / lens.width).long().clamp(0, mask.shape[1] - 1)
        row = (solution.seen[own, 3] * mask.shape[0] / lens.height).long().clamp(0, mask.shape[0] - 1)
        held.index_add_(0, point[own], (mask[row, column] > 0.5).float())
        count.index_add_(0, point[own], torch.ones(int(own.sum())))
    return held / count.clamp(min=1.0)


def _near_points(solution: Solution) -> Tensor:
    """The points that most cameras look at: where nobody says what the object is."""
    forward = solution.w2c[:, 2, :3]
    across = torch.eye(3, dtype=torch.float64) - forward[:, :, None] * forward[:, None, :]
    middle = torch.linalg.lstsq(across.sum(0), (across @ solution.centers[:, :, None]).sum(0)).solution[:, 0]
    off = (solution.points - middle).norm(dim=1)
    near = off < 0.35 * (solution.centers - middle).norm(dim=1).median()
    return solution.points[near] if int(near.sum()) >= 4 else solution.points


def _ground(
    drawn: Tensor, points: Tensor, own: Tensor, up: Tensor, centers: Tensor, thickness: float, seed: int
) -> tuple[Tensor, Tensor] | None:
    """The plane that most `points` (P, 3) lie on, with `own` and all cameras above: normal (3,), and its height.

    Planes are tried through three of `drawn`. None where there is none.
    """
    if len(points) < _ENOUGH or len(drawn) < 3:
        return None
    generator = torch.Generator().manual_seed(seed)
    three = drawn[torch.randint(len(drawn), (_TRIALS, 3), generator=generator)]
    normal = torch.linalg.cross(three[:, 1] - three[:, 0], three[:, 2] - three[:, 0])
    normal = normalize(normal, dim=1)
    normal = normal * torch.sign(normal @ up)[:, None]
    height = (normal * three[:, 0]).sum(dim=1)
    level = normal @ up >= math.cos(math.radians(_TILT_DEG))
    sampled = own[:: max(1, len(own) // 2000)]
    beneath = (sampled @ normal.T < height - 3.0 * thickness).double().mean(dim=0) <= _BELOW
    above = (centers @ normal.T > height).all(dim=0)
    on_it = ((points @ normal.T - height).abs() < thickness).sum(dim=0) * (level & beneath & above)
    best = int(on_it.argmax())
    if int(on_it[best]) < max(_ENOUGH, _SHARE * len(drawn)):
        return None
    flat = points[(points @ normal[best] - height[best]).abs() < thickness]
    middle = flat.mean(dim=0)
    fitted = torch.linalg.svd(flat - middle, full_matrices=False).Vh[2]
    fitted = fitted * torch.sign(fitted @ up)
    return fitted, fitted @ middle


def _lies_around(plane: tuple[Tensor, Tensor], points: Tensor, thickness: float) -> bool:
    """Whether the points of a plane lie around all others, and are not a flat side of the object."""
    normal, height = plane
    across = points - points.median(dim=0).values
    far = (across - (across @ normal)[:, None] * normal).norm(dim=1)
    on_it = (points @ normal - height).abs() < thickness
    if bool(on_it.all()):
        return False
    return float(far[on_it].median()) > _AROUND * float(far[~on_it].quantile(0.9))


def _turn(up: Tensor, back: Tensor) -> Tensor:
    """(3, 3) that brings `up` to +Z and the side from which the first camera looks, `back`, to -Y: Blender's front."""
    front = back - (back @ up) * up
    if float(front.norm()) < 1e-6:
        front = torch.linalg.cross(up, up.new_tensor([1.0, 0.3, 0.2]))
    y = -normalize(front, dim=0)
    return torch.stack([torch.linalg.cross(y, up), y, up])
