"""What differs between Blender 4.2 and 5.2, and between builds, in one place."""

import logging
import sys
from pathlib import Path

import bpy

logger = logging.getLogger(__name__)

# Blender 4.2 to 4.5 call the new Eevee by another name.
EEVEE = "BLENDER_EEVEE" if bpy.app.version >= (5, 0, 0) else "BLENDER_EEVEE_NEXT"

# Since 4.5 a path that may begin with `//`, the folder of the .blend, has to say so.
BLEND_RELATIVE = {"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5, 0) else set()

# Python imported Blender, not the other way round. Blender 4.2 has no `bpy.app.module` to ask.
IS_MODULE = not bpy.app.binary_path

# Both leave base colours as they are below the highlights; AgX, the default, changes them.
NEUTRAL_VIEW_TRANSFORMS = ("Khronos PBR Neutral", "Standard")


def find_bundled_libraries() -> None:
    """Have Python find what Blender brings, such as OpenImageIO: as a module it hides that from the Python it is in."""
    if not IS_MODULE:
        return
    place = Path(bpy.utils.resource_path("LOCAL"), "python", "lib")
    site = place / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
    if site.is_dir() and str(site) not in sys.path:
        sys.path.append(str(site))  # Last: that Python's own numpy stays the one.


def shader_tree(owner: bpy.types.Material | bpy.types.World) -> bpy.types.ShaderNodeTree:
    """The node tree of a material or world, made where there is none."""
    if owner.node_tree is None:  # From 5.0 on the tree is always there, and setting `use_nodes` warns.
        owner.use_nodes = True
    return owner.node_tree


def use_cycles(scene: bpy.types.Scene, samples: int, denoise: bool = True) -> None:
    """Render `scene` by Cycles on the CPU, denoised where this build can.

    Args:
        samples: paths a pixel.
        denoise: ask for OpenImageDenoise; some distributions build without it.
    """
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.samples = samples
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    if denoise:
        try:
            cycles.denoiser = "OPENIMAGEDENOISE"
        except TypeError:
            logger.info("this build of Blender has no OpenImageDenoise; rendering without denoising")
        else:
            cycles.use_denoising = True


def use_eevee(scene: bpy.types.Scene, samples: int) -> None:
    """Render `scene` by Eevee with `samples` a pixel; it needs a graphics device, real or software."""
    scene.render.engine = EEVEE
    scene.eevee.taa_render_samples = samples
    # Without rays a matt surface sees a world as first-order harmonics: two lamps across from each other cancel out.
    scene.eevee.use_raytracing = True
    rays = scene.eevee.ray_tracing_options
    rays.trace_max_roughness, rays.resolution_scale = 1.0, "1"
    rays.denoise_temporal = False  # It takes the few rays that meet a small lamp for noise, and a third of the light.
    for limit in ("clamp_surface_direct", "clamp_surface_indirect"):
        if hasattr(scene.eevee, limit):  # Since 4.3; by default the reflection of a bright lamp is cut off.
            setattr(scene.eevee, limit, 0.0)


def use_neutral_view(scene: bpy.types.Scene) -> None:
    """Show colours without a film look, so that a base colour can be judged in the render."""
    for transform in NEUTRAL_VIEW_TRANSFORMS:
        try:
            scene.view_settings.view_transform = transform
        except TypeError:  # A user's own colour configuration may lack it.
            continue
        break
    scene.render.dither_intensity = 0.0


def use_png(scene: bpy.types.Scene) -> None:
    """Write stills of `scene` as 8-bit RGBA PNG."""
    image = _images_of_kind(scene, "IMAGE")
    image.file_format = "PNG"
    image.color_mode = "RGBA"
    image.color_depth = "8"


def use_exr(scene: bpy.types.Scene, layers: bool = False) -> None:
    """Write stills of `scene` as linear float EXR with alpha, uncompressed; with `layers`, of every pass."""
    image = _images_of_kind(scene, "MULTI_LAYER_IMAGE" if layers else "IMAGE")
    image.file_format = "OPEN_EXR_MULTILAYER" if layers else "OPEN_EXR"
    if not layers:
        image.color_mode = "RGBA"
    image.color_depth = "32"
    image.exr_codec = "NONE"


def use_mp4(scene: bpy.types.Scene) -> None:
    """Write animations of `scene` as H.264 in an MP4."""
    _images_of_kind(scene, "VIDEO").file_format = "FFMPEG"
    video = scene.render.ffmpeg
    video.format, video.codec, video.constant_rate_factor, video.audio_codec = "MPEG4", "H264", "HIGH", "NONE"


def _images_of_kind(scene: bpy.types.Scene, kind: str) -> bpy.types.ImageFormatSettings:
    """The output settings of `scene`; since 5.0 the kind of media limits their formats."""
    image = scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = kind
    return image


def sequence_strips(scene: bpy.types.Scene) -> bpy.types.bpy_prop_collection:
    """The strips of the scene's sequencer, which is made where there is none; 4.4 gave them another name."""
    editor = scene.sequence_editor_create()
    return editor.strips if hasattr(editor, "strips") else editor.sequences


def reason(error: Exception) -> str:
    """What Blender's operators and writers raised, without their prefix and in one line."""
    return " ".join(str(error).split()).removeprefix("Error: ") or type(error).__name__
