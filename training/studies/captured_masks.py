"""`python -m training evaluate-masks`: the masks of simulated captures, each way that finds them against the truth."""

import argparse
import json
import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor
from torch.nn.functional import pad

from arm_blender.commands.progress_line import Counted
from arm_blender.errors import ArmError
from arm_blender.graphics.borders import Rectangle
from arm_blender.graphics.cameras import Camera
from arm_blender.graphics.color import bytes_from_unit, srgb_from_linear
from arm_blender.photographs.masks.agreement import agreed
from arm_blender.photographs.masks.joint_look import joint_masks
from arm_blender.views.cutout import cut_out
from arm_blender.views.image_io import read_image, write_png
from arm_blender.views.masks import Unsure, doubt
from arm_blender.views.matting import matted_by_model
from arm_blender.views.plain_background import plain_foreground
from arm_blender.weight_files import checkpoints, matting_model

from ..datasets.joint_samples import eye_of
from ..documents import fill_block, markdown_table, paragraphs
from ..picture_grid import grid
from ..rendering.shards import read_mesh

logger = logging.getLogger(__name__)

OURS = "small network"
"""As `foreground.WAYS` has it."""

BAD = 0.8
"""Intersection over union below which a mask is bad: it should be doubted."""

_ROOM = 0.05
"""Of the true box's sides, how much room GrabCut is given around it."""

_SHOWN, _SIDE = 8, 192
"""Pictures of a capture on its sheet, and pixels a side of each."""


@dataclass(frozen=True)
class Score:
    """Of one picture's mask.

    Attributes:
        iou: intersection over union with the true one; 0 where none was found.
        doubted: whether it is said to be doubtful, or none was found.
        seconds: that it took.
    """

    iou: float
    doubted: bool
    seconds: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training evaluate-masks`."""
    parser.add_argument("--captures", type=Path, required=True, help="folder written by `render --layout capture`")
    parser.add_argument(
        "--others-every", type=int, default=1, help="ways beside the small network see every Nth picture"
    )
    parser.add_argument("--sheets", type=Path, help="folder for a picture of each capture's masks")
    parser.add_argument("--document", type=Path, help="Markdown file whose block `masks` is filled")


def run(args: argparse.Namespace) -> int:
    """Find, compare, tell; returns the exit status."""
    folders = sorted(path.parent for path in args.captures.glob("*/truth.json"))
    if not folders:
        raise ArmError(f"{args.captures}: no capture; make some with `python -m training render --layout capture`")
    ways, rows, count = known_ways(), [], Counted(len(folders), logger.info)
    for folder in folders:
        scores: dict[str, list[Score]] = {name: [] for name in ways}
        shown, alphas = list[tuple[Tensor, Tensor]](), list[Tensor]()
        for index, (path, image, truth) in enumerate(pictures(folder)):
            asked = ways if index % args.others_every == 0 else {OURS: ways[OURS]}
            found = {name: score(find, image, truth) for name, find in asked.items()}
            for name, (one, _) in found.items():
                scores[name].append(one)
            alphas.append(found[OURS][1])
            shown.append((image, truth))
            print(path.name, *(f"{name} {one.iou:.3f}" for name, (one, _) in found.items()), sep="  ", flush=True)
        for name, (several, masks) in together(folder, alphas).items():
            scores[name] = several
            alphas = masks
        rows += [[folder.name, name, *_summary(several)] for name, several in scores.items() if several]
        count(folder.name)
        if args.sheets is not None:
            args.sheets.mkdir(parents=True, exist_ok=True)
            every = max(1, len(shown) // _SHOWN)
            tiles = torch.cat(
                [_tile(*pair, alpha) for pair, alpha in list(zip(shown, alphas, strict=True))[::every][:_SHOWN]], dim=1
            )  # (3, P, 3, S, S)
            sheet = torch.cat([grid(list(tiles), _SIDE), torch.ones(1, 3 * _SIDE, tiles.shape[1] * _SIDE)])
            write_png(args.sheets / f"{folder.name}.png", sheet, srgb=False)
    header = ["capture", "way", "pictures", "IoU", "lowest tenth", "bad", "of those doubted", "good but doubted", "s"]
    text = paragraphs(markdown_table(header, rows), f"Made by `{args.command}`.")
    print(text)
    if args.document is not None:
        fill_block(args.document, "masks", text)
    return 0


def pictures(folder: Path) -> Iterator[tuple[Path, Tensor, Tensor]]:
    """Every picture of a capture that shows the object: its path, (4, H, W) linear, and its true mask (H, W) bool."""
    for entry in json.loads((folder / "truth.json").read_text(encoding="utf-8"))["pictures"]:
        truth = torch.from_numpy(np.array(Image.open(folder / entry["mask"]))) > 127
        if bool(truth.any()):
            yield folder / entry["file"], read_image(folder / entry["file"]), truth


def together(folder: Path, alphas: list[Tensor]) -> dict[str, tuple[list[Score], list[Tensor]]]:
    """The scores of a capture's masks after all pictures were looked at together, and after those were compared.

    Args:
        folder: of the capture; its true cameras are used, and the height at which the true mesh begins.
        alphas: (H, W) each, of its pictures in their order.
    Returns:
        by way, the scores and the masks; what is dropped is doubted. None where a picture does not show the object, the
        mesh is missing, or the network.
    """
    entries = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["pictures"]
    if len(alphas) != len(entries) or not (folder / "mesh.npz").is_file():
        return {}
    started = time.perf_counter()
    eyes = [eye_of(torch.tensor(entry["c2w"], dtype=torch.float64), entry["lens"]) for entry in entries]
    ground = float(read_mesh(folder / "mesh.npz").vertices[:, 2].min())
    shown = list(pictures(folder))

    def picture(view: int) -> Tensor:
        return srgb_from_linear(shown[view][1][:3])

    masks = joint_masks(picture, alphas, eyes, ground)
    if masks is None:
        return {}
    looked = (time.perf_counter() - started) / len(entries)
    found = {"all pictures together": (_scores(shown, masks, (), looked), masks)}
    if all(entry["lens"]["model"] == "SIMPLE_PINHOLE" for entry in entries):
        started = time.perf_counter()
        squares = [_square(entry, mask) for entry, mask in zip(entries, masks, strict=True)]
        padded, cameras, known = zip(*squares, strict=True)
        held = agreed(torch.stack(padded)[:, None], cameras, ground=ground, known=known)
        masks = [_unsquared(mask[0], before) for mask, before in zip(held.masks, masks, strict=True)]
        seconds = looked + (time.perf_counter() - started) / len(entries)
        found["together and compared"] = (_scores(shown, masks, held.dropped, seconds), masks)
    return found


def _square(entry: dict[str, Any], mask: Tensor) -> tuple[Tensor, Camera, Rectangle]:
    """A mask (H, W) in the middle of a square, the camera of that, and where in it the picture is."""
    height, width = mask.shape
    side, focal = max(height, width), entry["lens"]["parameters"][0]
    left, top = (side - width) // 2, (side - height) // 2
    K = torch.tensor([[focal, 0.0, left + width / 2.0], [0.0, focal, top + height / 2.0], [0.0, 0.0, 1.0]])
    padded = pad(mask, (left, side - width - left, top, side - height - top))
    camera = Camera(torch.tensor(entry["c2w"], dtype=torch.float32), K, side, side)
    return padded, camera, (left, top, left + width, top + height)


def _unsquared(mask: Tensor, like: Tensor) -> Tensor:
    top, left = ((mask.shape[-1] - side) // 2 for side in like.shape)
    return mask[top : top + like.shape[0], left : left + like.shape[1]]


def _scores(
    shown: list[tuple[Path, Tensor, Tensor]], masks: list[Tensor], dropped: tuple[int, ...], seconds: float
) -> list[Score]:
    scores = []
    for view, ((_, image, truth), mask) in enumerate(zip(shown, masks, strict=True)):
        one = score(partial(_given, mask), image, truth)[0]
        scores.append(Score(one.iou, one.doubted or view in dropped, seconds))
    return scores


def _given(mask: Tensor, image: Tensor, truth: Tensor) -> Tensor:
    """The way that knows a mask already."""
    return mask


Way = Callable[[Tensor, Tensor], Tensor]
"""Finds the mask (H, W) of a picture (4, H, W); GrabCut is given the true one (H, W), for its box."""


def known_ways() -> dict[str, Way]:
    """Those that are here: the small network, a plain background, an imported matting model, OpenCV's GrabCut."""
    ways: dict[str, Way] = {
        OURS: lambda image, truth: cut_out(image),
        "plain background": lambda image, truth: plain_foreground(image),
    }
    if checkpoints.shipped(matting_model.MATTING).is_file():
        ways["matting model"] = lambda image, truth: matted_by_model(image)
    if find_spec("cv2") is not None:
        ways["GrabCut, given the true box"] = by_grabcut
    return ways


def score(find: Way, image: Tensor, truth: Tensor) -> tuple[Score, Tensor]:
    """How well a way finds one picture's mask, and that mask (H, W), empty where it finds none."""
    started = time.perf_counter()
    try:
        alpha = find(image, truth)
    except Unsure:
        return Score(0.0, True, time.perf_counter() - started), torch.zeros(truth.shape)
    seconds = time.perf_counter() - started
    mask = alpha > 0.5
    iou = float((mask & truth).sum()) / float((mask | truth).sum())
    return Score(iou, doubt(alpha) is not None, seconds), alpha


def by_grabcut(image: Tensor, truth: Tensor) -> Tensor:
    """(H, W) by GrabCut (Rother et al. 2004), five rounds, from a box around the true mask: what a user would draw."""
    import cv2

    pixels = bytes_from_unit(srgb_from_linear(image[:3])).permute(1, 2, 0).contiguous().numpy()
    height, width = truth.shape
    rows, columns = (torch.nonzero(truth.any(dim=dim))[:, 0] for dim in (1, 0))
    room = [round(_ROOM * (int(v[-1]) - int(v[0]) + 1)) + 1 for v in (rows, columns)]
    top, bottom = max(int(rows[0]) - room[0], 0), min(int(rows[-1]) + room[0], height - 1)
    left, right = max(int(columns[0]) - room[1], 0), min(int(columns[-1]) + room[1], width - 1)
    mask, models = np.zeros((height, width), np.uint8), [np.zeros((1, 65), np.float64) for _ in range(2)]
    box = (left, top, right - left, bottom - top)
    cv2.grabCut(pixels[..., ::-1].copy(), mask, box, *models, 5, cv2.GC_INIT_WITH_RECT)
    return torch.from_numpy(np.isin(mask, (cv2.GC_FGD, cv2.GC_PR_FGD))).float()


def _summary(scores: list[Score]) -> list[object]:
    iou = torch.tensor([one.iou for one in scores])
    bad = [one for one in scores if one.iou < BAD]
    good = sum(one.doubted for one in scores if one.iou >= BAD)
    seconds = f"{sum(one.seconds for one in scores) / len(scores):.2f}"
    return [
        len(scores), float(iou.mean()), float(iou.quantile(0.1)), len(bad), sum(b.doubted for b in bad), good, seconds
    ]  # fmt: skip


def _tile(image: Tensor, truth: Tensor, alpha: Tensor) -> Tensor:
    """(3, 1, 3, S, S): picture, what is cut out on grey, and where that is too much (red) or too little (blue)."""
    srgb = srgb_from_linear(image[:3])
    cut = srgb * alpha + 0.5 * (1.0 - alpha)
    mask = alpha > 0.5
    wrong = torch.stack([mask & ~truth, torch.zeros_like(mask), truth & ~mask]).float() + 0.5 * (mask & truth)
    return torch.nn.functional.interpolate(
        torch.stack([srgb, cut, wrong.clamp(0.0, 1.0)]), (_SIDE, _SIDE), mode="bilinear", antialias=True
    )[:, None]
