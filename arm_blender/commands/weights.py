"""List the networks' weights, check them against their recorded hashes, or bring those of other projects."""

import argparse
import sys
from pathlib import Path

from ..errors import CheckpointError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(dest="action", metavar="list|verify|import", required=True)
    actions.add_parser("list", help="what there is and where, whether it is whole, what it enables, its licence")
    verify = actions.add_parser("verify", help="compare with the recorded hashes")
    verify.add_argument("names", nargs="*", metavar="NAME", help="such as small.georm (default: all installed)")
    bring = actions.add_parser("import", help="convert a checkpoint of InstantMesh, DINO or Materialistic")
    bring.add_argument(
        "file", type=Path, metavar="FILE", help="as it was downloaded: .ckpt, .pth, .bin or .safetensors"
    )
    bring.add_argument(
        "--as",
        dest="kind",
        required=True,
        choices=("georm", "image-encoder", "material-encoder"),
        help="InstantMesh is a georm, DINO's ViT-B/16 an image-encoder, its ViT-B/8 a material-encoder",
    )
    bring.add_argument("--output", type=Path, metavar="FILE", help="default: where the preset that uses it looks")


def run(args: argparse.Namespace) -> int:
    return {"list": _list, "verify": _verify, "import": _import}[args.action](args)


def _list(args: argparse.Namespace) -> int:
    from .. import checkpoints

    for weights in checkpoints.REGISTRY:
        path, condition = checkpoints.shipped(weights.name), checkpoints.condition(weights.name)
        size = f"{path.stat().st_size / 2**20:.1f} MiB" if path.is_file() else weights.download or "-"
        print(f"{weights.name:<22} {condition:<13} {size:>18}  {weights.licence:<16} {weights.enables}")
        print(f"    {path}" + ("" if condition == "whole" else f": {weights.remedy}"))
    return 0


def _verify(args: argparse.Namespace) -> int:
    from .. import checkpoints

    known = [weights.name for weights in checkpoints.REGISTRY]
    names = args.names or [name for name in known if checkpoints.shipped(name).is_file()]
    if not names:
        raise CheckpointError(f"{checkpoints.FOLDER}: no weights are installed; install the project again")
    failed = 0
    for name in names:
        try:
            print(f"{name:<24} {checkpoints.verify(name)}")
        except CheckpointError as error:
            print(f"arm: {error}", file=sys.stderr)
            failed += 1
    return 1 if failed else 0


def _import(args: argparse.Namespace) -> int:
    from ..weights_import import import_weights

    path, converted = import_weights(args.file, args.kind, args.output)
    print(f"{path}: {converted.origin}; licence of the weights: {converted.licence}")
    return 0
