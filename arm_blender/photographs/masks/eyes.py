"""Where points of a scene are in its photographs, and along which rays those look: lenses as they were solved."""

from dataclasses import dataclass

import torch
from torch import Tensor

from ..capture import Lens

_NEWTON = 6
"""Steps that undo a lens's bend: it is small."""


@dataclass(frozen=True)
class Eye:
    """A camera.

    Attributes:
        w2c: (4, 4), OpenCV axes: it looks along +Z, +Y is down.
        lens: its first parameters are one focal length, the centre and, where it bends, COLMAP's k1.
    """

    w2c: Tensor
    lens: Lens

    @classmethod
    def posed(cls, c2w: Tensor, lens: Lens) -> "Eye":
        """Of a pose (4, 4), camera to world in OpenGL axes."""
        return cls(torch.linalg.inv(c2w @ torch.diag(c2w.new_tensor([1.0, -1.0, -1.0, 1.0]))), lens)

    @property
    def center(self) -> Tensor:
        """(3,) where it stands."""
        return -self.w2c[:3, :3].T @ self.w2c[:3, 3]

    def places(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Where points (..., 3) are in the picture, and whether they are in it.

        Returns:
            (..., 2), from -1 to 1 between the picture's outer borders, right and down; (...,) bool.
        """
        local = points @ self.w2c[:3, :3].T.to(points) + self.w2c[:3, 3].to(points)
        flat = local[..., :2] / local[..., 2:].clamp(min=1e-6)
        focal, x, y, k1 = self._radial()
        squared = flat.square().sum(dim=-1, keepdim=True)
        bent = flat * (1.0 + k1 * squared) * focal + flat.new_tensor([x, y])
        place = bent / flat.new_tensor([self.lens.width / 2.0, self.lens.height / 2.0]) - 1.0
        # Where a lens bends back, points from beyond the picture would be seen in it.
        sound = (local[..., 2] > 1e-6) & (1.0 + 3.0 * k1 * squared[..., 0] > 0.0)
        return place, sound & (place.abs() < 1.0).all(dim=-1)

    def rays(self, places: Tensor) -> Tensor:
        """(..., 3) unit directions, in the frame of the scene, of places (..., 2) as `places` gives them."""
        focal, x, y, k1 = self._radial()
        half = places.new_tensor([self.lens.width / 2.0, self.lens.height / 2.0])
        bent = ((places + 1.0) * half - places.new_tensor([x, y])) / focal
        flat = bent.clone()
        for _ in range(_NEWTON if k1 else 0):
            flat = bent / (1.0 + k1 * flat.square().sum(dim=-1, keepdim=True)).clamp(min=0.1)
        local = torch.cat([flat, torch.ones_like(flat[..., :1])], dim=-1)
        return torch.nn.functional.normalize(local @ self.w2c[:3, :3].to(places), dim=-1)

    def _radial(self) -> tuple[float, float, float, float]:
        focal, x, y, *bend = self.lens.parameters
        return focal, x, y, bend[0] if bend else 0.0
