"""`python -m training evaluate-photographs`: photographs of a real thing, whose cameras somebody has published."""

import argparse
import json
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from arm_blender.errors import ArmError
from arm_blender.graphics.color import srgb_from_linear
from arm_blender.machine.files import whole_file
from arm_blender.photographs.selection import object_center
from arm_blender.photographs.solved import read_solved
from arm_blender.views.image_io import read_image
from arm_blender.views.transforms_json import TRANSFORMS

from ..documents import fill_block, markdown_table, paragraphs
from ..evaluation.tables.contact_sheet import square_tile, tiled
from ..evaluation.trials.capture_trial import REFUSED, CameraErrors, answer, camera_errors

SHOWN = 5
"""Photographs, and views, on the sheet."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training evaluate-photographs`."""
    parser.add_argument("--photographs", type=Path, required=True, help="a folder of pictures")
    parser.add_argument(
        "--projections", type=Path, help="folder of NAME_P.txt: 3 x 4, world to pixels, as published for each"
    )
    parser.add_argument("--output", type=Path, required=True, help="folder of the asset")
    parser.add_argument("--quality", default="balanced")
    parser.add_argument("--sheet", type=Path, help="JPEG of photographs, views and the asset")
    parser.add_argument("--document", type=Path, help="Markdown file whose block `real` is filled")


def run(args: argparse.Namespace) -> int:
    """Make the asset, compare its cameras, tell; returns the exit status.

    Raises:
        ArmError: a projection cannot be read.
    """
    said = answer(args.photographs, args.output, args.quality, "--preview")
    rows: list[tuple[str, str]] = [("said", said.said + (f": {said.words}" if said.words else ""))]
    if said.said != REFUSED:
        report = json.loads((args.output / "report.json").read_text(encoding="utf-8"))
        solved = read_solved(args.output / "views")
        rows.append(("pictures with a camera", f"{len(solved)} of {report['photographs']['pictures']}"))
        if args.projections is not None:
            rows += _told(camera_errors(solved, _centered(published(args.projections))))
        frames = json.loads((args.output / "views" / TRANSFORMS).read_text(encoding="utf-8"))["frames"]
        rows.append(("views", str(len(frames))))
        rows.append(("share of the surface that they see", f"{report['seen_share']:.0%}"))
    rows += [("seconds", f"{said.seconds:.0f}"), ("peak memory, MiB", f"{said.memory:,.0f}")]
    text = paragraphs(markdown_table(("what", "found"), rows), f"Made by `{args.command}`.")
    print(text)
    if args.sheet is not None and said.said != REFUSED:
        save_sheet(args.sheet, args.photographs, args.output)
    if args.document is not None:
        fill_block(args.document, "real", text)
    return 0


def published(folder: Path) -> dict[str, NDArray[np.float64]]:
    """(4, 4) c2w, OpenGL axes, of each `NAME_P.txt` in `folder`, by its name.

    Raises:
        ArmError: there is none, or one is no 3 x 4 matrix of a camera.
    """
    found = {}
    for path in sorted(folder.glob("*_P.txt")):
        try:
            projection = np.loadtxt(path).reshape(3, 4)
            found[path.name.removesuffix("_P.txt")] = pose_of(projection)
        except (OSError, ValueError, np.linalg.LinAlgError) as error:
            raise ArmError(f"{path}: no 3 x 4 projection ({error}); give it as its authors publish it") from error
    if not found:
        raise ArmError(f"{folder}: no NAME_P.txt; give the folder of the published projections")
    return found


def pose_of(projection: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) c2w, OpenGL axes, of K [R | t] (3, 4), which is known up to a factor (Hartley and Zisserman, 6.2.4)."""
    left = projection[:, :3]
    sign = np.sign(np.linalg.det(left))
    # RQ by QR of the rows in reverse.
    q, r = np.linalg.qr((sign * left)[::-1].T)
    rotation = q.T[::-1]
    # K is upper triangular with a positive diagonal.
    rotation = np.sign(np.diag(r)[::-1])[:, None] * rotation
    c2w = np.eye(4)
    c2w[:3, :3] = rotation.T @ np.diag([1.0, -1.0, -1.0])
    c2w[:3, 3] = -np.linalg.solve(left, projection[:, 3])
    return c2w


def _centered(poses: dict[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    """The poses about the point that the cameras look at: errors are told by the distance from there."""
    c2ws = np.stack(list(poses.values()))
    c2ws[:, :3, 3] -= object_center(torch.from_numpy(c2ws)).numpy()
    return dict(zip(poses, c2ws, strict=True))


def _told(errors: CameraErrors) -> list[tuple[str, str]]:
    centers, angles = (np.array(list(values.values())) for values in (errors.centers, errors.angles))
    return [
        (
            "centres beside the published ones, of the distance",
            f"median {np.median(centers):.2%}, worst {centers.max():.2%}",
        ),
        ("rotations", f"median {np.median(angles):.2f}°, worst {angles.max():.2f}°"),
    ]


def save_sheet(path: Path, photographs: Path, asset: Path) -> None:
    """A row of photographs, one of the views that were made of them, and the asset under two environments."""
    frames = json.loads((asset / "views" / TRANSFORMS).read_text(encoding="utf-8"))["frames"]
    frames = frames[:: max(1, len(frames) // SHOWN)][:SHOWN]
    taken = [square_tile(Image.open(photographs / frame["photograph"])) for frame in frames]
    views = []
    for frame in frames:
        image = read_image(asset / "views" / frame["file_path"])
        cut = Image.fromarray((_over_grey(image) * 255.0).byte().permute(1, 2, 0).numpy())
        views.append(square_tile(cut))
    rows: list[list[tuple[str, Tensor | None]]] = [
        [("photograph", one) for one in taken],
        [("view", one) for one in views],
    ]
    sheet = tiled(rows, len(frames))
    preview = Image.open(asset / "preview.png").convert("RGB")
    preview = preview.resize((sheet.width, round(preview.height * sheet.width / preview.width)))
    both = Image.new("RGB", (sheet.width, sheet.height + preview.height), "white")
    both.paste(sheet, (0, 0))
    both.paste(preview, (0, sheet.height))
    with whole_file(path) as temporary:
        both.save(temporary, format="JPEG", quality=88)


def _over_grey(image: Tensor) -> Tensor:
    """(3, H, W) sRGB of a view (4, H, W) before grey."""
    return (srgb_from_linear(image[:3]) * image[3:] + 0.6 * (1.0 - image[3:])).clamp(0.0, 1.0)
