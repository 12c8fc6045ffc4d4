"""Render an asset under environment maps."""

import argparse
from pathlib import Path

from ..errors import ArmError
from ..files import check_output
from . import UsageError, generate

LARGEST = {"turntable": 3600, "resolution": 8192, "samples": 65536}
"""Blender takes more, and cannot be stopped while it renders."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("asset", type=Path, metavar="ASSET", help="a .blend or .glb that `generate` wrote")
    parser.add_argument(
        "--hdri", nargs="+", required=True, metavar="FILE|NAME", help="environment maps, or names of Blender's: forest"
    )
    parser.add_argument("--engine", choices=("cycles", "eevee"), default="cycles")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="the folder of the pictures")
    parser.add_argument("--turntable", type=int, default=1, metavar="N", help="pictures in one full turn (default: 1)")
    parser.add_argument("--resolution", type=int, default=512, metavar="N", help="pixels a side (default: 512)")
    parser.add_argument("--samples", type=int, default=32, metavar="N", help="paths a pixel (default: 32)")
    parser.add_argument("--progress", choices=("auto", "always", "never"), default="auto", help="auto: on a terminal")


def run(args: argparse.Namespace) -> int:
    for name, most in LARGEST.items():
        if not 1 <= getattr(args, name) <= most:
            raise UsageError(f"--{name} {getattr(args, name)}: give 1 to {most}")
    if not args.asset.is_file():
        raise ArmError(f"{args.asset}: no such asset; give a .blend or .glb file")
    check_output(args.output)
    try:
        from ..blender import relight
    except ImportError as error:
        raise ArmError(f"{args.asset}: {generate.NO_BPY} ({error})") from error

    config = relight.RelightConfig(args.engine, args.resolution, args.samples, args.turntable)
    from .progress_line import shown

    with shown(args.progress) as progress:
        pictures = relight.relight(args.asset, args.hdri, args.output, config, progress)
    print(*pictures, sep="\n")
    return 0
