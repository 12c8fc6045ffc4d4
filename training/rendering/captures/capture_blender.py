"""`python -m training render --layout capture`: an object on a ground, walked around with a phone, and the truth of it.

`OUTPUT/<id>-<setting>/`: images/IMG_0000.jpg and so on, masks/IMG_0000.png (grey: how much of a pixel is the object),
mesh.npz (the true mesh in the cameras' frame, its longest side 2) and, last, truth.json: of every picture c2w (OpenGL
axes), the lens as COLMAP has it, and gain, the linear factors of red, green and blue.
"""

import logging
import math
import tempfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import torch
from mathutils import Matrix
from PIL import Image

from arm_blender.blender.asset.studio import aim_view_camera
from arm_blender.commands import interrupts
from arm_blender.commands.progress_line import Counted
from arm_blender.errors import ArmError
from arm_blender.machine.files import whole_file, write_json
from arm_blender.machine.quiet import STDOUT, silenced
from arm_blender.photographs.capture import Lens

from ..assets import Asset
from ..passes_blender import SCRATCH, RenderConfig, configure_cycles
from ..render_blender import illuminate
from ..scene_blender import complete_materials, import_object, normalise, triangles
from ..shards import save_arrays
from . import phone
from .ground_blender import (
    Surface,
    add_block,
    add_clutter,
    add_ground,
    mark_object,
    random_surface,
    render_linear,
)
from .rig import CaptureConfig, Pose, hand_held, phone_lens

logger = logging.getLogger(__name__)

TRUTH = "truth.json"
"""Written last: it marks a capture as whole."""

_TABLE = 7.0
"""World units along a side of the ground, where the object's longest side is 2."""

_REPEATS = 14.0
"""Of the texture along a side of a ground that repeats."""


def render_captures(
    assets: Sequence[Asset],
    hdris: Sequence[Path],
    textures: Sequence[Path],
    output: Path,
    render: RenderConfig,
    config: CaptureConfig,
    settings: int,
) -> int:
    """Every object in each of its settings; whole ones are kept. 1 where none of several could be rendered."""
    waiting = [(asset, setting) for asset in assets for setting in range(settings)]
    failed, count = 0, Counted(len(waiting), logger.info)
    for asset, setting in waiting:
        folder = output / f"{asset.key}-{config.spoilt or setting}"
        if (folder / TRUTH).exists():
            count.skip()
            continue
        try:
            with silenced(STDOUT):
                render_capture(asset, hdris, textures, folder, render, config, setting)
        except (ArmError, RuntimeError) as error:  # Blender's operators raise RuntimeError.
            failed += 1
            logger.warning("%s: left out: %s", asset.key, error)
        count(folder.name)
    return 1 if waiting and failed == len(waiting) else 0


def render_capture(
    asset: Asset,
    hdris: Sequence[Path],
    textures: Sequence[Path],
    folder: Path,
    render: RenderConfig,
    config: CaptureConfig,
    setting: int,
) -> None:
    """One capture.

    Args:
        hdris, textures: one of each is drawn for a setting, no two alike for the settings of an object.
    Raises:
        ArmError: the object cannot be imported.
    """
    key = zlib.crc32(asset.key.encode())
    rng = np.random.default_rng([config.seed, key, setting])
    order = np.random.default_rng([config.seed, key])
    hdri = hdris[int(order.permutation(len(hdris))[setting % len(hdris)])]
    texture = textures[int(order.permutation(len(textures))[setting % len(textures)])]
    objects = import_object(Path(asset.path), asset.up)
    normalise(objects)
    vertices, faces = triangles(objects)
    complete_materials(objects)
    mark_object(objects)
    illuminate(hdri, rng)
    repeats = _REPEATS if config.spoilt == "repeating" else 1.0
    low, high = vertices.min(0), vertices.max(0)
    turn = rng.uniform(0.0, 2.0 * math.pi)
    add_ground(Surface(texture, repeats=repeats), float(low[2]), _TABLE, turn)
    beside = np.random.default_rng([config.seed, key, setting, 1])  # Its own: without it everything else stays.
    if config.clutter:
        add_clutter(textures, float(low[2]), beside)
    if config.spoilt == "two":
        place = (float(high[0]) + 0.9, 0.0, float(low[2]))
        add_block(random_surface(textures, 1.5, beside), "cylinder", (1.2, 1.2, 1.5), place, turn)
    configure_cycles(render)
    lens = phone_lens(config, rng)
    poses = hand_held(config, float(np.linalg.norm(high - low)) / 2.0, rng)
    save_arrays(folder / "mesh.npz", {"vertices": vertices, "faces": faces.astype(np.int32)})
    pictures = _photographs(poses, lens, folder, config, rng)
    truth = {"object": asset.key, "hdri": hdri.stem, "ground": texture.parent.name, "spoilt": config.spoilt}
    write_json(folder / TRUTH, {**truth, "mesh": "mesh.npz", "pictures": pictures})


def _photographs(
    poses: Sequence[Pose], lens: Lens, folder: Path, config: CaptureConfig, rng: np.random.Generator
) -> list[dict[str, Any]]:
    """Take the pictures of a scene that is ready; what `truth.json` says of each."""
    root = bpy.data.objects["root"]
    standing = root.matrix_world.copy()
    told = []
    with tempfile.TemporaryDirectory(dir=SCRATCH) as scratch:
        for index, pose in enumerate(poses):
            interrupts.check()
            root.matrix_world = Matrix.Rotation(pose.turn, 4, "Z") @ standing
            aim_view_camera(bpy.context.scene, phone.wider_pinhole(pose.c2w, lens))
            color, coverage = render_linear(Path(scratch) / "picture.exr")
            linear = phone.through_lens(torch.from_numpy(color).permute(2, 0, 1).contiguous(), lens)
            mask = phone.through_lens(torch.from_numpy(coverage)[None].float(), lens)[0].round().to(torch.uint8)
            if config.spoilt == "blurred":
                linear = phone.shaken(linear, rng)
            gain = phone.automatic_exposure(linear, rng)
            name = f"IMG_{index:04d}"
            phone.save_photograph(folder / "images" / f"{name}.jpg", linear, gain, lens, config.seed + index)
            (folder / "masks").mkdir(exist_ok=True)
            with whole_file(folder / "masks" / f"{name}.png") as temporary:
                Image.fromarray(mask.numpy()).save(temporary, format="PNG")
            told.append(
                {
                    "file": f"images/{name}.jpg",
                    "mask": f"masks/{name}.png",
                    "c2w": pose.around_object().tolist(),
                    "lens": {
                        "model": lens.model,
                        "parameters": list(lens.parameters),
                        "width": lens.width,
                        "height": lens.height,
                    },
                    "gain": list(gain),
                }
            )
    return told
