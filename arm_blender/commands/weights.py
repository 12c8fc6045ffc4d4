"""List the networks' weights, or check them against their recorded hashes."""

import argparse
import sys

from ..errors import CheckpointError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(dest="action", metavar="list|verify", required=True)
    actions.add_parser("list", help="what there is, what it enables, under which licence")
    verify = actions.add_parser("verify", help="compare with the recorded hashes")
    verify.add_argument("names", nargs="*", metavar="NAME", help="such as small.georm (default: all installed)")


def run(args: argparse.Namespace) -> int:
    from .. import checkpoints

    known = [weights.name for weights in checkpoints.REGISTRY]
    if args.action == "list":
        for weights in checkpoints.REGISTRY:
            path = checkpoints.shipped(weights.name)
            size = f"{path.stat().st_size / 2**20:.1f} MiB" if path.is_file() else "not installed"
            print(f"{weights.name:<24} {size:>14}  {weights.licence:<18} {weights.enables}")
        return 0
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
