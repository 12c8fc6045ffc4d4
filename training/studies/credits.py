"""`python -m training credits`: the sources of the objects and lights that the shipped weights were trained on."""

import argparse
import re
from collections import Counter
from pathlib import Path
from typing import Any

from ..documents import fill_block, markdown_table, paragraphs
from ..rendering.manifest import read_manifest


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training credits`."""
    parser.add_argument("--data", type=Path, help="folder with manifest.json; ARM_DATA by default")
    parser.add_argument("--more", type=Path, nargs="*", default=(), help="further data folders")
    parser.add_argument("--output", type=Path, default=Path("CREDITS.md"), help="document with a block named sources")


def run(args: argparse.Namespace) -> int:
    """Fill the document's block of sources."""
    manifests = [read_manifest(data) for data in (args.data, *args.more)]
    whole = {key: [entry for manifest in manifests for entry in manifest[key]] for key in manifests[0]}
    fill_block(args.output, "sources", sources(whole))
    print(args.output)
    return 0


def sources(manifest: dict[str, Any]) -> str:
    """Markdown: who made what the weights were trained on, under which licence.

    Everything that asks for credit is named one by one; what is in the public domain is thanked by its maker.

    Args:
        manifest: `objects`, `textures` and `hdris`, each entry with id, licence and attribution. Entries of the eval
            split are neither in the weights nor in the list.
    """
    parts = []
    for key, title in (("objects", "Objects"), ("textures", "Textures"), ("hdris", "Environment maps")):
        entries = [entry for entry in manifest[key] if entry.get("split", "train") == "train"]
        credited = sorted((e for e in entries if e["licence"] != "CC0-1.0"), key=lambda e: (e["licence"], e["id"]))
        makers = Counter(_maker(entry["attribution"]) for entry in entries if entry["licence"] == "CC0-1.0")
        parts.append(f"### {title}")
        if credited:
            rows = [[entry["id"], entry["attribution"], entry["licence"]] for entry in credited]
            parts.append(markdown_table(["id", "attribution", "licence"], rows))
        if makers:
            names = "; ".join(f"{name} ({count})" for name, count in makers.most_common())
            parts.append(f"In the public domain (CC0-1.0), {makers.total()} in all, with thanks: {names}.")
    return paragraphs(*parts)


def _maker(attribution: str) -> str:
    """The name in "Mug by somebody - some site (CC0)" or "Poly Haven (a page)"; else the whole attribution."""
    patterns = (r"\bby {\"name\": \"(.+?)\"", r"\bby (.+?)(?: - | \(|$)", r"^((?:ambientCG|Poly Haven)\b)")
    found = next(filter(None, (re.search(pattern, attribution) for pattern in patterns)), None)
    return found.group(1) if found else attribution
