"""What became of each photograph of a capture, read from what is kept beside its views. No bpy in this module."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class ToldPicture:
    """One photograph, as the panel tells of it.

    Attributes:
        name: of its file.
        view: name of the view's file that was made of it; empty where none was.
        picture: name of the file to paint a mask for: that of its view, or of what became none because of its mask;
            empty where there is neither.
        registered: its camera is known.
        why: why it is no view; or what was mended about the mask of its view; empty where there is nothing to say.
        way: how it was cut out, in a word or two; empty where it was not.
        doubt: why its mask may be wrong; empty where nothing speaks against it.
        sharpness: of the object, beside that of the pictures around; None where it was not measured.
    """

    name: str
    view: str
    picture: str
    registered: bool
    why: str
    way: str
    doubt: str
    sharpness: float | None

    @property
    def short(self) -> str:
        """What a row has room for."""
        if self.view:
            return f"doubtful: {self.doubt}" if self.doubt else self.way
        for mark in (":", ";", " ("):
            if mark in self.why:
                return self.why.partition(mark)[0]
        return self.why

    @property
    def whole(self) -> str:
        """All that is known, in sentences."""
        said = [] if self.view else [f"No view: {self.why or 'it was not needed'}"]
        said += [f"Mask by {self.way}"] if self.way else []
        said += [f"doubtful: {self.doubt}"] if self.doubt else []
        said += [f"mask mended: {self.why}"] if self.view and self.why else []
        said += [f"sharpness {self.sharpness:.2f} of that of its neighbours"] if self.sharpness is not None else []
        return "; ".join(said)


def told_pictures(folder: Path) -> tuple[ToldPicture, ...]:
    """Of every photograph that the views in `folder` were made of, by name; none where nothing is kept there."""
    from ...photographs.cut_out import PAINTED
    from ...photographs.kept import read_kept
    from ...photographs.painted import UNUSED, older_views
    from ...photographs.solved import SOLVED
    from ...report import DOUBTFUL
    from ...views.mask_files import FOLDER as MASKS
    from ...views.transforms_json import TRANSFORMS

    try:
        kept = read_kept(folder)
        solved = json.loads((folder / SOLVED).read_text(encoding="utf-8"))
        cameras, sharpness = set(solved["cameras"]), dict(solved.get("sharpness", {}))
    except (OSError, ValueError, KeyError, TypeError):
        return ()
    views = {one.photograph: one.picture for one in older_views(folder / TRANSFORMS)}
    if not views:
        return ()
    pictures = {one.photograph: one.picture for one in older_views(folder / UNUSED)} | views
    ways: dict[str, str] = {}
    doubts: dict[str, str] = {}
    for name, way in kept.ways:
        if way.startswith(DOUBTFUL):
            doubts[name] = way.removeprefix(DOUBTFUL)
        else:
            ways[name] = way
    for name, view in pictures.items():
        if (folder / MASKS / view).with_suffix(".png").is_file():  # Which counts in the next run, if not in the last.
            ways[name] = PAINTED
            doubts.pop(name, None)
    known = {*cameras, *views, *ways}
    mended = {name: why for name in known if (why := kept.left_out.get(f"the mask of {name} as it was found"))}
    names = known | {name for name in kept.left_out if not name.startswith("the mask of ")}
    return tuple(
        ToldPicture(
            name,
            views.get(name, ""),
            pictures.get(name, ""),
            name in cameras,
            mended.get(name, "") if name in views else kept.left_out.get(name, ""),
            ways.get(name, ""),
            doubts.get(name, ""),
            sharpness.get(name),
        )
        for name in sorted(names)
    )
