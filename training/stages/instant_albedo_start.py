"""What a fit of InstantAlbedo begins with: which networks, and whose weights."""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

from arm_blender.errors import ArmError
from arm_blender.models.material_encoder import MaterialEncoderConfig
from arm_blender.models.paper.instant_albedo import PAPER, SMALL, InstantAlbedo, InstantAlbedoConfig
from arm_blender.models.small.delighting import DelightingConfig
from arm_blender.weight_files import checkpoints

SIZES = {"small": SMALL, "paper": PAPER}
"""The networks of each preset."""


@dataclass(frozen=True)
class Starts:
    """Weights that a fit begins with."""

    whole: Path | None = None
    """Of all networks, of the same config."""
    material_prior: Path | None = None
    """Of the encoder, as `fit material-prior` writes them."""
    delighting: Path | None = None
    """As `fit delighting` writes them; they stay as they are."""

    def give_to(self, model: InstantAlbedo) -> None:
        """Restore what there is.

        Raises:
            CheckpointError: weights are damaged, or made for networks of another size.
            ArmError: this ablation has no encoder, or is to begin at random.
        """
        if self.whole is not None:
            checkpoints.restore(model, checkpoints.load(self.whole, InstantAlbedoConfig)[1], self.whole)
        if self.material_prior is not None:
            ablation = model.config.ablation
            if ablation in ("no-material-prior", "random-material-prior"):
                raise ArmError(
                    f"{self.material_prior}: --ablation {ablation} takes no --material-prior; leave one of them out"
                )
            _, state = checkpoints.load(self.material_prior, MaterialEncoderConfig)
            checkpoints.restore(model.encoder, state, self.material_prior)
        if self.delighting is not None:
            _, state = checkpoints.load(self.delighting, DelightingConfig)
            checkpoints.restore(model.delighting, state, self.delighting)
        if model.delighting is not None:
            model.delighting.requires_grad_(False)


FRESH = Starts()
"""Random weights."""


def network_of(args: argparse.Namespace) -> InstantAlbedoConfig:
    """The networks that the words ask for: as those gone on from, or of the preset, delighting only where it is given.

    Raises:
        CheckpointError: `--start` is damaged.
        ArmError: `--delighting` does not go with the other words.
    """
    if args.start is not None:
        return checkpoints.load(args.start, InstantAlbedoConfig)[0]
    own = SIZES[args.preset].ablated(args.ablation)
    if args.delighting is None:
        return replace(own, delighting=None)
    if own.delighting is None:
        raise ArmError(f"--delighting {args.delighting}: these networks have none; leave it out")
    return own
