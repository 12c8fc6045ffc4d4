"""The words of `python -m training render` for its layouts `capture` and `scenes`, and what they start."""

import argparse
import logging
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from arm_blender.commands.progress_line import Counted
from arm_blender.commands.workers import side_by_side
from arm_blender.errors import ArmError

from ..assets import Asset, in_order
from .rig import PICTURES, SPOILT, CaptureConfig
from .surroundings import ground_textures

logger = logging.getLogger(__name__)

SCENES_TASK = "training.rendering.captures.scenes_blender"
"""Its `answer(item, words)` renders one object's pictures."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of both layouts."""
    parser.add_argument("--pictures", type=int, help="of a capture, 12 to 40, 24 by default; of an object's scenes, 4")
    parser.add_argument("--settings", type=int, default=1, help="captures of an object, each in another place")
    parser.add_argument("--k1", type=float, default=0.0, help="radial distortion of a capture's lens, -0.1 to 0.1")
    parser.add_argument("--spoilt", choices=SPOILT, help="what is wrong with a capture on purpose")
    parser.add_argument("--clutter", action="store_true", help="things stand around the object of a capture")


def run(assets: Sequence[Asset], hdris: Sequence[Path], args: argparse.Namespace, render: dict[str, Any]) -> int:
    """Render what is not rendered yet; the exit status.

    Raises:
        ArmError: an option is out of its range, or there is no texture or environment.
    """
    hdris = [path.resolve() for path in hdris]
    if args.layout == "scenes":
        # Without a data folder grounds have one colour each, under Blender's own environments.
        return _scenes(
            assets, hdris, ground_textures(args.data.resolve(), args.split) if args.data else [], args, render
        )
    if args.data is None or not hdris:
        raise ArmError(
            "--layout capture: needs textures for the ground and environment maps; give a folder with both, --data DIR"
        )
    textures = ground_textures(args.data.resolve(), args.split)
    from ..passes_blender import RenderConfig
    from .capture_blender import render_captures

    config = CaptureConfig(args.pictures or 24, args.resolution, args.k1, args.spoilt, args.clutter, args.seed)
    if not (PICTURES[0] <= config.pictures <= PICTURES[1] and abs(config.k1) <= 0.1):
        raise ArmError(f"--pictures {config.pictures} --k1 {config.k1}: give 12 to 40 pictures, and k1 of -0.1 to 0.1")
    device = RenderConfig(**render, gpu=not args.cpu)
    return render_captures(assets, hdris, textures, args.output, device, config, args.settings)


def _scenes(
    assets: Sequence[Asset],
    hdris: Sequence[Path],
    textures: Sequence[Path],
    args: argparse.Namespace,
    render: dict[str, Any],
) -> int:
    words = {
        "output": str(args.output.resolve()),
        "render": render | {"gpu": not args.cpu},
        "scenes": {"views": args.pictures or 4, "seed": args.seed},
        "hdris": [str(path) for path in hdris],
        "own_hdris": not args.hdri and args.split == "train",
        "textures": [str(path) for path in textures],
    }
    waiting = [asdict(asset) for asset in in_order(assets) if not (args.output / f"{asset.key}.npz").exists()]
    failed, count = 0, Counted(len(waiting), logger.info)
    for item, answer in side_by_side(waiting, args.jobs, SCENES_TASK, words) if waiting else ():
        dropped = "its process died over it" if answer is None else answer["dropped"]
        if dropped:
            failed += 1
            logger.warning("%s: left out: %s", item["key"], dropped)
        count(item["key"])
    return 1 if waiting and failed == len(waiting) else 0
