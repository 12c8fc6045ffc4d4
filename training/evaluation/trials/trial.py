"""What is tried: settings of the pipeline with weights from anywhere, and the words that choose them."""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from arm_blender.config import PRESETS, QUALITIES, Settings
from arm_blender.errors import ArmError
from arm_blender.networks import check_folder
from arm_blender.views import ViewOptions

from ...losses import Perceptual
from ..scores.alignment import AlignmentConfig
from ..scores.geometry import SAMPLES
from ..truth.protocol import Protocol


@dataclass(frozen=True)
class Trial:
    """What every object goes through."""

    settings: Settings
    """Of the system that is evaluated."""
    protocol: Protocol
    """What the truth was rendered by."""
    seed: int = 0
    """Of the points compared."""
    points: int = SAMPLES
    """On each surface."""
    alignment: AlignmentConfig = AlignmentConfig()
    """Of shapes whose frame is unknown."""
    align: bool = True
    """Compare shapes whose frame is known after the paper's alignment as well; it takes longer than all else."""
    cycles: bool = True
    """Render the assets under both lights. Without, lit colour and relighting have no scores."""
    one_view: bool = True
    """Try the one true view and the bare picture as well."""
    perceptual: Perceptual | None = None
    """LPIPS, where its weights are at hand."""
    others: dict[str, Settings] = field(default_factory=dict)
    """Further weights by the names of their rows, for ablations."""
    provider: Callable[[str], ViewOptions] | None = None
    """How six views of an object's one picture are drawn, by its name; None tries none."""
    meshes: Path | None = None
    """Folder of another system's meshes, which are measured in the place of ours."""
    own_frame: bool = True
    """Whether those lie in the cameras' frame; otherwise they are shown as the paper's alignment leaves them."""


def add_object_arguments(parser: argparse.ArgumentParser, required: bool = True) -> None:
    """The words that choose what is measured, shared with `sweep`, which needs `--views`."""
    parser.add_argument("--views", type=Path, required=required, help="folder written by `render --layout views`")
    parser.add_argument("--data", type=Path, help="folder with manifest.json; ARM_DATA by default")
    parser.add_argument("--set", nargs="*", help="sets of the manifest; gso by default of shapes alone, else all")
    parser.add_argument("--split", default="eval", choices=("train", "eval"))
    parser.add_argument("--limit", type=int, help="only the first objects, by name")
    parser.add_argument("--preset", default="small", choices=PRESETS)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--seed", type=int, default=0, help="of the points compared")


def add_trial_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that choose what is tried."""
    parser.add_argument("--quality", default="balanced", choices=QUALITIES)
    parser.add_argument("--grid", type=int, help="samples a side; the quality's by default")
    parser.add_argument("--faces", type=int, help="face budget; the quality's by default")
    parser.add_argument("--refinement", type=int, help="rounds of the shape's refinement; the quality's by default")
    parser.add_argument("--weights", type=Path, metavar="DIR", help="other weights, by the names of the shipped ones")
    parser.add_argument(
        "--also", nargs="*", default=(), metavar="NAME=DIR", help="rows for further weights, as of an ablation"
    )


def trial_settings(args: argparse.Namespace, weights: Path | None = None) -> Settings:
    """The settings that the words ask for; `weights` over those of the words.

    Raises:
        ArmError: a value does not do, or as `networks.check_folder`.
    """
    words = {name: getattr(args, name) for name in ("preset", "quality", "grid", "faces", "refinement", "device")}
    settings = Settings(**words, weights_folder=weights or args.weights)
    check_folder(settings)
    return settings


def other_settings(args: argparse.Namespace) -> dict[str, Settings]:
    """The settings of every row that `--also` asks for.

    Raises:
        ArmError: a word is not NAME=DIR, or as `trial_settings`.
    """
    rows = {}
    for word in args.also:
        name, equals, folder = word.partition("=")
        if not (name and equals and folder):
            raise ArmError(f"--also {word}: give NAME=DIR")
        rows[name] = trial_settings(args, Path(folder))
    return rows
