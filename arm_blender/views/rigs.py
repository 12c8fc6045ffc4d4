"""The camera rigs of pictures that come without poses."""

import math

from ..graphics.cameras import Camera, orbit_camera

AZIMUTHS_DEG = (30.0, 90.0, 150.0, 210.0, 270.0, 330.0)
ELEVATIONS_DEG = (20.0, -10.0, 20.0, -10.0, 20.0, -10.0)


def zero123plus_rig(distance: float = 4.0, fovy_deg: float = 30.0, size: int = 320) -> tuple[Camera, ...]:
    """The six cameras of Zero123++ v1.2 (its frame turned by -90 degrees about Z, so that the front is -Y).

    Args:
        distance: from the pinholes to the origin, world units.
        fovy_deg: vertical field of view, degrees.
        size: pixels a side.
    """
    return tuple(
        orbit_camera(azimuth, elevation, distance, fovy_deg, size, size)
        for azimuth, elevation in zip(AZIMUTHS_DEG, ELEVATIONS_DEG, strict=True)
    )


def front_camera(longest_px: float, size: int, elevation_deg: float = 10.0, fovy_deg: float = 30.0) -> Camera:
    """The camera of a single picture without a pose: azimuth 0, at the distance that puts its longest side at 2.

    Args:
        longest_px: the longer side of the object's bounding box in the picture, pixels.
        size: of the square picture, pixels a side; the object's bounding box is centred in it.
        elevation_deg: of the camera above the horizon, degrees.
        fovy_deg: of the square picture, degrees.
    """
    focal = size / (2.0 * math.tan(math.radians(fovy_deg) / 2.0))
    return orbit_camera(0.0, elevation_deg, 2.0 * focal / longest_px, fovy_deg, size, size)
