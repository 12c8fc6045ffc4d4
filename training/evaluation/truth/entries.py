"""The objects to evaluate on, from a manifest or as other sets lay them out."""

import zlib
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

from arm_blender.errors import ArmError

from ...rendering.manifest import read_manifest
from .protocol import EvaluationEntry

DATASETS = ("manifest", "gso", "omniobject3d", "folder")
PER_CATEGORY = 5
"""Objects of a category of OmniObject3D, as in the paper."""
MODELS = (".glb", ".gltf", ".obj")


def evaluation_entries(data: Path | None, dataset: str, split: str, sets: list[str] | None) -> list[EvaluationEntry]:
    """Everything to evaluate on, in the order of the names.

    Args:
        data: the folder; with a `manifest.json` for "manifest".
        dataset: one of `DATASETS`. "gso": a folder per object with `meshes/model.obj` and `thumbnails/0.jpg`, which is
            the paper's single picture. "omniobject3d": `<category>/<object>/Scan/Scan.obj`, five a category. "folder":
            GLB, glTF and OBJ files, with measured materials.
        split, sets: of the manifest; all sets for None.
    Raises:
        ArmError: nothing is found there.
    """
    if dataset == "manifest":
        entries = [
            EvaluationEntry(o["id"], data / o["main"], o["set"])
            for o in read_manifest(data)["objects"]
            if o["split"] == split and (not sets or o["set"] in sets)
        ]
    elif data is None:
        raise ArmError(f"--dataset {dataset}: no folder; give --data DIR")
    else:
        entries = list({"gso": _gso, "omniobject3d": _omniobject3d, "folder": _folder}[dataset](data))
    if not entries:
        raise ArmError(f"{data}: no object to evaluate on; check --data, --dataset, --split and --set")
    names = [entry.name for entry in entries]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ArmError(f"{data}: {', '.join(twice[:3])}: several objects of one name; rename them")
    return sorted(entries, key=lambda entry: entry.name)


def _gso(data: Path) -> Iterator[EvaluationEntry]:
    for mesh in data.glob("*/meshes/model.obj"):
        thumbnail = mesh.parents[1] / "thumbnails" / "0.jpg"
        yield EvaluationEntry(mesh.parents[1].name, mesh, "gso", thumbnail if thumbnail.is_file() else None)


def _omniobject3d(data: Path) -> Iterator[EvaluationEntry]:
    scans = sorted(data.glob("*/*/Scan/Scan.obj"))
    for _, group in groupby(scans, key=lambda path: path.parents[2]):
        for scan in list(group)[:PER_CATEGORY]:
            yield EvaluationEntry(scan.parents[1].name, scan, "omniobject3d")


def _folder(data: Path) -> Iterator[EvaluationEntry]:
    for path in data.rglob("*"):
        if path.suffix.lower() in MODELS:
            yield EvaluationEntry(path.stem, path, "folder")


def in_fair_order(entries: list[EvaluationEntry]) -> list[EvaluationEntry]:
    """The objects in an order that knows nothing of them, so that the first ones are a fair sample of all."""
    return sorted(entries, key=lambda entry: zlib.crc32(entry.name.encode()))


def spread(entries: list[EvaluationEntry], count: int) -> list[EvaluationEntry]:
    """`count` of the objects, as many of each set as there are, evenly over the names."""
    kinds = sorted({entry.kind for entry in entries})
    chosen = []
    for index, kind in enumerate(kinds):
        own = [entry for entry in entries if entry.kind == kind]
        share = min(len(own), count // len(kinds) + (index < count % len(kinds)))
        chosen += [own[k * len(own) // share] for k in range(share)]
    return sorted(chosen, key=lambda entry: entry.name)
