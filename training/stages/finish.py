"""Fit what reads roughness and metallic off the evidence of the views: ridge regression, in closed form.

Not in the paper. A hundred measured objects bear a few hundred weights. What a score of metal is worth is told by
families of objects that were left out, and so is the table of docs/materials.md. A run that is killed goes on from the
samples that it has made.
"""

import argparse
import logging
from pathlib import Path

import torch

from arm_blender.models.small.finish import Finish, FinishConfig
from arm_blender.weight_files import checkpoints

from ..datasets.finish_samples import family, prepare, samples
from ..datasets.gloss_samples import Shapes
from ..documents import fill_block
from . import finish_folds
from .finish_readout import fit_odds, fit_readout, rows

logger = logging.getLogger(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What `python -m training fit finish` takes."""
    parser.add_argument("--shards", type=Path, nargs="*", default=(), help="folders of rigs; samples are made of those")
    parser.add_argument("--georm", type=Path, help="GeoRM's weights, on whose shapes points lie; those that ship")
    parser.add_argument("--cache", type=Path, required=True, help="folder of samples; those that it has are not remade")
    parser.add_argument("--grid", type=int, default=64, help="samples of the density along a side, for the shapes")
    parser.add_argument("--output", type=Path, required=True, help="checkpoint to write")
    parser.add_argument("--update", type=Path, help="document whose block `folds` takes the table")


def run(args: argparse.Namespace) -> int:
    """Prepare, measure by families left out, fit on all; returns the exit status."""
    for folder in args.shards:
        shapes = Shapes(
            args.georm or checkpoints.shipped("small.georm"), args.grid, torch.device("cpu"), args.cache / "shapes"
        )
        logger.info("%d samples in %s", prepare(folder, args.cache, shapes), args.cache)
    known = list(samples(args.cache))
    model = Finish(FinishConfig()).requires_grad_(False)
    tables = []
    for readout in (model.several, model.few):
        data = rows(known, model, readout)
        found = finish_folds.left_out(model, readout, data)
        tables += finish_folds.table_rows(model, data, found)
        fit_readout(readout, data, model.config)
        fit_odds(readout, found.answer[..., 1], data.truth[..., 1], data.weight)
    objects = {sample.name for sample in known}
    families = len(set(map(family, objects)))
    text = finish_folds.document(tables, len(objects), families, args.command)
    print(text)
    if args.update:
        fill_block(args.update, "folds", text)
    metadata = {"objects": str(len(objects)), "families": str(families), "samples": str(len(known))}
    checkpoints.save(args.output, model.state_dict(), model.config, "small.finish", metadata)
    return 0
