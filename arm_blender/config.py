"""What the knobs stand for: a preset its networks, a quality level its sizes, and single knobs over it."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import torch

from .errors import ArmError
from .graphics.surface.fairing import FairingConfig
from .knobs import Knobs, PresetName, check
from .models.atlas_network import AtlasNetworkConfig
from .models.paper import reconstruction
from .models.paper.instant_albedo import PAPER as PAPER_ALBEDO
from .models.paper.reconstruction import ReconstructionConfig
from .models.small.finish import FinishConfig
from .models.small.instant_albedo import SMALL as SMALL_ALBEDO
from .models.small.ray_occupancy import RayOccupancyConfig
from .models.small.volume_georm import VolumeGeoRMConfig
from .weight_files import checkpoints

_NETWORKS = ("georm", "glossyrm", "finish", "instant_albedo", "ray_occupancy")
"""The fields of `Preset` that configure a network."""

FEW_VIEWS = 2
"""Views up to which a preset's `ray_occupancy` makes the shape. On held-out objects F@0.1 is 0.70 from one view, and
0.69 to 0.83 from two, as they stand; GeoRM has 0.52, and 0.61 to 0.77. From three it has as much, 0.81."""


@dataclass(frozen=True)
class Preset:
    """The configs of the networks that belong together."""

    georm: ReconstructionConfig | VolumeGeoRMConfig
    glossyrm: ReconstructionConfig | None
    """None leaves roughness and metallic to `finish`."""
    instant_albedo: AtlasNetworkConfig
    ray_occupancy: RayOccupancyConfig | None = None
    """Makes the shape in GeoRM's place where there are too few views to compare; None leaves it to GeoRM."""
    finish: FinishConfig | None = None
    """Reads roughness and metallic off the views in GlossyRM's place."""
    material: PresetName | None = None
    """Preset whose weights of the finish and InstantAlbedo are taken; None for its own."""
    grid: int | None = None
    """Samples of the density along a side of the box, whatever the quality; None follows the quality level."""
    fairing: FairingConfig = FairingConfig()
    """Of the surface, in units of the box [-1, 1]^3."""

    @property
    def networks(self) -> tuple[str, ...]:
        """Names of its networks."""
        return tuple(name for name in _NETWORKS if getattr(self, name) is not None)

    @property
    def gloss_network(self) -> Literal["glossyrm", "finish"]:
        """The name of the network that says roughness and metallic."""
        return "glossyrm" if self.finish is None else "finish"

    def shape_network(self, views: int) -> Literal["georm", "ray_occupancy"]:
        """The name of the network that makes the shape from so many views."""
        return "georm" if self.ray_occupancy is None or views > FEW_VIEWS else "ray_occupancy"


PRESETS: dict[str, Preset] = {
    "small": Preset(
        VolumeGeoRMConfig(),
        None,
        SMALL_ALBEDO,
        RayOccupancyConfig(),
        FinishConfig(),
        # Its volume has cells of 0.04, whose steps show, and its surface lies inside of the outlines by a little.
        fairing=FairingConfig(wavelength=0.14, swell=0.006),
    ),
    "paper": Preset(reconstruction.PAPER, reconstruction.PAPER, PAPER_ALBEDO, grid=256),  # ARM, section 5.1.
    # InstantMesh has no networks of the material, and those of `small` need to know nothing of the shape's.
    "instantmesh": Preset(
        reconstruction.INSTANTMESH,
        None,
        SMALL_ALBEDO,
        finish=FinishConfig(),
        material="small",
    ),
}


@dataclass(frozen=True)
class Quality:
    """What a quality level stands for; docs/error-and-time.md has the error and the time of each."""

    grid: int
    """Samples of the density along a side of the box."""
    faces: int
    """Face budget."""
    texture_size: int
    """Largest texels a side; a smaller atlas is made where the views cannot fill it."""
    refinement: int
    """Rounds in which the shape is moved to meet its pictures."""


QUALITIES: dict[str, Quality] = {
    "draft": Quality(grid=64, faces=5_000, texture_size=512, refinement=0),
    "balanced": Quality(grid=80, faces=10_000, texture_size=1024, refinement=2),
    "final": Quality(grid=128, faces=30_000, texture_size=2048, refinement=3),
}


@dataclass(frozen=True, kw_only=True)
class Settings(Knobs):
    """One run. Knobs that are None follow the quality level.

    Raises:
        ArmError: a knob is not what it may be, or this machine, or this build of torch, has not what it asks for.
    """

    def __post_init__(self) -> None:
        check(self)
        there = {"cpu": True, "cuda": torch.cuda.is_available(), "mps": torch.backends.mps.is_available()}
        if not there[self.device]:
            raise ArmError(f"--device {self.device}: torch finds none here; choose cpu, or see `arm doctor`")

    @property
    def resolved(self) -> Quality:
        """The quality level with the preset's grid and the single knobs over it."""
        level = QUALITIES[self.quality]
        level = replace(level, grid=PRESETS[self.preset].grid or level.grid)
        own = {name: getattr(self, name) for name in ("grid", "faces", "texture_size", "refinement")}
        return replace(level, **{name: value for name, value in own.items() if value is not None})

    @property
    def networks(self) -> tuple[str, ...]:
        """Names of the preset's networks."""
        return PRESETS[self.preset].networks

    def weights(self, network: str) -> Path:
        """The weights file of one of `networks`."""
        own = self.preset if network == "georm" else PRESETS[self.preset].material or self.preset
        shipped = checkpoints.shipped(f"{own}.{network}")
        brought = self.weights_folder / shipped.name if self.weights_folder is not None else shipped
        return brought if brought.is_file() else shipped

    def brings(self, network: str) -> bool:
        """Whether the weights of a network are the user's own, from `weights_folder`."""
        return self.weights_folder is not None and self.weights(network).parent == self.weights_folder
