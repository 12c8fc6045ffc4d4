"""Render the truth of the evaluation into its cache, by Cycles: inputs, test views, and test views in another light."""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import torch

from arm_blender.commands.progress_line import Counted
from arm_blender.errors import ArmError
from arm_blender.machine.files import staging, write_json

from ...rendering.lighting_blender import blender_environments, mean_radiance, set_world
from ...rendering.passes_blender import RenderConfig, configure_cycles
from ...rendering.render_blender import render_views, write_views
from ...rendering.scene_blender import (
    add_aovs,
    import_object,
    normalise,
    principled,
    reduce_to_brdf,
    set_constant,
    triangles,
)
from ...rendering.shards import save_arrays
from .protocol import EXPOSURE, UNMEASURED, EvaluationEntry, Protocol, chosen_for, relit_lights
from .truth import ARRAYS, FRONT, RECORD, is_whole, relit_files

logger = logging.getLogger(__name__)


def render_missing(
    entries: Sequence[EvaluationEntry], cache: Path, data: Path, lights: dict[str, list[Path]], protocol: Protocol
) -> None:
    """Render every object that is not in the cache yet.

    Args:
        cache: folder of the protocol.
        data: what the files of lights are relative to in the records.
        lights: HDRIs of "train" for the inputs and of "eval" for the other light.
    Raises:
        ArmError: an object cannot be rendered; those before it are kept.
    """
    missing = [entry for entry in entries if not is_whole(cache / entry.name)]
    count = Counted(len(missing), logger.info)
    for entry in missing:
        first, other = (chosen_for(entry.name, lights[split]) for split in ("train", "eval"))
        others = [other]
        if protocol.relit_views is not None:
            others = relit_lights(lights["eval"], blender_environments(), first, protocol.environments)
        try:
            with staging(cache) as stage:
                _render(entry, first, others, stage / entry.name, protocol)
                record: dict[str, Any] = {"input_light": _name(first, data), "other_light": _name(other, data)}
                if protocol.relit_views is not None:
                    record["relit_lights"] = [_name(light, data) for light in others]
                write_json(stage / entry.name / RECORD, record | {"kind": entry.kind, "file": entry.path.name})
                (stage / entry.name).replace(cache / entry.name)
        except RuntimeError as error:  # Blender's importers raise it on a broken file.
            raise ArmError(f"{entry.path}: cannot be rendered ({error}); leave it out with --ids") from error
        count(f"the truth of {entry.name} is rendered")


def environments(lights: dict[str, list[Path]]) -> dict[str, list[Path]]:
    """The HDRIs of both splits; without any of a split Blender's own, one half for each."""
    own = blender_environments()
    return {"train": lights["train"] or own[::2], "eval": lights["eval"] or own[1::2]}


def _name(hdri: Path, data: Path) -> str:
    """Relative to the data folder where it lies there, so that both may move."""
    return str(hdri.relative_to(data) if hdri.is_relative_to(data) else hdri)


def _render(entry: EvaluationEntry, first: Path, others: list[Path], folder: Path, protocol: Protocol) -> None:
    objects = import_object(entry.path, entry.up)
    normalise(objects)
    vertices, faces = triangles(objects)
    for material in bpy.data.materials:
        reduce_to_brdf(material)
        if not entry.has_material:
            _set_unmeasured(material)
    prepare_render(protocol.resolution, protocol.samples)
    light(first)
    inputs = render_views(protocol.inputs())
    tests = (*protocol.tests(), protocol.front())
    lit = render_views(tests)
    write_views(folder, inputs, protocol.inputs())
    write_views(folder / FRONT, lit[-1:], tests[-1:])
    save_arrays(folder / "mesh.npz", {"vertices": vertices, "faces": faces.astype(np.int32)})
    names = ("rgba", "albedo", "roughness", "metallic", "depth")
    arrays = {name: np.stack([view[name] for view in lit]) for name in names}
    for path, other in zip(relit_files(folder, len(others)), others, strict=True):
        light(other)
        relit = [view["rgba"] for view in render_views(protocol.relit())]
        if protocol.relit_views is None:
            # The front view comes last and has no other light of its own.
            arrays["relit"] = np.stack([rgba[..., :3] for rgba in (*relit, lit[-1]["rgba"])])
        else:
            save_arrays(path, {"rgba": np.stack(relit)})
    arrays["c2w"] = torch.stack([camera.c2w for camera in tests]).numpy()
    arrays["K"] = torch.stack([camera.K for camera in tests]).numpy()
    save_arrays(folder / ARRAYS, arrays)


def prepare_render(resolution: int, samples: int) -> None:
    """Cycles and the passes of the open scene."""
    configure_cycles(RenderConfig(resolution, samples))
    add_aovs()


def light(hdri: Path) -> None:
    """Light the scene by an HDRI of the protocol's exposure."""
    set_world(hdri, 0.0, EXPOSURE / max(mean_radiance(hdri), 1e-3))


def _set_unmeasured(material: bpy.types.Material) -> None:
    """The finish that is agreed on for scans without one."""
    node = principled(material)
    if node is None:
        return
    for name, value in zip(("Roughness", "Metallic"), UNMEASURED, strict=True):
        set_constant(material, node.inputs[name], value)
