"""Samples of finish: what views show of points of measured objects, and the roughness and metallic there.

The points lie on the true shape and on the one that GeoRM makes of the views, whose normals are wrong as in the
program. All six input views see them, or three, which have a read-out of their own.
"""

import logging
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from arm_blender.commands.progress_line import Counted
from arm_blender.models.small.delighting import SeenPoints
from arm_blender.models.small.finish_evidence import evidence
from arm_blender.structures import TriangleMesh

from ..rendering import shards
from .delighting_samples import FACES, FEWEST, carried
from .gloss_samples import Shapes

logger = logging.getLogger(__name__)

VIEWS = (6, 3)
"""How many of the input views a sample has."""

POINTS = 1024
"""Of a sample; as many as the program looks at, so that neighbours are as far."""

FAMILIES = ("chess", "franka ur iws", "xr", "needle", "ms", "ph_painted", "ph_wooden", "teacup tea_set")
"""Beginnings, or parts, of the names of objects that share a maker, a set or a texture: knowing one, one knows the
others."""


@dataclass(frozen=True)
class FinishSample:
    """P points of one object.

    Attributes:
        name: of the object.
        views: how many see it.
        true_shape: whether they lie on the true surface.
        found: (P, N) as of `evidence`.
        truth: (P, 2) roughness and metallic in [0, 1], blended from the views' as `SeenPoints.blended` blends colours.
    """

    name: str
    views: int
    true_shape: bool
    found: Tensor
    truth: Tensor


def family(name: str) -> str:
    """The family of an object by its name; its own name where it has none."""
    for words in FAMILIES:
        for word in words.split():
            if name.startswith(f"{word}_") or ("tea" in word and word in name):
                return words
    return "chess" if "chess" in name else name


def prepare(folder: Path, cache: Path, shapes: Shapes) -> int:
    """Make the samples of all rigs of a folder of shards that a cache lacks; returns how many it has."""
    rigs = shards.rigs(folder)
    count = Counted(2 * len(rigs), logger.info)
    for path in rigs:
        for kind in ("true", "georm"):
            wanted = {k: cache / f"{path.parent.name}.{path.stem}.{kind}.{k}.npz" for k in VIEWS}
            if all(target.exists() for target in wanted.values()):
                count.skip()
                continue
            true = kind == "true"
            mesh = shards.read_mesh(path.with_name("mesh.npz")) if true else shapes.refined(path, FACES)
            if not len(mesh.faces):
                count.skip()
                continue
            _save(mesh, path, wanted)
            count(f"prepared {path.parent.name}, its {kind} shape")
    return len(list(cache.glob("[!.]*.npz")))


def _save(mesh: TriangleMesh, path: Path, wanted: dict[int, Path]) -> None:
    """Write the samples of one rig on one shape, by their number of views."""
    rig = shards.arrays(path, "rgba", "roughness", "metallic", "c2w", "K")
    rig["albedo"] = np.stack([rig[name] for name in ("roughness", "metallic", "metallic")], axis=-1)
    carrying = carried(mesh, rig, torch.Generator().manual_seed(0), lambda gloss: gloss, surely=False)
    if carrying is None:
        return
    points, truth = carrying
    for count, target in wanted.items():
        random = torch.Generator().manual_seed(zlib.crc32(target.name.encode()))
        chosen = torch.randperm(points.visible.shape[1], generator=random)[:count]
        known = points.visible[0, chosen].any(dim=0).nonzero()[:POINTS, 0]
        if len(known) >= FEWEST:
            some = points.only(known)
            few = (some.color[:, chosen], some.visible[:, chosen], some.eyes[:, chosen])
            found = evidence(SeenPoints(some.position, some.normal, *few))
            arrays = {"found": found.half().numpy(), "truth": truth[0, known, :2].half().numpy()}
            shards.save_arrays(target, arrays)


def samples(cache: Path) -> Iterator[FinishSample]:
    """All that a cache holds, in the order of the names."""
    for path in sorted(cache.glob("[!.]*.npz")):
        arrays = {name: torch.from_numpy(array).float() for name, array in shards.arrays(path).items()}
        name, _, kind, views, _ = path.name.rsplit(".", 4)
        yield FinishSample(name, int(views), kind == "true", arrays["found"], arrays["truth"])
