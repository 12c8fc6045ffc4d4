"""Pictures beside what an asset looks like there, and the difference: where it glows, material or shape is wrong."""

from torch import Tensor, cat

from ..graphics.color import bytes_from_unit, composite

BACKDROP = 0.82
"""sRGB grey behind the object."""

GLOW = 2.0
"""Times that the difference of sRGB values is shown: half of the range is white."""

_ROWS = 8
"""Views below one another at most; more stand beside them."""


def comparison(pictures: Tensor, drawn: Tensor) -> Tensor:
    """(3, H, W) uint8 sRGB: a row for each view, of its picture, the asset, and how far they differ where both are.

    Args:
        pictures, drawn: (V, 4, h, w) sRGB, straight alpha.
    """
    rows = cat([_row(picture, asset)[None] for picture, asset in zip(pictures, drawn, strict=True)])
    count = min(len(rows), _ROWS)
    blank = rows.new_full((-len(rows) % count, *rows.shape[1:]), round(255 * BACKDROP))
    blocks = cat([rows, blank]).unflatten(0, (-1, count))  # (blocks, count, 3, h, 3 w)
    return blocks.permute(2, 1, 3, 0, 4).flatten(3, 4).flatten(1, 2)


def _row(picture: Tensor, asset: Tensor) -> Tensor:
    """(3, h, 3 w) of two (4, h, w)."""
    (seen, alpha), (shown, there) = picture.split((3, 1)), asset.split((3, 1))
    glow = GLOW * (seen - shown).abs() * (alpha * there)
    return bytes_from_unit(cat([composite(seen, alpha, BACKDROP), composite(shown, there, BACKDROP), glow], dim=2))
