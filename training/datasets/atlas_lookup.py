"""Where the pixels of views find their colours in an atlas: the render of a texture, with a gradient, as a look-up.

Shape and views do not change in training, so the faces and the barycentric coordinates of all pixels are found once. A
pixel is interpolated between texels of its own face's chart alone: neighbours in the atlas are not neighbours on the
surface, and in the gaps a prediction means nothing.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

LEAST_WEIGHT = 1e-3
"""Of a pixel's bilinear weights, the sum within its chart; a pixel with less shows a sliver that has no texel."""


@dataclass(frozen=True)
class AtlasLookup:
    """N views of S x S pixels in an atlas of T texels a side.

    Attributes:
        texel: (N, S, S, 4) int64 row by row; 0 outside of the mask.
        weight: (N, S, S, 4) of these texels, sum 1; 0 outside of the mask.
        mask: (N, S, S) bool: pixels that show the mesh, are opaque in the truth, and have a texel of their chart.
    """

    texel: Tensor
    weight: Tensor
    mask: Tensor

    def part(self, views: Tensor, rows: slice, columns: slice) -> "AtlasLookup":
        """A window of some views, by their indices."""
        return AtlasLookup(*(x[views, rows, columns] for x in (self.texel, self.weight, self.mask)))

    def render(self, texture: Tensor) -> Tensor:
        """(N, C, S, S) what the views show of a texture (C, T, T); 0 outside of the mask. Differentiable."""
        pixel = self.mask.flatten().nonzero()[:, 0]
        texel, weight = self.texel.flatten(0, 2)[pixel], self.weight.flatten(0, 2)[pixel]
        table = texture.flatten(1).T.contiguous()  # (T * T, C)
        # Four selections: their gradient is several times faster than that of one by (P, 4).
        a, b, c, d = (weight[:, k, None] * table.index_select(0, texel[:, k]) for k in range(4))
        image = texture.new_zeros(self.mask.numel(), len(texture)).index_copy(0, pixel, a + b + c + d)
        return image.view(*self.mask.shape, -1).movedim(-1, 1)


def atlas_lookup(
    face: Tensor, barycentric: Tensor, corner_uvs: Tensor, face_chart: Tensor, texel_chart: Tensor
) -> AtlasLookup:
    """The look-up of pixels of known faces.

    Args:
        face: (N, S, S) int64, -1 where nothing is shown.
        barycentric: (N, S, S, 2) of the faces' second and third corner.
        corner_uvs: (F, 3, 2) in [0, 1], v up.
        face_chart: (F,) int64. texel_chart: (T, T) int64, -1 in the gaps; row 0 is v = 1.
    """
    size, pixel = len(texel_chart), (face >= 0).flatten().nonzero()[:, 0]
    owner, second = face.flatten()[pixel], barycentric.flatten(0, 2)[pixel]
    corners = corner_uvs[owner]  # (P, 3, 2)
    uv = corners[:, 0] + (second[..., None] * (corners[:, 1:] - corners[:, :1])).sum(dim=1)
    place = torch.stack([uv[:, 0], 1.0 - uv[:, 1]], dim=1) * size - 0.5
    low = place.floor()
    right, down = (place - low).unbind(dim=1)
    texels, weights = [], []
    for y in (0, 1):
        for x in (0, 1):
            column, row = (low + low.new_tensor([x, y])).long().clamp(0, size - 1).unbind(dim=1)
            weight = (right if x else 1.0 - right) * (down if y else 1.0 - down)
            texels.append(row * size + column)
            weights.append(weight * (texel_chart[row, column] == face_chart[owner]))
    texel, weight = torch.stack(texels, dim=1), torch.stack(weights, dim=1)
    total = weight.sum(dim=1)
    kept = total > LEAST_WEIGHT
    pixel = pixel[kept]
    square = (*face.shape, 4)
    return AtlasLookup(
        torch.zeros(face.numel(), 4, dtype=torch.int64).index_copy_(0, pixel, texel[kept]).view(square),
        torch.zeros(face.numel(), 4).index_copy_(0, pixel, weight[kept] / total[kept, None]).view(square),
        torch.zeros(face.numel(), dtype=torch.bool).index_fill_(0, pixel, True).view(face.shape),
    )
