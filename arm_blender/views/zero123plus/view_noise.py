"""The noise of six views: each has a seed of its own, so that one can be drawn anew while the others keep theirs."""

from collections.abc import Sequence

import torch
from torch import Tensor

ROWS, COLUMNS = 3, 2
"""How the six views lie in the network's one picture, row by row."""

_REFERENCE_SEED = 231_015_110
"""Of the noise on the input picture, for every run: a view that is drawn anew sees the same picture as the others."""


class ViewNoise:
    """Noise of unit variance, one picture of six tiles after another.

    Every seed draws the whole picture, and a view takes its tile from its own seed's: with one seed for all it is
    plain noise, and no view depends on another one's seed.
    """

    def __init__(self, seeds: Sequence[int]) -> None:
        if len(seeds) != ROWS * COLUMNS:
            raise ValueError(f"seeds must be {ROWS * COLUMNS}, got {len(seeds)}")
        self.seeds = tuple(seeds)
        # On the CPU, whatever the networks run on: the same seed then means the same noise everywhere.
        self._generators = {seed: torch.Generator().manual_seed(seed) for seed in self.seeds}
        self._reference = torch.Generator().manual_seed(_REFERENCE_SEED)

    def views(self, channels: int, side: int) -> Tensor:
        """(1, channels, 3 side, 2 side) float32: the next noise of the views."""
        drawn = {
            seed: tiles(torch.randn(1, channels, ROWS * side, COLUMNS * side, generator=generator))
            for seed, generator in self._generators.items()
        }
        return picture_of_tiles(torch.stack([drawn[seed][index] for index, seed in enumerate(self.seeds)]))

    def reference(self, *shape: int) -> Tensor:
        """float32 of a shape: the next noise of the input picture."""
        return torch.randn(shape, generator=self._reference)


def tiles(picture: Tensor) -> Tensor:
    """(6, C, S, S): the views in a picture (1, C, 3 S, 2 S), row by row."""
    channels, side = picture.shape[1], picture.shape[3] // COLUMNS
    split = picture.view(channels, ROWS, side, COLUMNS, side)
    return split.permute(1, 3, 0, 2, 4).reshape(ROWS * COLUMNS, channels, side, side)


def picture_of_tiles(views: Tensor) -> Tensor:
    """(1, C, 3 S, 2 S): the picture of six views (6, C, S, S); undoes `tiles`."""
    channels, side = views.shape[1], views.shape[3]
    split = views.view(ROWS, COLUMNS, channels, side, side).permute(2, 0, 3, 1, 4)
    return split.reshape(1, channels, ROWS * side, COLUMNS * side)
