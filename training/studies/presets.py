"""`python -m training presets`: how many parameters each network of each preset has.

The networks are built on the meta device: no weight is allocated, so that the paper's sizes can be counted anywhere.
"""

import argparse
from pathlib import Path

from torch import nn

from arm_blender import networks
from arm_blender.config import PRESETS
from arm_blender.weight_files.unallocated import unallocated

from ..documents import fill_block, markdown_table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training presets`."""
    parser.add_argument(
        "--update-readme", type=Path, nargs="?", const=Path("README.md"), help="fill the document's block of presets"
    )


def run(args: argparse.Namespace) -> int:
    """Print the table; fill the document's block where one is named."""
    table = presets_table()
    print(table)
    if args.update_readme:
        fill_block(args.update_readme, "presets", f"{table}\n\nMade by `python -m training presets --update-readme`.")
    return 0


def presets_table() -> str:
    """Markdown: a row per network and per part of it, a column per preset."""
    counts = {preset: network_parameters(preset) for preset in PRESETS}
    rows = [
        [part, *(_readable(counts[preset][part]) if part in counts[preset] else "-" for preset in PRESETS)]
        for part in counts["small"]  # It has every part of `paper`, and some more.
    ]
    return markdown_table(["parameters", *PRESETS], rows)


def network_parameters(preset: str) -> dict[str, int]:
    """Parameters of every network of a preset, and of the parts that they are made of."""
    configs = PRESETS[preset]
    with unallocated():
        modules = {name: networks.build(name, getattr(configs, name)) for name in configs.networks}
    geometry, colours = modules["georm"], modules["instant_albedo"]
    counts = {"**GeoRM**": _count(geometry)}
    counts |= {f"GeoRM, {part}": _count(module) for part, module in geometry.model.named_children()}
    counts["**GlossyRM** (the parts of GeoRM)"] = _count(modules["glossyrm"])
    counts["**InstantAlbedo**"] = _count(colours)
    counts |= {f"InstantAlbedo, {part}": _count(module) for part, module in colours.named_children()}
    if "ray_occupancy" in modules:
        counts["**RayOccupancy**"] = _count(modules["ray_occupancy"])
    return counts


def _count(module: nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def _readable(count: int) -> str:
    return f"{count / 1e6:.1f} M" if count >= 1e6 else f"{count / 1e3:.1f} k"
