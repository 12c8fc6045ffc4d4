"""List the networks' weights, check them against their recorded hashes, bring or download those of others."""

import argparse
import sys
from pathlib import Path

from ..errors import CheckpointError
from ..weight_files.folder import FOLDER
from . import UsageError, progress_line

KINDS = ("georm", "image-encoder", "material-encoder", "lpips", "matting")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(dest="action", metavar="list|verify|import|download", required=True)
    actions.add_parser("list", help="what there is and where, whether it is whole, what it enables, its licence")
    verify = actions.add_parser("verify", help="compare with the recorded hashes")
    verify.add_argument("names", nargs="*", metavar="NAME", help="such as small.georm (default: all installed)")
    bring = actions.add_parser("import", help="bring a file of another project, converted where it has to be; offline")
    bring.add_argument(
        "source",
        type=Path,
        metavar="FILE|FOLDER",
        help="as it was downloaded: .ckpt, .pth, .bin, .safetensors or .onnx; of a folder all files known by name",
    )
    bring.add_argument(
        "--as",
        dest="kind",
        choices=KINDS,
        help="InstantMesh is a georm, DINO's ViT-B/16 an image-encoder, its ViT-B/8 a material-encoder, "
        "U2-Net or IS-Net as ONNX a matting (default: by the names of files)",
    )
    bring.add_argument("--output", type=Path, metavar="FILE", help="default: where the preset that uses it looks")
    fetch = actions.add_parser("download", help="fetch weights of another project, under its licence")
    fetch.add_argument("name", metavar="NAME", help="such as instantmesh.georm; `weights list` names them")
    fetch.add_argument("--accept-licence", action="store_true", help="of the weights; otherwise you are asked")
    progress_line.add_option(fetch)


def run(args: argparse.Namespace) -> int:
    return {"list": _list, "verify": _verify, "import": _import, "download": _download}[args.action](args)


def _list(args: argparse.Namespace) -> int:
    from ..weight_files import checkpoints
    from ..weight_files.registry import REGISTRY

    for weights in REGISTRY:
        path, condition = checkpoints.shipped(weights.name), checkpoints.condition(weights.name)
        size = f"{path.stat().st_size / 2**20:.1f} MiB" if path.is_file() else weights.download or "-"
        print(f"{weights.name:<22} {condition:<13} {size:>18}  {weights.licence:<16} {weights.enables}")
        print(f"    {path}" + ("" if condition == "whole" else f": {weights.remedy}"))
    return 0


def _verify(args: argparse.Namespace) -> int:
    from ..weight_files import checkpoints
    from ..weight_files.registry import REGISTRY

    known = [weights.name for weights in REGISTRY]
    names = args.names or [name for name in known if checkpoints.shipped(name).is_file()]
    if not names:
        raise CheckpointError(f"{FOLDER}: no weights are installed; install the project again")
    failed = 0
    for name in names:
        try:
            print(f"{name:<24} {checkpoints.verify(name)}")
        except CheckpointError as error:
            print(f"arm: {error}", file=sys.stderr)
            failed += 1
    return 1 if failed else 0


def _import(args: argparse.Namespace) -> int:
    from ..weight_files.install import install

    for installed in install(args.source, args.kind, args.output):
        print(f"{installed.path}: {installed.origin}; licence of the weights: {installed.licence}")
    return 0


def _download(args: argparse.Namespace) -> int:
    from ..weight_files import checkpoints

    weights, place = checkpoints.registered(args.name), checkpoints.shipped(args.name)
    if checkpoints.condition(args.name) == "whole":
        print(f"{place}: is there, and whole")
        return 0
    if weights.files:
        places = " and ".join(file.url for file in weights.files)
        print(f"{weights.name}: {weights.enables}; {weights.download}, from {places}")
        print(f"licence of the weights: {weights.licence}; they would lie at {place}", flush=True)
        if not (args.accept_licence or _agreed(weights.name)):
            print("nothing was downloaded")
            return 1
    from ..weight_files.install import download

    with progress_line.shown(args.progress) as progress:
        installed = download(args.name, progress)
    print(f"{installed.path}: {installed.origin}; licence of the weights: {installed.licence}")
    return 0


def _agreed(name: str) -> bool:
    """Whether the user says yes on the terminal.

    Raises:
        UsageError: nobody is there to ask.
    """
    if sys.stdin is None or not sys.stdin.isatty():
        raise UsageError(f"{name}: its licence is yours to accept; add --accept-licence")
    try:
        answer = input("Download under this licence? [y/N] ")
    except EOFError:
        return False
    return answer.strip().lower() in ("y", "yes")
