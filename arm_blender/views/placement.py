"""Where a finished asset stands, and how large it is."""

from dataclasses import replace

import torch

from ..structures import RelightableAsset
from .scene_frame import SceneFrame


def on_the_ground(asset: RelightableAsset, size: float | None = None) -> tuple[RelightableAsset, SceneFrame]:
    """The asset standing on z = 0, the middle of its bounding box over the origin.

    Args:
        asset: in any frame.
        size: of its longest side, world units; None keeps it.
    Returns:
        the asset, and the frame whose `restore` brings its vertices back.
    """
    vertices = asset.mesh.vertices
    low, high = vertices.amin(dim=0), vertices.amax(dim=0)
    foot = torch.stack([(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0, low[2]])
    extent = float((high - low).max())
    frame = SceneFrame(foot, 1.0 if size is None or extent == 0.0 else extent / size)
    return replace(asset, mesh=asset.mesh.moved(frame.boxed)), frame
