"""The command line as the tests speak to it."""

import json
from pathlib import Path

from arm_blender.__main__ import main

ROOT = Path(__file__).parents[2]
MULTIVIEW = ["--multiview", "zero123plus", "--multiview-model", "weights"]


def run(*words) -> int:
    return main([str(word) for word in words])


def only_line(text: str) -> str:
    lines = text.splitlines()
    assert len(lines) == 1, text
    return lines[0]


def lines_of(text: str) -> dict[str, dict]:
    """What a batch says of its items, by the names of their folders."""
    return {Path(line["output"]).name: line for line in map(json.loads, text.splitlines())}
