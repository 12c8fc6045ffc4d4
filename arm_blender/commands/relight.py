"""Render an asset under environment maps."""

import argparse
import math
from pathlib import Path

from ..errors import ArmError
from ..machine.files import check_output, clear_unfinished
from . import UsageError, generate, progress_line

LARGEST = {"turntable": 3600, "resolution": 8192, "samples": 65536, "fps": 240}
"""Blender takes more, and cannot be stopped while it renders."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("asset", type=Path, metavar="ASSET", help="a .blend, .glb, .usda or .obj that `generate` wrote")
    parser.add_argument(
        "--hdri", nargs="+", required=True, metavar="FILE|NAME", help="environment maps, or names of Blender's: forest"
    )
    parser.add_argument("--engine", choices=("cycles", "eevee"), default="cycles")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="the folder of the pictures")
    parser.add_argument("--resolution", type=int, default=512, metavar="N", help="pixels a side (default: 512)")
    parser.add_argument("--samples", type=int, default=32, metavar="N", help="paths a pixel (default: 32)")
    parser.add_argument("--azimuth", type=float, default=30.0, metavar="DEG", help="of the camera (default: 30)")
    parser.add_argument("--elevation", type=float, default=15.0, metavar="DEG", help="of the camera (default: 15)")
    parser.add_argument("--rotation", type=float, default=0.0, metavar="DEG", help="of the environment (default: 0)")
    parser.add_argument("--compare", action="store_true", help="the environments side by side in one picture")
    turns = parser.add_argument_group("a full turn")
    turns.add_argument("--turntable", type=int, default=1, metavar="N", help="pictures (default: 1, a still)")
    turns.add_argument("--turn", choices=("object", "environment"), default="object", help="what turns")
    turns.add_argument("--video", action="store_true", help="an .mp4 of the pictures as well")
    turns.add_argument("--fps", type=int, default=24, metavar="N", help="pictures a second (default: 24)")
    progress_line.add_option(parser)


def run(args: argparse.Namespace) -> int:
    for name, most in LARGEST.items():
        if not 1 <= getattr(args, name) <= most:
            raise UsageError(f"--{name} {getattr(args, name)}: give 1 to {most}")
    for name in ("azimuth", "elevation", "rotation"):
        if not math.isfinite(getattr(args, name)):
            raise UsageError(f"--{name} {getattr(args, name)}: give degrees")
    if args.video and args.turntable == 1:
        raise UsageError("--video: one picture is none; give --turntable N")
    if not args.asset.is_file():
        raise ArmError(f"{args.asset}: no such asset; give a .blend or .glb file")
    check_output(args.output)
    clear_unfinished(args.output)
    try:
        from ..blender.relight import renders as relight
        from ..blender.relight import video
    except ImportError as error:
        raise ArmError(f"{args.asset}: {generate.NO_BPY} ({error})") from error

    config = relight.RelightConfig(
        args.engine,
        args.resolution,
        args.samples,
        args.turntable,
        args.turn,
        args.rotation,
        args.azimuth,
        args.elevation,
    )

    with progress_line.shown(args.progress) as progress:
        files = relight.relight(args.asset, args.hdri, args.output, config, progress, args.compare)
        if args.video:
            turns = [files[first : first + args.turntable] for first in range(0, len(files), args.turntable)]
            for turn in turns:
                progress(1.0, "encoding the video")
                files.append(turn[0].with_name(f"{turn[0].stem.rpartition('_')[0]}.mp4"))
                video.write_video(files[-1], turn, args.fps)
    print(*files, sep="\n")
    return 0
