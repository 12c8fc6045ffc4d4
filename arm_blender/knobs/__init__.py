"""What a user may choose, each choice declared once: its default, what it may be, its words here and there.

Of the declarations are made: the configs of the stages that read them (`Settings`, `ViewOptions`, `Zero123PlusConfig`),
the options of the command line and the columns of a batch's list, the properties of Blender's panel and what it asks
for, and what an object keeps of its run. A new knob is declared here and read where it counts; nothing else changes.

Imports nothing heavy.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from .declaring import Rule, Shown, check, knob, knobs_of, one_of, values_of, within
from .finishes import EXAMPLE, PRESETS, are_finishes

__all__ = ["DrawingKnobs", "Knobs", "ViewKnobs", "check", "knobs_of", "values_of"]

PresetName = Literal["small", "paper", "instantmesh"]
QualityName = Literal["draft", "balanced", "final"]
PrecisionName = Literal["auto", "float32", "bfloat16"]
ProviderName = Literal["none", "zero123plus"]
BackgroundName = Literal["grey", "white"]
CamerasName = Literal["auto", "solve", "rig", "file"]

ZERO123PLUS = "zero123plus-v1.2"
"""The rig, and so far there is no other."""

SHORTEST_LIMIT = 5.0
"""Seconds: twice what the charts of half a million faces take on two cores before anything can be given up."""

USUAL_VIEWS, MOST_VIEWS = 16, 32
"""Views of an object that are chosen of many photographs, and that are used at most."""

_SEED = Rule(lambda seed: 0 <= seed < 2**63, "give 0 to 2**63 - 1")


@dataclass(frozen=True, kw_only=True)
class Knobs:
    """Of the pipeline."""

    preset: PresetName = knob(
        "small",
        "networks: small, paper or instantmesh (default: small)",
        shown=Shown(
            "Networks",
            "Which networks make the asset",
            items=(
                ("small", "Small", "Come with the extension, and need no graphics device"),
                ("paper", "Paper", "Those of the paper; need weights that you trained, and a graphics device"),
                (
                    "instantmesh",
                    "InstantMesh",
                    "Its network for the shape; you import its weights; needs a graphics device",
                ),
            ),
        ),
    )
    weights_folder: Path | None = knob(
        None,
        "weights that you trained, named as those that ship",
        option="weights",
        shown=Shown(
            "Own Weights",
            "Folder of weights that you trained, named as those that ship; for what it lacks those are taken",
            name="own_weights",
            none="",
        ),
    )
    quality: QualityName = knob(
        "balanced",
        "draft, balanced or final (default: balanced)",
        listed=True,
        shown=Shown(
            "Quality",
            "How fine the shape and the texture may become",
            items=(
                ("draft", "Draft", "For a first look, and for objects far away"),
                ("balanced", "Balanced", "For most objects"),
                ("final", "Final", "For close-ups: the largest texture and the most faces; takes longest"),
            ),
        ),
    )
    """What the next five are where they are None."""
    texture_size: int | None = knob(
        None,
        "largest texels a side, a power of two",
        Rule(lambda size: 256 <= size <= 8192 and not size & (size - 1), "give a power of two from 256 to 8192"),
        listed=True,
        shown=Shown(
            "Texture",
            "Width of the texture in pixels at most; it is smaller where the pictures cannot fill it",
            none="AUTO",
            items=(
                ("AUTO", "Automatic", "As the quality says"),
                ("512", "512", "512 x 512 pixels"),
                ("1024", "1024", "1024 x 1024 pixels"),
                ("2048", "2048", "2048 x 2048 pixels"),
            ),
        ),
    )
    faces: int | None = knob(
        None,
        "face budget",
        within(100, math.inf, "give at least 100"),
        listed=True,
        shown=Shown(
            "Faces",
            "Triangles that the mesh may have at most; 0 leaves their number to the quality",
            none=0,
            low=0,
            soft_high=100_000,
        ),
    )
    grid: int | None = knob(None, "samples of the density along a side of the box", within(16, 512), listed=True)
    refinement: int | None = knob(
        None, "rounds in which the shape is moved to meet its pictures, 0 to 3", within(0, 3), listed=True
    )
    dense: bool = knob(False, "sample the density everywhere")
    """Finds parts that touch nothing else, and takes many times longer."""
    device: str = knob("cpu", "cpu, cuda or mps (default: cpu)", one_of(("cpu", "cuda", "mps")), kept=False)
    """Where the networks run."""
    precision: PrecisionName = knob("auto", "of the networks: auto, float32 or bfloat16")
    """auto is what suits the network's size and the device."""
    threads: int | None = knob(None, "of the CPU", within(1, 1024), kept=False)
    """None leaves torch's choice. More than 1024 is a slip of the finger, and the system may refuse to start them."""
    time_limit: float = knob(
        60.0,
        "seconds that unwrapping may take",
        within(SHORTEST_LIMIT, math.inf, f"give {SHORTEST_LIMIT:g} seconds or more"),
        letter="S",
    )
    """Charts are packed without xatlas where it would take longer."""
    seed: int = knob(
        0,
        None,
        _SEED,
        listed=True,
        shown=Shown("Seed", "The same seed gives the same result again", low=0),
    )
    """Of whatever is drawn at random."""
    random_weights: int | None = knob(None, "for tests: of this seed; the result is noise", _SEED)
    """A seed of random weights for all networks, instead of those in files."""
    finish: str | None = knob(
        None,
        f"of regions, by number: {EXAMPLE}",
        Rule(are_finishes, f"give regions with a finish or roughness/metallic, as {EXAMPLE}; {', '.join(PRESETS)}"),
        listed=True,
        shown=Shown(
            "Finishes",
            f"What regions are made of, by their numbers, as in {EXAMPLE}; the panel Materials sets them afterwards",
            none="",
        ),
    )
    """Sets what the parts of one finish are made of, over what is predicted; regions.png shows their numbers."""
    normal_map: bool = knob(
        False,
        "keep the detail that decimation takes",
        shown=Shown("Normal Map", "Keep the fine detail of the shape that its faces are too few for"),
    )


@dataclass(frozen=True, kw_only=True)
class ViewKnobs:
    """How pictures are taken that come without cameras, and how much each counts."""

    rig: str = knob(
        ZERO123PLUS, "of six images without cameras", one_of((ZERO123PLUS,), "unknown; the rig is {}"), listed=True
    )
    rig_distance: float = knob(
        4.0,
        "of that rig (default: 4)",
        Rule(lambda distance: 0.0 < distance <= 1e6, "give a positive distance, at most 1e6"),
        letter="D",
        listed=True,
        shown=Shown(
            "Distance",
            "How far the cameras stand from the middle of the object, whose longest side counts as 2",
            low=0.1,
            soft_high=10.0,
        ),
    )
    """World units. Larger than the pictures were made at makes the object too large for its box."""
    elevation_deg: float | None = knob(
        None,
        "of a single image's camera (default: 10)",
        within(-90.0, 90.0, "give degrees between -90 and 90"),
        letter="DEG",
        option="elevation",
        listed=True,
        shown=Shown(
            "Elevation",
            "How far the camera looked down on the object, in degrees: 0 is level; a wrong value tilts the object",
            name="elevation",
            default=10.0,
            low=-90.0,
            high=90.0,
        ),
    )
    """A wrong one tilts the object."""
    fovy_deg: float | None = knob(
        None,
        "of a single image or the rig (default: 30)",
        within(0.1, 179.0, "give degrees from 0.1 to 179"),
        letter="DEG",
        option="fovy",
        listed=True,
        shown=Shown(
            "Field of View",
            "How wide the camera saw, from top to bottom, in degrees; a wrong value deepens or flattens the object",
            name="fovy",
            default=30.0,
            low=1.0,
            high=170.0,
        ),
    )
    """Of a single picture's crop or of the rig. A wrong one deepens or flattens the object."""
    cameras_from: CamerasName = knob(
        "auto",
        "of several pictures: solve, rig, file or auto (default: auto, by what is there)",
        option="cameras",
        listed=True,
    )
    """Where they come from: solved from photographs or a video, six known ones, or a file beside the pictures."""
    length: float | None = knob(
        None,
        "metres of the object's longest side; the asset is made that long",
        Rule(lambda metres: 0.0 < metres <= 1e4, "give a positive length in metres, at most 10000"),
        letter="M",
        listed=True,
    )
    """Pictures know no scale: without it the asset is as large as its cameras say, 2 units where they were solved. A
    mesh that is given keeps its size."""
    photo_views: int = knob(
        USUAL_VIEWS,
        f"that are chosen of many photographs (default: {USUAL_VIEWS})",
        within(3, MOST_VIEWS),
        listed=True,
    )
    """The sharpest that see the object whole and from all around; docs/photographs.md measures fewer and more."""
    weights: tuple[float, ...] | None = knob(None, "how much each view counts", option="view-weights", listed=True)
    """One per view, before views that see nothing are skipped; 0 leaves one out. None takes transforms.json's, or 1."""
    multiview: ProviderName = knob("none", "of a single image: none, zero123plus (default: none)")
    """What makes further views of a single picture; "none" reconstructs from it alone."""


@dataclass(frozen=True, kw_only=True)
class DrawingKnobs:
    """Of the six views that Zero123++ draws of a single picture."""

    steps: int = knob(
        28,
        "75 for fine detail (default: 28)",
        within(1, 1000),
        option="multiview-steps",
        shown=Shown(
            "Steps",
            "Rounds of drawing; 75 for faces and fine patterns",
            name="multiview_steps",
            low=1,
            high=1000,
        ),
    )
    """Of the sampler, as many as the levels of its training at most. Fewer leave views blurred."""
    guidance: float = knob(
        4.0, "by the image (default: 4)", within(0.0, 100.0), letter="G", option="multiview-guidance"
    )
    """How far each step goes from a prediction without the picture beyond the one with it. Lower follows the picture
    less, higher saturates the colours."""
    background: BackgroundName = knob(
        "grey",
        "of its training: grey or white (default: grey)",
        one_of(get_args(BackgroundName), "choose one of {}"),
        option="multiview-background",
    )
    """What the weights were trained on: the published ones on grey, InstantMesh's on white. The other one ends in
    views that cannot be cut out."""
    reseed: tuple[int, ...] = knob(
        (),
        "draw only these of DIR/views",
        Rule(lambda views: set(views) <= set(range(6)), "give views from 0 to 5"),
    )
    """The views, 0 to 5, that are drawn anew with `seed` while those in the folder keep theirs; () draws all six."""
