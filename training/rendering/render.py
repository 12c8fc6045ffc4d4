"""`python -m training render`: objects to posed views with depth, normal, albedo, roughness and metallic, by Cycles.

A folder of objects becomes tar shards (see shard_writer.py). Each object is rendered in a process that may die without
loss: what is whole already is skipped, what fails is recorded with its reason. With `--ray` objects and output lie in
folders that all machines see.
"""

import argparse
import logging
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import OpenImageIO as oiio

from arm_blender.commands.progress_line import Counted
from arm_blender.commands.workers import Answer, side_by_side
from arm_blender.errors import ArmError
from arm_blender.machine.files import only_writer

from . import shard_writer
from .assets import Asset, find_assets, in_order, manifest_assets
from .captures import layouts as captures
from .manifest import read_manifest

logger = logging.getLogger(__name__)

TASK = "training.rendering.render_blender"
"""Its `answer(item, words)` renders one object."""

Distribute = Callable[[Sequence[Any], dict[str, Any]], Iterator[tuple[Any, Answer]]]
"""Gives each item with its answer, None where the process died over it; in the order in which they end."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training render`."""
    parser.add_argument("assets", type=Path, nargs="?", help="folder of GLB, glTF, OBJ, FBX or USD files")
    parser.add_argument("--data", type=Path, help="instead: folder with manifest.json; ARM_DATA by default")
    parser.add_argument("--output", type=Path, required=True, help="folder of shards, or of evaluation views")
    parser.add_argument("--split", choices=("train", "eval"), default="train", help="of the manifest")
    parser.add_argument("--set", nargs="*", default=("pbr", "gso", "flat"), help="sets of the manifest")
    parser.add_argument("--ids", nargs="*", help="only these objects")
    parser.add_argument("--first", type=int, help="only so many objects")
    layouts = ("samples", "views", "capture", "scenes")
    words = "views: for evaluation; capture: as by a phone; scenes: to learn cutting objects out of"
    parser.add_argument("--layout", choices=layouts, default="samples", help=words)
    parser.add_argument("--cameras", choices=("paper", "varied"), default="paper", help="varied: as users' pictures")
    parser.add_argument("--views", type=int, default=32, help="random views beside the six inputs")
    parser.add_argument("--lightings", type=int, default=1, help="rigs an object, each under its own light")
    parser.add_argument("--distance", type=float, default=6.0, help="of the Zero123++ rig")
    parser.add_argument("--hdri", type=Path, help="folder of environment maps; Blender's own by default")
    parser.add_argument(
        "--no-area-lights", dest="area_lights", action="store_false", help="light by the environment alone"
    )
    parser.add_argument("--any-material", action="store_true", help="take objects without roughness or metallic map")
    parser.add_argument("--obj-up", choices=("Y", "Z"), default="Y", help="the axis that points up in OBJ files")
    parser.add_argument("--max-triangles", type=int, help="larger objects are left out")
    parser.add_argument("--resolution", type=int, default=320, help="pixels a side")
    parser.add_argument("--samples", type=int, default=16, help="Cycles samples a pixel")
    parser.add_argument("--no-denoise", action="store_true")
    parser.add_argument("--cpu", action="store_true", help="leave graphics devices alone")
    parser.add_argument("--seed", type=int, default=0)
    captures.add_arguments(parser)
    parser.add_argument("--shard-size", type=int, default=64, help="objects a shard, those left out among them")
    parser.add_argument("--jobs", type=int, default=1, help="processes side by side")
    parser.add_argument("--ray", metavar="ADDRESS", help="render on a Ray cluster, such as auto or HOST:6379")
    parser.add_argument("--ray-cpus", type=int, default=4, help="cores of an object's task on the cluster")
    parser.add_argument("--ray-gpus", type=float, default=0.0, help="graphics devices of an object's task")


def run(args: argparse.Namespace) -> int:
    """Render every chosen object that is not rendered yet; 1 where not one of several could be."""
    assets, hdris, own_hdris = chosen(args)
    render = {"resolution": args.resolution, "samples": args.samples, "denoise": not args.no_denoise}
    if args.layout == "views":
        with only_writer(args.output):
            return _render_views(assets, hdris, args, render)
    if args.layout in ("capture", "scenes"):
        with only_writer(args.output):
            return captures.run(assets, hdris, args, render)
    names = ("cameras", "views", "lightings", "distance", "area_lights", "any_material", "max_triangles", "seed")
    sample = {name: getattr(args, name) for name in names}
    settings = render | sample | {"hdris": [path.name for path in hdris], "own_hdris": own_hdris}
    words = {
        "output": str(args.output.resolve()),
        "render": render | {"gpu": not args.cpu},
        "sample": sample,
        "hdris": [str(path.resolve()) for path in hdris],
        "own_hdris": own_hdris,
    }
    distribute = partial(_here, jobs=args.jobs)
    if args.ray:
        from .render_ray import over_machines

        distribute = partial(over_machines, module=TASK, address=args.ray, cpus=args.ray_cpus, gpus=args.ray_gpus)
    with shard_writer.writing(args.output, settings):
        attempted, rendered = render_dataset(assets, args.output, args.shard_size, words, distribute)
    logger.info("%d of %d objects rendered", rendered, attempted)
    return 1 if attempted and not rendered else 0


def chosen(args: argparse.Namespace) -> tuple[list[Asset], list[Path], bool]:
    """The objects, the environment maps, and whether Blender's own are drawn from as well.

    Raises:
        ArmError: there are none.
    """
    hdris = sorted(path for path in args.hdri.glob("*") if path.suffix.lower() in (".hdr", ".exr")) if args.hdri else []
    own_hdris = not args.hdri
    if args.assets is not None:
        assets = find_assets(args.assets.resolve(), args.obj_up)
    else:
        manifest = read_manifest(args.data)
        if not args.hdri:
            # Objects of evaluation are lit by evaluation HDRIs, and training never sees one of those.
            hdris = [args.data / h["files"][0] for h in manifest["hdris"] if h["split"] == args.split]
            own_hdris = args.split == "train"
        wanted = [e for e in manifest["objects"] if e["split"] == args.split and e["set"] in args.set]
        assets = manifest_assets(wanted, args.data.resolve())
    for path in hdris:  # Before any object is left out for it.
        if (image := oiio.ImageInput.open(str(path))) is None:
            raise ArmError(f"{path}: not a readable environment map ({oiio.geterror()}); give others with --hdri")
        image.close()
    assets = [asset for asset in assets if not args.ids or asset.key in args.ids][: args.first]
    if not assets or not (hdris or own_hdris):
        where = args.assets or args.data
        what = f"{where}: no object" if not assets else f"{args.hdri or where}: no environment map"
        raise ArmError(f"{what} to render; check --split, --set, --ids and --hdri")
    return assets, hdris, own_hdris


def render_dataset(
    assets: Iterable[Asset], output: Path, shard_size: int, words: dict[str, Any], distribute: Distribute
) -> tuple[int, int]:
    """Render what is not rendered yet, and pack shards as soon as all of their objects are there.

    Args:
        output: inside of `shard_writer.writing`.
        words: of the task.
        distribute: where the tasks run.
    Returns:
        how many objects were attempted, and how many of them rendered.
    """
    packed, parts = shard_writer.finished(output)
    waiting = [asset for asset in in_order(assets) if asset.key not in packed]
    pending = [asdict(asset) for asset in waiting if asset.key not in parts]
    groups = [[asset.key for asset in waiting[i : i + shard_size]] for i in range(0, len(waiting), shard_size)]
    done, attempted, rendered = set(parts), 0, 0
    count = Counted(len(pending), logger.info)
    for key, dropped in _outcomes(pending, words, distribute, output):
        done.add(key)
        attempted, rendered = attempted + 1, rendered + (dropped is None)
        if dropped:
            logger.warning("%s: left out: %s", key, dropped)
        count(key)
        while groups and done.issuperset(groups[0]):
            shard_writer.pack(output, groups.pop(0))
    for group in groups:  # All were parts already.
        shard_writer.pack(output, group)
    return attempted, rendered


def _outcomes(
    items: list[dict[str, Any]], words: dict[str, Any], distribute: Distribute, output: Path
) -> Iterator[tuple[str, str | None]]:
    """Key and reason of each object; one that its process did not survive is tried once more at the end."""
    lost = []
    for item, answer in distribute(items, words):
        if answer is None:
            lost.append(item)
        else:
            yield answer["key"], answer["dropped"]
    if len(items) > 1 and len(lost) == len(items):  # Not the objects' fault: nothing may be recorded of them.
        raise ArmError("every rendering process died at once; see what they print, or try --ids with one object")
    for item, answer in distribute(lost, words) if lost else ():
        if answer is None:
            answer = {"key": item["key"], "source": item["source"], "dropped": "its process died over it, twice"}
            shard_writer.save_part(output, answer, {}, {})
        yield answer["key"], answer["dropped"]


def _here(items: Sequence[Any], words: dict[str, Any], jobs: int) -> Iterator[tuple[Any, Answer]]:
    """In processes of this machine."""
    return side_by_side(items, jobs, TASK, words) if items else iter(())


def _render_views(assets: list[Asset], hdris: list[Path], args: argparse.Namespace, render: dict[str, Any]) -> int:
    """The evaluation's layout: a folder an object, as a user would bring it."""
    from .lighting_blender import blender_environments
    from .passes_blender import RenderConfig
    from .render_blender import render_evaluation_views

    hdris, config = hdris or blender_environments(), RenderConfig(**render, gpu=not args.cpu)
    waiting = [asset for asset in assets if not (args.output / asset.key / "transforms.json").exists()]
    failed, count = 0, Counted(len(waiting), logger.info)
    for asset in waiting:
        hdri = hdris[zlib.crc32(f"{asset.key}:0".encode()) % len(hdris)]
        try:
            render_evaluation_views(asset, hdri, args.output, args.distance, config)
        except (ArmError, RuntimeError) as error:  # Blender's operators raise RuntimeError.
            failed += 1
            logger.warning("%s: left out: %s", asset.key, error)
        count(asset.key)
    return 1 if waiting and failed == len(waiting) else 0
