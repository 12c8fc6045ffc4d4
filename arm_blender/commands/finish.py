"""Set what the regions of an asset are made of, without generating it again."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import ArmError
from ..knobs.finishes import EXAMPLE, PRESETS, Finish, finishes_of, words_of
from . import UsageError, progress_line
from .generate import NO_BPY

if TYPE_CHECKING:
    from ..structures import RelightableAsset


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("asset", type=Path, metavar="ASSET", help="the folder that `generate` wrote")
    words = f"as {EXAMPLE}: roughness/metallic, or {', '.join(PRESETS)}"
    parser.add_argument("--set", dest="finishes", metavar="N=FINISH,...", help=words)
    parser.add_argument("--reset", action="store_true", help="take back what was set before; alone: all as predicted")
    parser.add_argument("--json", action="store_true", help="print the regions as JSON on stdout")
    progress_line.add_option(parser)


def run(args: argparse.Namespace) -> int:
    asked = _asked(args.finishes)
    directory = args.asset.parent if args.asset.is_file() else args.asset
    from ..export import rewrite_asset
    from ..export.asset_folder import read_asset
    from ..uv.finish import described

    with progress_line.shown(args.progress) as progress:
        progress(0.0, "reading the asset")
        written = read_asset(directory)
        regions = written.asset.maps.regions
        assert regions is not None  # `read_asset` has refused a folder without.
        for number in sorted(asked):
            if number > regions.count:
                raise ArmError(f"{directory}: has no region {number}; regions.png shows 1 to {regions.count}")
        files = []
        if asked or args.reset:
            finishes = asked if args.reset else {**regions.finishes, **asked}
            regions = replace(regions, finishes=finishes)
            maps = replace(written.asset.maps, regions=regions)
            asset = replace(written.asset, maps=maps)
            report = written.report | {"regions": described(maps)} | _not_checked(written.report)

            def blender_files(stage: Path) -> None:
                progress(0.6, "writing the .blend")
                _write_blender_files(asset, directory, stage, words_of(finishes))

            files = rewrite_asset(asset, report, directory, written.formats, progress, blender_files)
            written = replace(written, asset=asset, report=report)
    if args.json:
        json.dump(written.report["regions"], sys.stdout, indent=2)
        print()
    else:
        for one in written.report["regions"]:
            print(f"{one['number']}  {one['swatch']}  {one['share']:6.1%}  {one['finish'] or 'as predicted'}")
        print(*files, sep="\n", end="\n" if files else "")
    return 0


def _asked(words: str | None) -> dict[int, Finish]:
    """The finishes on the command line.

    Raises:
        UsageError: they are none.
    """
    try:
        return {} if words is None else finishes_of(words)
    except ArmError as error:
        raise UsageError(f"--set {error}") from error


def _not_checked(report: dict[str, Any]) -> dict[str, Any]:
    """The light in a report without what was measured by it: that was of the asset as it was."""
    light = report.get("light")
    return {} if light is None else {"light": light | {"psnr": None, "views": []}}


def _write_blender_files(asset: RelightableAsset, directory: Path, stage: Path, words: str) -> None:
    """The .blend and the preview, those of them that the folder has.

    Raises:
        ArmError: there are some, and no bpy to write them with: they would show another material than the rest.
    """
    name = f"{asset.name}.blend"
    if not (directory / name).is_file():
        return
    try:
        from ..blender.asset import blend_file
        from ..blender.relight import renders
    except ImportError as error:
        raise ArmError(f"{directory / name}: {NO_BPY} ({error}), or move the file away") from error
    kept = blend_file.kept_settings(directory / name)
    blend_file.save_blend(asset, stage / name, kept | {"finish": words or None})
    # As Blender keeps what it writes over: somebody may have worked in it.
    shutil.copy2(directory / name, stage / f"{name}1")
    if (directory / "preview.png").is_file():
        renders.preview(stage / name, stage / "preview.png")
