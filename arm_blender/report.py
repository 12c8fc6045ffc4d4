"""What a run did: seconds per stage, sizes, and what was left out and why. It becomes report.json."""

import re
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .machine.files import write_json
from .version import VERSION

FILE_NAME = "report.json"
"""Written last: the file that marks an asset's folder as whole."""

DOUBTFUL = "doubtful: "
"""Begins what is said of a mask instead of the way that it was found by."""


@dataclass(frozen=True)
class LeftOut:
    """One thing that the run did not do or did not use, and the reason."""

    what: str
    why: str


@dataclass
class Report:
    """Collected along the run.

    Attributes:
        preset: name of the networks' preset.
        device: where the networks ran.
        seed: of the random generators.
        version: of the program.
        name: of the asset; None before it has one.
        views: what it was made of, as `export.one_asset.source_of` names that.
        seconds: per stage, in the order in which they began; a stage that runs twice adds up.
        faces: triangles of the result.
        charts: charts of its atlas.
        texture_size: texels a side of its largest map.
        seen_share: of the covered texels, how many at least one view sees, in [0, 1].
        gains: factors that brought the views' red, green and blue to one exposure, a view each; None where it was one.
        weights: the networks' weights by their names, and their licences: what is made with them may be bound by those.
        masks: by which way the pictures were cut out, and the names of those.
        doubts: why the result may be wrong, a sentence each.
        photographs: which way the pictures got their cameras and by what rule; of solved ones, how far they are to be
            trusted, and why not further.
        refinement: rounds in which the shape was moved to meet its pictures, seconds, how far its outlines lay from
            theirs before and after, pixels, how much each view was trusted, and whether the object was taken for
            symmetric; None where there was none.
        regions: parts of one finish: number, share of the surface, colour, what roughness and metallic are predicted in
            the mean, and the finish where one was set.
        values: maps that are one value as predicted, by name.
        light: of the views as predicted: `harmonics` (9 of red, green and blue), and how near the asset under it comes
            to them, `psnr` in dB (`light_check.rerendering`), in the mean and of each of `views`; None without.
        view_light: linear Rec.709, the light in the views' colours (`structures.Regions`); None without regions.
        left_out: what was not done, and why.
    """

    preset: str
    device: str
    seed: int
    version: str = VERSION
    name: str | None = None
    views: str | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    faces: int | None = None
    charts: int | None = None
    texture_size: int | None = None
    seen_share: float | None = None
    gains: list[list[float]] | None = None
    weights: dict[str, str] = field(default_factory=dict)
    masks: dict[str, list[str]] = field(default_factory=dict)
    doubts: list[str] = field(default_factory=list)
    photographs: dict[str, Any] = field(default_factory=dict)
    refinement: dict[str, Any] | None = None
    regions: list[dict[str, Any]] = field(default_factory=list)
    values: dict[str, float] = field(default_factory=dict)
    light: dict[str, Any] | None = None
    view_light: list[float] | None = None
    left_out: list[LeftOut] = field(default_factory=list)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Adds the seconds that the block takes to the stage `name`, also when it ends in an exception."""
        start = time.perf_counter()
        self.seconds.setdefault(name, 0.0)
        try:
            yield
        finally:
            self.seconds[name] += time.perf_counter() - start

    def leave_out(self, what: str, why: str) -> None:
        """Notes that `what` was not done, and `why`; once, however often it is said."""
        note = LeftOut(what, why)
        if note not in self.left_out:
            self.left_out.append(note)

    def doubt(self, *reasons: str) -> None:
        """Notes why the result may be wrong; each reason once, however often it is said."""
        self.doubts += [why for why in dict.fromkeys(reasons) if why not in self.doubts]

    def note_mask(self, picture: str, way: str) -> None:
        """Notes by which way a picture was cut out, or what is doubtful about its mask (`DOUBTFUL`, then why)."""
        self.masks.setdefault(way, []).append(picture)

    @property
    def all_doubts(self) -> list[str]:
        """Why the result may be wrong: `doubts`, and those about masks, a sentence for all pictures with the same."""
        found = list(self.doubts)
        for way, names in self.masks.items():
            if way.startswith(DOUBTFUL):
                more = f" and {len(names) - 3} more" if len(names) > 3 else ""
                found.append(f"the mask of {', '.join(names[:3])}{more}: {way.removeprefix(DOUBTFUL)}")
        return found

    def as_dict(self) -> dict[str, Any]:
        """The report as JSON types; `peak_memory_mib` is the process's highest resident size until now."""
        return {
            "version": self.version,
            "name": self.name,
            "views": self.views,
            "preset": self.preset,
            "device": self.device,
            "seed": self.seed,
            "seconds": {name: round(seconds, 3) for name, seconds in self.seconds.items()},
            "total_seconds": round(sum(self.seconds.values()), 3),
            "peak_memory_mib": peak_memory_mib(),
            "weights": self.weights,
            "faces": self.faces,
            "charts": self.charts,
            "texture_size": self.texture_size,
            "seen_share": None if self.seen_share is None else round(self.seen_share, 4),
            "gains": None if self.gains is None else [[round(gain, 3) for gain in view] for view in self.gains],
            "masks": {way: names for way, names in self.masks.items() if not way.startswith(DOUBTFUL)},
            "doubts": self.all_doubts,
            "photographs": self.photographs,
            "refinement": self.refinement,
            "regions": self.regions,
            "values": self.values,
            "light": self.light,
            "view_light": self.view_light,
            "left_out": [{"what": note.what, "why": note.why} for note in self.left_out],
        }

    def write(self, path: Path) -> None:
        """`as_dict` as a JSON file, whole or not at all.

        Raises:
            OutputError: it cannot be written.
        """
        write_json(path, self.as_dict())


_UNITS_PER_MIB = 2**20 if sys.platform == "darwin" else 2**10  # macOS counts bytes, Linux KiB.


def peak_memory_mib() -> float | None:
    """Highest resident size of this process or of one of its children so far, MiB; None where no one counts it."""
    own = own_peak_mib()
    if own is None:
        return None
    import resource

    return round(max(own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / _UNITS_PER_MIB), 1)


def own_peak_mib() -> float | None:
    """As `peak_memory_mib`, of this process alone."""
    # Linux lets a process inherit the peak of the one that started it; what is its own stands in its status.
    status = Path("/proc/self/status")
    found = re.search(r"VmHWM:\s*(\d+) kB", status.read_text()) if status.exists() else None
    if found:
        return int(found[1]) / 2**10
    try:
        import resource
    except ImportError:  # Windows has no getrusage.
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _UNITS_PER_MIB
