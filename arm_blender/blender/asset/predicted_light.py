"""The light of the views, as it was predicted, kept on the object and offered as an environment."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ...errors import ArmError

if TYPE_CHECKING:  # It takes seconds, and the panel's drawing needs none of it.
    from torch import Tensor

KEPT = "arm_light"
"""Custom property of an object: 27 numbers, nine harmonics of red, green and blue."""


def keep_light(made: bpy.types.Object, light: Tensor | None) -> None:
    """Keeps a light (9, 3) with an object; None takes that of an earlier run away."""
    if light is not None:
        made[KEPT] = light.flatten().tolist()
    elif KEPT in made:
        del made[KEPT]


def has_light(shown: bpy.types.Object | None) -> bool:
    """Whether an object keeps the light of its views."""
    return shown is not None and KEPT in shown


def light_file(shown: bpy.types.Object | None) -> Path:
    """The light of an object's views as an environment map, in Blender's own temporary folder.

    Raises:
        ArmError: it has none.
    """
    if shown is None or not has_light(shown):
        name = "The active object" if shown is None else shown.name
        raise ArmError(f"{name}: keeps no light of its views; generate it again, by the networks small")
    import torch

    from ...export.light_file import LIGHT, write_light
    from ...graphics.light.spherical_harmonics import COUNT

    try:
        light = torch.tensor(list(shown[KEPT]), dtype=torch.float32).view(COUNT, 3)
    except (TypeError, RuntimeError) as error:
        raise ArmError(f"{shown.name}: the light of its views was changed; generate it again") from error
    folder = Path(bpy.app.tempdir) / "arm" / bpy.path.clean_name(shown.name)
    folder.mkdir(parents=True, exist_ok=True)
    write_light(light, folder / LIGHT)
    return folder / LIGHT
