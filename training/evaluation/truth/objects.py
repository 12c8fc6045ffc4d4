"""The objects to evaluate on: posed views as a user would bring them, with the true mesh beside them."""

from dataclasses import dataclass
from pathlib import Path

from arm_blender.errors import ArmError
from arm_blender.structures import TriangleMesh, ViewSet
from arm_blender.views import ViewOptions, load_views

from ...rendering.manifest import read_manifest
from ...rendering.shards import read_mesh


@dataclass(frozen=True)
class EvaluationObject:
    """One folder written by `python -m training render --layout views`.

    Attributes:
        name: the object's id.
        folder: holds `transforms.json`, the views, and `mesh.npz`.
    """

    name: str
    folder: Path

    def views(self) -> ViewSet:
        """The posed views, loaded as `generate` loads them."""
        return load_views(self.folder, ViewOptions())

    def truth(self) -> TriangleMesh:
        """The true mesh in the frame of the cameras; its longest side is 2.

        Raises:
            ArmError: the mesh is missing.
        """
        path = self.folder / "mesh.npz"
        if not path.exists():
            raise ArmError(f"{path}: no true mesh to compare with; render the views again")
        return read_mesh(path)


def evaluation_objects(
    views: Path, data: Path | None = None, sets: tuple[str, ...] = ("gso",), split: str = "eval"
) -> list[EvaluationObject]:
    """The objects in a folder of views, in the order of their names.

    Args:
        views: `views/<id>/transforms.json` per object.
        data: folder with `manifest.json`, which tells set and split apart; without it every object counts.
        sets: the manifest's sets to take.
        split: the manifest's split to take.
    Raises:
        ArmError: nothing to evaluate, or an object of the manifest has no views: a mean over fewer objects than
            asked for would not be comparable.
    """
    found = {path.parent.name: path.parent for path in sorted(views.glob("*/transforms.json"))}
    names = list(found)
    if data is not None:
        entries = read_manifest(data)["objects"]
        names = sorted(entry["id"] for entry in entries if entry["set"] in sets and entry["split"] == split)
    missing = [name for name in names if name not in found]
    if missing:
        raise ArmError(
            f"{views}: no views of {', '.join(missing)}; make them with "
            f"`python -m training render --layout views --set {' '.join(sets)} --split {split} --output {views}`"
        )
    if not names:
        raise ArmError(f"{views}: no folder holds a transforms.json; make views with `python -m training render`")
    return [EvaluationObject(name, found[name]) for name in names]
