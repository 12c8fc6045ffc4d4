"""Samples on disk: a folder per object with `mesh.npz`, `occupancy.npz` and one `rig_<k>.npz` per rendered rig.

rig_<k>.npz, V views of S x S pixels, the first six of them inputs: rgba (V, S, S, 4) uint8 sRGB with straight alpha,
albedo (V, S, S, 3) uint8 sRGB, roughness and metallic (V, S, S) uint8, depth (V, S, S) float16 along the view axis with
infinity as background, normal (V, S, S, 3) int8 world, c2w (V, 4, 4), K (V, 3, 3).
mesh.npz, the true surface: vertices (N, 3) float32 world, faces (F, 3) int32.
occupancy.npz, points around it: points (P, 3) float16 world, distance (P,) float16 world units, positive inside.
"""

import json
from pathlib import Path

import numpy as np
import torch

from arm_blender.errors import ArmError
from arm_blender.files import whole_file
from arm_blender.graphics.cameras import Camera
from arm_blender.structures import TriangleMesh


def save_arrays(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """A compressed npz, whole or not at all.

    Raises:
        OutputError: the file cannot be written.
    """
    with whole_file(path) as temporary:
        np.savez_compressed(temporary, **arrays)


def rigs(shards: Path) -> list[Path]:
    """Every `rig_<k>.npz`, in a stable order.

    Raises:
        ArmError: there is none.
    """
    return _found(shards, "*/rig_*.npz")


def meshes(shards: Path) -> list[Path]:
    """The `mesh.npz` of every object, in a stable order.

    Raises:
        ArmError: there is none.
    """
    return _found(shards, "*/mesh.npz")


def read_mesh(path: Path) -> TriangleMesh:
    """The true surface in a `mesh.npz`, in the frame of the cameras; its vertices may be split at seams."""
    with np.load(path) as file:
        return TriangleMesh(torch.from_numpy(file["vertices"]).float(), torch.from_numpy(file["faces"]).long())


def real_objects(data: Path | None) -> frozenset[str]:
    """Names of the scanned and measured objects of a data folder; none without a folder.

    They are few among many low-poly ones, and what users bring looks like them.
    """
    if data is None:
        return frozenset()
    manifest = json.loads((Path(data) / "manifest.json").read_text())
    return frozenset(entry["id"] for entry in manifest["objects"] if entry["set"] in ("gso", "pbr"))


def cameras(arrays: dict[str, np.ndarray]) -> tuple[Camera, ...]:
    """The cameras of one rig."""
    size = arrays["rgba"].shape[1]
    return tuple(
        Camera(torch.from_numpy(c2w), torch.from_numpy(K), size, size)
        for c2w, K in zip(arrays["c2w"], arrays["K"], strict=True)
    )


def _found(shards: Path, pattern: str) -> list[Path]:
    found = sorted(shards.glob(pattern))
    if not found:
        raise ArmError(f"{shards}: no samples; make them with `python -m training render --data DIR --output {shards}`")
    return found
