"""Move GlossyRM's last biases to what measured materials are like.

Most training objects carry a random finish, a quarter of them metal: what a network is unsure of, it answers by their
mean. Users' objects are like the few with measured maps. Each output's logit is moved by the one number with which its
mean absolute error on those is least, every object counting alike.
"""

import argparse
import logging
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from arm_blender.errors import ArmError
from arm_blender.models.paper.glossyrm import GlossyRM
from arm_blender.models.paper.reconstruction import ReconstructionConfig
from arm_blender.weight_files import checkpoints

from ..datasets.point_samples import expanded, load_gloss
from ..rendering import shards
from ..rendering.manifest import read_manifest

logger = logging.getLogger(__name__)

MOST = 5.0
"""Logits by which an output is moved at most: 0.3 becomes 0.003, which the pipeline takes for a constant 0."""
STEP = 0.05


def shift(logits: Sequence[Tensor], truth: Sequence[Tensor]) -> float:
    """The number, of a grid of `STEP`, whose addition to the logits brings their sigmoids nearest to the truth.

    Args:
        logits: (P,) of each object.
        truth: (P,) of each, in [0, 1].
    """
    moves = torch.arange(-MOST, MOST + STEP / 2.0, STEP)
    error = torch.zeros_like(moves)
    for own, true in zip(logits, truth, strict=True):
        error += ((own[:, None] + moves).sigmoid() - true[:, None]).abs().mean(dim=0)
    return float(moves[error.argmin()])


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What `python -m training calibrate` takes."""
    parser.add_argument("--shards", type=Path, required=True)
    parser.add_argument("--data", type=Path, help="folder whose manifest tells which objects are measured")
    parser.add_argument("--start", type=Path, required=True, help="GlossyRM's weights")
    parser.add_argument("--output", type=Path, required=True, help="the weights, moved")


@torch.no_grad()
def run(args: argparse.Namespace) -> int:
    """Measure, move, write; returns the exit status."""
    entries = read_manifest(args.data)["objects"]
    measured = {entry["id"] for entry in entries if entry["set"] == "pbr" and entry["split"] == "train"}
    rigs = {path.parent.name: path for path in reversed(shards.rigs(args.shards)) if path.parent.name in measured}
    if not rigs:
        raise ArmError(f"{args.shards}: none of its objects has measured materials; render the set pbr as well")
    config, state = checkpoints.load(args.start, ReconstructionConfig)
    model = GlossyRM(config).eval()
    checkpoints.restore(model, state, args.start)
    logits, truth = [], []
    for path in rigs.values():
        sample = load_gloss(path)
        encoded = model.encode(expanded(sample.views))
        logits.append(model(encoded, sample.points[None].float())[0].logit(eps=1e-6))
        truth.append(sample.target.float())
    last = f"model.decoder.{len(model.model.decoder) - 1}.bias"
    for k, name in enumerate(("roughness", "metallic")):
        move = shift([x[:, k] for x in logits], [x[:, k] for x in truth])
        logger.info("%s: %+.2f logits, from %d objects", name, move, len(rigs))
        state[last][k] += move
    kept = {key: value for key, value in checkpoints.read_header(args.start).items() if key in ("data", "licence")}
    metadata = kept | {"calibrated": f"{len(rigs)} objects"}
    checkpoints.save(args.output, state, config, "small.glossyrm", metadata, half=True)
    return 0
