"""`python -m training gallery`: pictures of what the program makes of pictures, and the page that shows them.

Every asset is made by the command that a user would give. What lies in the output folder already is shown as it is.
"""

import argparse
import logging
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

from PIL import Image, ImageOps
from torch import Tensor

from arm_blender.blender.relight.renders import RelightConfig, relight
from arm_blender.commands.progress_line import Counted
from arm_blender.errors import ArmError
from arm_blender.export.asset_folder import read_asset
from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.color import composite
from arm_blender.graphics.meshes import in_unit_ball
from arm_blender.machine.files import whole_file
from arm_blender.machine.picture_files import SUFFIXES
from arm_blender.structures import RelightableAsset

from ..documents import fill_block, paragraphs
from ..evaluation.tables.contact_sheet import TILE, square_tile, tiled
from ..evaluation.trials.asset_pictures import map_pictures
from ..evaluation.trials.capture_trial import REFUSED, answer
from ..rendering.manifest import read_manifest

logger = logging.getLogger(__name__)

LIGHTS = ("interior", "sunset", "forest")
"""Environments of Blender's own: whoever has it can make the same pictures."""

SHOWN = 3
"""Pictures that went in, at most."""

AZIMUTH, ELEVATION, DISTANCE, FOVY = 30.0, 15.0, 6.0, 20.0
"""From where it is shown, degrees; distance in radii of the object."""

TURNS, SIDE, FRAME_MS = 32, 320, 80
"""Pictures of a turn, pixels a side, milliseconds each."""


@dataclass(frozen=True)
class Item:
    """What the gallery shows once.

    Attributes:
        source: a picture, or a folder of views or photographs. name: of its row and of its asset.
    """

    source: Path
    name: str


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training gallery`."""
    parser.add_argument("sources", type=Path, nargs="+", help="a picture, a folder of views or of photographs, each")
    parser.add_argument("--data", type=Path, nargs="*", default=(), help="folders with manifest.json, for the credits")
    parser.add_argument("--output", type=Path, default=Path("out/gallery"), help="folder of the assets")
    parser.add_argument("--quality", default="balanced")
    parser.add_argument("--samples", type=int, default=48, help="of Cycles, a pixel")
    parser.add_argument("--pictures", type=Path, default=Path("docs/images/gallery"), help="folder of the rows")
    parser.add_argument("--document", type=Path, help="Markdown file whose block `gallery` is filled")
    parser.add_argument("--turntable", type=Path, help="an animated WebP of the first one")


def run(args: argparse.Namespace) -> int:
    """Make the assets, show them; returns the exit status.

    Raises:
        ArmError: one cannot be made.
    """
    credit = {entry["id"]: entry for data in args.data for entry in read_manifest(data)["objects"]}
    items = [Item(source, name_of(source)) for source in args.sources]
    parts, count = [], Counted(len(items), logger.info)
    for item in items:
        asset, file = made(item, args.output / item.name, args.quality)
        picture = args.pictures / f"{item.name}.jpg"
        save_row(picture, item, asset, file, args.samples)
        if args.turntable is not None and item is items[0]:
            save_turntable(args.turntable, file, args.samples)
        if args.document is not None:
            path = picture.resolve().relative_to(args.document.resolve().parent).as_posix()
            parts.append(f"![What went in, the asset in three lights, its maps]({path})\n\n*{credited(item, credit)}*")
        count(item.name)
    text = paragraphs(*parts, f"Made by `{args.command}`.")
    if args.document is not None:
        fill_block(args.document, "gallery", text)
    return 0


def name_of(source: Path) -> str:
    """Of a picture its folder's name where that tells more: views are called 000.png."""
    if source.is_file():
        return f"{source.parent.name}-{source.stem}" if source.stem.isdecimal() else source.stem
    return source.parent.name if source.name in ("images", "views") else source.name


def made(item: Item, output: Path, quality: str) -> tuple[RelightableAsset, Path]:
    """The asset of an item and its .glb, made where `output` has none.

    Raises:
        ArmError: the program refuses it.
    """
    if not (output / "report.json").exists():
        said = answer(item.source, output, quality)
        if said.said == REFUSED:
            raise ArmError(f"{item.source}: no asset ({said.words}); show another one")
    return read_asset(output).asset, next(output.glob("*.glb"))


def save_row(path: Path, item: Item, asset: RelightableAsset, file: Path, samples: int) -> None:
    """A JPEG: what went in, the asset under each of `LIGHTS`, and its three maps."""
    taken = [ImageOps.exif_transpose(Image.open(one)) for one in pictures_of(item.source)]
    row: list[tuple[str, Tensor | None]] = [("in", square_tile(_on_white(one))) for one in taken]
    with tempfile.TemporaryDirectory(prefix="arm-gallery-") as folder:
        config = RelightConfig(resolution=2 * TILE, samples=samples, azimuth_deg=AZIMUTH, elevation_deg=ELEVATION)
        renders = relight(file, LIGHTS, folder, config)
        row += [
            (light, square_tile(_on_white(Image.open(render)))) for light, render in zip(LIGHTS, renders, strict=True)
        ]
    row += list(maps_of(asset).items())
    sheet = tiled([row], len(row))
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        sheet.save(temporary, format="JPEG", quality=88)


def pictures_of(source: Path) -> list[Path]:
    """A few of the pictures that went in, evenly chosen."""
    if source.is_file():
        return [source]
    found = sorted(path for path in source.iterdir() if path.suffix.lower() in SUFFIXES)
    return found[:: max(1, len(found) // SHOWN)][:SHOWN]


def maps_of(asset: RelightableAsset) -> dict[str, Tensor]:
    """(3, S, S) in [0, 1]: albedo, roughness and metallic as one sees them on the object, by their names."""
    boxed = replace(asset, mesh=asset.mesh.moved(in_unit_ball))
    seen = map_pictures(boxed, [orbit_camera(AZIMUTH, ELEVATION, DISTANCE, FOVY, 2 * TILE, 2 * TILE)])
    maps = {"albedo": seen.albedo, "roughness": seen.roughness, "metallic": seen.metallic}
    return {name: composite(values, seen.alpha, 1.0)[0].expand(3, -1, -1) for name, values in maps.items()}


def save_turntable(path: Path, file: Path, samples: int) -> None:
    """An animated WebP: a full turn in one light, then in another."""
    config = RelightConfig(resolution=SIDE, samples=samples, turntable=TURNS, elevation_deg=ELEVATION)
    with tempfile.TemporaryDirectory(prefix="arm-gallery-") as folder:
        renders = relight(file, LIGHTS[:2], folder, config)
        pictures = [_on_white(Image.open(render)) for render in renders]
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        pictures[0].save(
            temporary, format="WEBP", save_all=True, append_images=pictures[1:], duration=FRAME_MS, loop=0, quality=70
        )


def credited(item: Item, known: dict[str, dict[str, str]]) -> str:
    """The caption: the name, who made the object, and its licence."""
    entry = next((known[name] for name in sorted(known, key=len, reverse=True) if item.name.startswith(name)), None)
    return item.name if entry is None else f"{item.name}: {entry['attribution']}, {entry['licence']}"


def _on_white(picture: Image.Image) -> Image.Image:
    rgba = picture.convert("RGBA")
    return Image.alpha_composite(Image.new("RGBA", rgba.size, "white"), rgba).convert("RGB")
