"""Pictures one after another as a video, by the encoder that Blender brings."""

import tempfile
from collections.abc import Sequence
from pathlib import Path

import bpy

from ...errors import ArmError
from ..asset.blend_file import written_by_blender
from ..asset.studio import temporary_scene
from ..compat import sequence_strips, use_mp4
from ..console import without_chatter
from .pictures import write_sheet


@without_chatter()
def write_video(path: Path, pictures: Sequence[Path], frames_per_second: int = 24) -> None:
    """An MP4 (H.264) of PNGs of one size, on the grey of the preview where they are transparent.

    Args:
        path: the file, .mp4; an older one is replaced.
        pictures: in their order; an odd row or column of pixels is lost, for H.264 takes even sizes only.
        frames_per_second: at least 1.
    Raises:
        ArmError: this Blender has no encoder.
        OutputError: the file cannot be written.
    """
    if not pictures:
        raise ValueError("a video needs at least one picture")
    if not bpy.app.ffmpeg.supported:
        raise ArmError(f"{path}: this Blender has no video encoder; keep the pictures")
    with temporary_scene("Video") as scene, tempfile.TemporaryDirectory(prefix="arm-video-") as folder:
        opaque = [Path(folder) / f"{number:05d}.png" for number in range(len(pictures))]
        for source, target in zip(pictures, opaque, strict=True):
            write_sheet(target, [[source]])
        strip = sequence_strips(scene).new_image(
            name="pictures", filepath=str(opaque[0]), channel=1, frame_start=1, fit_method="ORIGINAL"
        )
        for picture in opaque[1:]:
            strip.elements.append(picture.name)
        width, height = strip.elements[0].orig_width, strip.elements[0].orig_height
        scene.frame_start, scene.frame_end = 1, len(opaque)
        render = scene.render
        render.fps, render.fps_base = frames_per_second, 1.0
        render.resolution_x, render.resolution_y = width - width % 2, height - height % 2
        render.use_sequencer, render.use_file_extension = True, False
        scene.view_settings.view_transform = "Standard"
        scene.sequencer_colorspace_settings.name = "sRGB"
        use_mp4(scene)
        with written_by_blender(path) as partial:
            render.filepath = str(partial)
            bpy.ops.render.render(scene=scene.name, animation=True)
