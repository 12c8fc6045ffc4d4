"""An asset read back from the folder that a run wrote, its maps as they were predicted."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..errors import ArmError
from ..graphics.color import linear_from_srgb
from ..graphics.light.spherical_harmonics import COUNT
from ..knobs.finishes import finish_of
from ..report import FILE_NAME
from ..structures import Regions, RelightableAsset, UvMesh
from ..uv.mesh_file import read_mesh
from . import FORMATS
from .textures import FOLDER, read_maps

_READABLE = ("glb", "obj")
"""Formats that the mesh is read from, the first that is there."""


@dataclass(frozen=True)
class WrittenAsset:
    """What a folder holds.

    Attributes:
        asset: with its predicted maps, and the finishes that are set in `maps.regions`.
        report: as report.json has it.
        formats: of `FORMATS`, those that are there.
    """

    asset: RelightableAsset
    report: dict[str, Any]
    formats: tuple[str, ...]


def read_asset(directory: Path) -> WrittenAsset:
    """The asset in a folder that `write_asset` wrote.

    Raises:
        ArmError: there is none, it was made before assets had regions, or a file is missing or spoilt; the line names
            the remedy.
    """
    report = _report(directory)
    name = report["name"]
    formats = tuple(kind for kind, form in FORMATS.items() if (directory / f"{name}{form.suffix}").is_file())
    readable = [kind for kind in _READABLE if kind in formats]
    if not readable:
        raise ArmError(f"{directory}: has neither {name}.glb nor {name}.obj; generate it again with --export glb")
    mesh = read_mesh(directory / f"{name}{FORMATS[readable[0]].suffix}")
    if not isinstance(mesh, UvMesh):
        raise ArmError(f"{directory}: the mesh of {name} has lost its UVs; generate it again")
    try:
        maps = read_maps(directory / FOLDER, report["values"], lambda index: _regions(index, report), _detailed(report))
        maps = replace(maps, light=_light(report))
        charts = int(report["charts"])
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ArmError(f"{directory / FILE_NAME}: does not fit its textures ({error}); generate it again") from error
    mesh = UvMesh(mesh.vertices, mesh.faces, mesh.uvs, mesh.face_uvs, charts)
    return WrittenAsset(RelightableAsset(name, mesh, maps), report, formats)


def _report(directory: Path) -> dict[str, Any]:
    path = directory / FILE_NAME
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(report, dict) or not isinstance(report["name"], str):
            raise ValueError("it names no asset")
    except (OSError, ValueError, KeyError, RecursionError) as error:
        line = f"{directory}: holds no whole asset ({error})"
        raise ArmError(f"{line}; give the folder that `arm generate` wrote") from error
    if not report.get("regions"):
        raise ArmError(f"{directory}: was made before assets had regions; generate it again")
    return report


def _detailed(report: Mapping[str, Any]) -> bool:
    """Whether the run made a normal map."""
    return "normal map" in report["seconds"] and all(note["what"] != "normal map" for note in report["left_out"])


def _light(report: Mapping[str, Any]) -> Tensor | None:
    """(9, 3) harmonics of a report; None where it has none, as those of earlier versions."""
    if report.get("light") is None:
        return None
    light = torch.tensor(report["light"]["harmonics"], dtype=torch.float32)
    if light.shape != (COUNT, 3) or not bool(light.isfinite().all()):
        raise ValueError(f"a light of {tuple(light.shape)} numbers")
    return light


def _regions(index: Tensor, report: Mapping[str, Any]) -> Regions:
    """The regions of a report, with the numbers (T, T) of their texels."""
    listed = report["regions"]
    if not 1 <= int(index.min()) <= int(index.max()) <= len(listed):
        raise ValueError(f"{len(listed)} regions, numbers to {int(index.max())}")
    swatches = []
    for one in listed:
        color = torch.tensor(list(bytes.fromhex(one["swatch"].removeprefix("#")))) / 255.0
        red, green, blue = linear_from_srgb(color).tolist()
        swatches.append((red, green, blue))
    finishes = {one["number"]: finish_of(one["finish"]) for one in listed if one["finish"] is not None}
    red, green, blue = report["view_light"]
    return Regions(index, tuple(one["share"] for one in listed), tuple(swatches), (red, green, blue), finishes)
