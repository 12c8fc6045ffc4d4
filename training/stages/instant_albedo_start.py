"""What a fit of InstantAlbedo begins with: which networks, and whose weights."""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

from torch import nn

from arm_blender import networks
from arm_blender.errors import ArmError
from arm_blender.models.atlas_network import AtlasNetworkConfig
from arm_blender.models.material_encoder import MaterialEncoderConfig
from arm_blender.models.paper.instant_albedo import PAPER
from arm_blender.models.small.delighting import DelightingConfig
from arm_blender.models.small.instant_albedo import SMALL, InstantAlbedoConfig
from arm_blender.weight_files import checkpoints

SIZES: dict[str, AtlasNetworkConfig] = {"small": SMALL, "paper": PAPER}
"""The networks of each preset."""

_PRESETS = {PAPER: "paper", SMALL: "small", replace(SMALL, delighting=None): "small"}


@dataclass(frozen=True)
class Start:
    """Networks, and the weights that a fit of them begins with; random ones for what is None."""

    config: AtlasNetworkConfig
    """Of the networks."""
    whole: Path | None = None
    """Of all networks, of the same config."""
    material_prior: Path | None = None
    """Of the encoder, as `fit material-prior` writes them."""
    delighting: Path | None = None
    """As `fit delighting` writes them; they stay as they are."""

    @property
    def preset(self) -> str:
        """Whose networks these are, with delighting or without; "own" for those of none."""
        return _PRESETS.get(self.config, "own")

    def network(self) -> nn.Module:
        """The networks with the weights that there are.

        Raises:
            CheckpointError: weights are damaged, or made for networks of another size.
        """
        model = networks.build("instant_albedo", self.config)
        if self.whole is not None:
            checkpoints.restore(model, checkpoints.load(self.whole, type(self.config))[1], self.whole)
        if self.material_prior is not None:
            _, state = checkpoints.load(self.material_prior, MaterialEncoderConfig)
            checkpoints.restore(model.get_submodule("encoder"), state, self.material_prior)
        if self.delighting is not None:
            _, state = checkpoints.load(self.delighting, DelightingConfig)
            checkpoints.restore(model.get_submodule("delighting"), state, self.delighting)
        if getattr(model, "delighting", None) is not None:
            model.delighting.requires_grad_(False)
        return model


def start_of(args: argparse.Namespace) -> Start:
    """What the words ask for: networks as those gone on from, or of the preset, delighting only where it is given.

    Raises:
        CheckpointError: `--start` is damaged.
        ArmError: `--delighting` does not go with the other words.
    """
    if args.start is not None:
        config: AtlasNetworkConfig = checkpoints.load(args.start, *networks.NETWORKS["instant_albedo"])[0]
    else:
        config = SIZES[args.preset]
        if isinstance(config, InstantAlbedoConfig) and args.delighting is None:
            config = replace(config, delighting=None)
    if args.delighting is not None and getattr(config, "delighting", None) is None:
        raise ArmError(f"--delighting {args.delighting}: these networks have none; leave it out")
    return Start(config, args.start, args.material_prior, args.delighting)
