"""What is rendered and compared: the rigs, the lights and the numbers of the evaluation's protocol."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from arm_blender.errors import ArmError
from arm_blender.graphics.cameras import Camera, orbit_camera
from arm_blender.views.rigs import zero123plus_rig

Choice = TypeVar("Choice")

FOVY_DEG, DISTANCE = 30.0, 6.0
"""Of every camera: degrees, and world units to an object whose longest side is 2."""

EXPOSURE = 0.8
"""Mean luminance that every environment is scaled to."""

TEST_ELEVATIONS_DEG = (-15.0, 0.0, 15.0, 35.0)
"""Of the test views, in turn."""

FRONT_ELEVATION_DEG = 10.0
"""Of the one true view, at azimuth 0."""

UNMEASURED = (0.5, 0.0)
"""Roughness and metallic of scans that have none; they are rendered so and not scored."""


@dataclass(frozen=True)
class Protocol:
    """How the truth is rendered; another protocol has a folder of its own in the cache."""

    resolution: int = 320
    """Pixels a side of all views."""
    samples: int = 32
    """Cycles samples a pixel, denoised. Fewer leave noise that a prediction cannot have."""
    asset_samples: int = 16
    """Of the assets, denoised as well; the truth's noise would be a ceiling for all of them, theirs is not."""
    views: int = 8
    """Test views, evenly around the object. Fewer leave sides of it unjudged."""
    relit_views: int | None = None
    """Views that are relit, in a ring of their own; None relights the test views, under one environment."""
    environments: int = 1
    """That those are relit under, one after the other."""

    def __post_init__(self) -> None:
        if self.relit_views is None and self.environments != 1:
            raise ValueError(f"{self.environments} environments: how many views are relit? give relit_views")

    @property
    def folder(self) -> str:
        """Name of its folder."""
        name = f"{self.resolution}px-{self.samples}spp-{self.views}views"
        return name if self.relit_views is None else f"{name}-{self.relit_views}x{self.environments}relit"

    def inputs(self) -> tuple[Camera, ...]:
        """The Zero123++ v1.2 rig."""
        return zero123plus_rig(DISTANCE, FOVY_DEG, self.resolution)

    def front(self) -> Camera:
        """The one true view."""
        return self._orbit(0.0, FRONT_ELEVATION_DEG)

    def tests(self) -> tuple[Camera, ...]:
        """Cameras that are none of the inputs."""
        return self._ring(self.views)

    def relit(self) -> tuple[Camera, ...]:
        """Cameras of the views that are relit."""
        return self._ring(self.views if self.relit_views is None else self.relit_views)

    def _ring(self, count: int) -> tuple[Camera, ...]:
        elevations = TEST_ELEVATIONS_DEG * count
        return tuple(self._orbit(7.5 + 360.0 / count * k, elevations[k]) for k in range(count))

    def _orbit(self, azimuth_deg: float, elevation_deg: float) -> Camera:
        return orbit_camera(azimuth_deg, elevation_deg, DISTANCE, FOVY_DEG, self.resolution, self.resolution)


QUICK = Protocol(samples=8, asset_samples=8, views=4)
"""Of `--quick`."""

PAPER_COUNTS = {"views": 32, "relit_views": 24, "environments": 6}
"""Of `--paper-protocol`: how many views and environments the paper compares (section 6)."""


@dataclass(frozen=True)
class EvaluationEntry:
    """One object to evaluate on.

    Attributes:
        name: its id.
        path: GLB, glTF or OBJ.
        kind: set of the manifest that it belongs to, such as "pbr" or "gso".
        picture: what a single-picture method is given instead of a render; None for a render.
    """

    name: str
    path: Path
    kind: str
    picture: Path | None = None

    @property
    def has_material(self) -> bool:
        """Whether roughness and metallic were measured, and count."""
        return self.kind not in ("gso", "omniobject3d")

    @property
    def up(self) -> str:
        """The axis that points up in an OBJ; scans of both sets stand on Z, which no OBJ can say."""
        return "Y" if self.has_material else "Z"


def chosen_for(name: str, choices: Sequence[Choice]) -> Choice:
    """One of the choices, the same for this object in every run."""
    return choices[zlib.crc32(name.encode()) % len(choices)]


def relit_lights(others: Sequence[Path], own: Sequence[Path], first: Path, count: int) -> list[Path]:
    """The environments that one object is relit under, the same in every run.

    Args:
        others: those of split eval, which come first.
        own: Blender's, taken evenly in their order for what is missing.
        first: the light of the inputs, which is not taken.
        count: of environments.
    Raises:
        ArmError: there are not so many.
    """
    found = [light for light in others if light != first][:count]
    rest = [light for light in own if light != first and light not in found]
    missing = count - len(found)
    if missing > len(rest):
        raise ArmError(f"{len(found) + len(rest)} environments, {count} are needed; name more in the manifest's hdris")
    return found + [rest[k * len(rest) // missing] for k in range(missing)]
