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

TITLES = {
    "georm": "GeoRM",
    "glossyrm": "GlossyRM",
    "finish": "Finish",
    "instant_albedo": "InstantAlbedo",
    "ray_occupancy": "RayOccupancy",
}
"""Of the networks, in the table's order."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training presets`."""
    parser.add_argument(
        "--update-document", type=Path, nargs="?", const=Path("docs/method.md"), help="fill its block of presets"
    )


def run(args: argparse.Namespace) -> int:
    """Print the table; fill the document's block where one is named."""
    table = presets_table()
    print(table)
    if args.update_document:
        made = "Made by `python -m training presets --update-document`."
        fill_block(args.update_document, "presets", f"{table}\n\n{made}")
    return 0


def presets_table() -> str:
    """Markdown: a row per network and per part of it, a column per preset."""
    counts = {preset: network_parameters(preset) for preset in PRESETS}
    keys = [
        (name, part)
        for name in TITLES
        for part in dict.fromkeys(part for found in counts.values() for part in found[name])
    ]
    rows = []
    for name, part in keys:
        numbers = [found[name].get(part) for found in counts.values()]
        title = f"{TITLES[name]}, {part}" if part else f"**{TITLES[name]}**"
        rows.append([title, *("-" if number is None else _readable(number) for number in numbers)])
    return markdown_table(["parameters", *PRESETS], rows)


def network_parameters(preset: str) -> dict[str, dict[str, int]]:
    """Parameters of every network of a preset by its name: of the whole, under "", and of its parts."""
    configs, counts = PRESETS[preset], {name: dict[str, int]() for name in TITLES}
    for name in configs.networks:
        with unallocated():
            network = networks.build(name, getattr(configs, name))
        parts = getattr(network, "model", network).named_children()
        counts[name] = {"": _count(network)} | {part: _count(module) for part, module in parts}
    return counts


def _count(module: nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def _readable(count: int) -> str:
    return f"{count / 1e6:.1f} M" if count >= 1e6 else f"{count / 1e3:.1f} k"
