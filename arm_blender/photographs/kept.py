"""What is kept beside the views of photographs whose cameras were solved."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..knobs import USUAL_VIEWS
from ..views.transforms_json import TRANSFORMS
from .cut_out import PAINTED

KEPT = "cameras.json"
"""In a folder of views: of which pictures they are, and how far their cameras are to be trusted."""


@dataclass(frozen=True)
class Kept:
    """What is kept beside views of solved cameras, for the next run and for whoever asks what became of a picture.

    Attributes:
        source: what the cameras depend on.
        facts: how they were solved, and how far they are to be trusted.
        left_out: what was not used, and why; of pictures their names.
        found: of each picture its name and a way that its mask was found by, or a doubt about it (`DOUBTFUL`).
        by_hand: the pictures whose mask was painted.
        painted: the files of those masks, as they were.
        views: that were asked for.
    """

    source: dict[str, Any]
    facts: dict[str, Any]
    left_out: dict[str, str]
    found: list[tuple[str, str]]
    by_hand: list[str]
    painted: dict[str, list[int]]
    views: int = USUAL_VIEWS

    @property
    def ways(self) -> list[tuple[str, str]]:
        """How each picture was cut out in the end: what is said of a mask that was found does not count for another."""
        found = [(name, way) for name, way in self.found if name not in self.by_hand]
        return found + [(name, PAINTED) for name in self.by_hand]


def read_kept(folder: Path) -> Kept:
    """What is kept beside the views in `folder`.

    Raises:
        OSError, ValueError, TypeError, KeyError: nothing is, or it is damaged.
    """
    data = json.loads((folder / KEPT).read_text(encoding="utf-8"))
    return Kept(
        dict(data["source"]),
        dict(data["facts"]),
        dict(data["left_out"]),
        [(str(name), str(way)) for name, way in data.get("found", ())],
        list(data.get("by_hand", ())),
        dict(data.get("painted", {})),
        int(data.get("views", USUAL_VIEWS)),
    )


def kept_of(folder: Path, source: dict[str, Any]) -> Kept | None:
    """What an earlier run wrote of the same pictures, where its views are still there."""
    try:
        kept = read_kept(folder)
        frames = json.loads((folder / TRANSFORMS).read_text(encoding="utf-8"))["frames"]
        same = kept.source == source and all((folder / frame["file_path"]).is_file() for frame in frames)
        return kept if same else None
    except (OSError, ValueError, KeyError, TypeError):
        return None
