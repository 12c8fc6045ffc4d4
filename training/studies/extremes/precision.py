"""How far float32 and bfloat16 stray from float64 on the same inputs: the second table of the document on stability.

What a part reads is recorded in one run of the whole in float32, so that each part is charged with its own error and
not with those of the parts before it.
"""

import copy
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from typing import Any, get_args

import torch
from torch import Tensor, nn

from arm_blender import networks, pipeline
from arm_blender.config import PRESETS, Preset, Settings
from arm_blender.graphics.light.brdf import Form, evaluate
from arm_blender.graphics.raster.differentiable import with_gradient
from arm_blender.graphics.raster.rasterize import interpolate, rasterize
from arm_blender.graphics.surface.isosurface import crossed_edges, vertices_from_densities
from arm_blender.graphics.surface.sample_grid import IsosurfaceConfig
from arm_blender.models.atlas_network import AtlasNetworkConfig
from arm_blender.models.ffc import FfcConfig
from arm_blender.models.image_encoder import ImageEncoderConfig
from arm_blender.models.material_encoder import MaterialEncoderConfig
from arm_blender.models.network_views import NetworkViews, network_views
from arm_blender.models.paper.reconstruction import ReconstructionConfig
from arm_blender.models.transformer import TransformerConfig
from arm_blender.models.triplane import UpsamplerConfig
from arm_blender.models.unet import UnetConfig
from arm_blender.models.vit import VitConfig
from arm_blender.structures import TexelMap, TexelViews, ViewSet
from arm_blender.uv.backproject import backproject
from arm_blender.uv.blend import blend
from arm_blender.uv.decimate import decimate
from arm_blender.uv.maps import diffuse_fill
from arm_blender.uv.texels import texel_map
from arm_blender.uv.unwrap import UnwrapConfig, unwrap
from arm_blender.weight_files import checkpoints

EXPLANATION = """\
Errors of float32 and of bfloat16 (autocast) against float64 on the same inputs: the largest of a part, over how far its
values in float64 lie from their mean at most. *small* has its weights and reads the views of `{views}`; *paper, narrow*
is as deep as `paper` and has random ones. Each part reads what it was given in one run in float32. GeoRM as a whole
encodes in bfloat16 and decodes in float32; it also decides whether a ray meets the visual hull, and rays that graze it
fall to the other side in other arithmetic. Fourier transforms, the BRDF, the rasteriser and the iso-surface compute in
float32 under autocast, too."""

HEADER = ("part", "small: float32", "small: bfloat16", "paper, narrow: float32", "paper, narrow: bfloat16")

NARROW = Preset(
    georm=ReconstructionConfig(
        encoder=ImageEncoderConfig(image_size=96, width=96, heads=3),
        transformer=TransformerConfig(width=128, heads=4, grid=8),
        upsampler=UpsamplerConfig(filters=64, growth=16, channels=16),
    ),
    glossyrm=ReconstructionConfig(),
    instant_albedo=AtlasNetworkConfig(
        encoder=MaterialEncoderConfig(VitConfig(dim=96, heads=3), image_size=96, channels=32, out_channels=8),
        unet=UnetConfig((16, 32, 64, 128), 16),
        ffc=FfcConfig(width=16),
    ),
)
"""`paper` as deep as it is, for errors grow with depth, but narrow: its weights are random, so that width adds time and
nothing else."""

GEORM_PARTS = {
    "image encoder": "encoder",
    "triplane transformer": "transformer",
    "upsampler of the planes": "upsampler",
    "feature volume": "volume",
    "detail volume": "detail",
    "points read in the views": "reader",
    "decoder of points": "decoder",
}
"""What the table calls them, and where they are in either preset's."""

ALBEDO_PARTS = {"material encoder": "encoder", "U-Net": "unet", "FFC-Net": "ffc"}
"""As above, in `InstantAlbedo`."""


Cells = tuple[str, str]
"""Of the table: what float32 gives, and what bfloat16 gives."""

NOTHING: Cells = ("-", "-")
"""Of a part that a network has not."""


def table(views: ViewSet) -> list[list[str]]:
    """Rows under `HEADER`: every part of `small` with its weights and of a narrow `paper` with random ones.

    Args:
        views: of an object; both read it.
    """
    small, narrow = dict(network_errors(PRESETS["small"], views, True)), dict(network_errors(NARROW, views, False))
    rows = [[part, *small[part], *narrow.get(part, NOTHING)] for part in small]
    return rows + [[part, *errors, "-", "-"] for part, errors in graphics_errors(views)]


@torch.no_grad()
def network_errors(preset: Preset, views: ViewSet, shipped: bool) -> Iterator[tuple[str, Cells]]:
    """The parts of GeoRM and InstantAlbedo, and each of them as a whole.

    Args:
        preset: whose networks.
        views: of an object.
        shipped: whether the networks have their weights, not seeded random ones.
    """
    georm = built("georm", preset.georm, shipped)
    points = 2.0 * torch.rand(1, 4096, 3, generator=torch.Generator().manual_seed(0)) - 1.0
    inputs = network_views(views, preset.georm), points

    def logits(network: Any, views: NetworkViews, points: Tensor) -> Tensor:
        encoded = network.encode(views)
        with torch.autocast("cpu", enabled=False):  # As training does: encoded in half precision, decoded in single.
            return network.occupancy_logit(encoded if points.dtype == torch.float64 else encoded.float(), points)

    yield from _part_errors(getattr(georm, "model", georm), GEORM_PARTS, lambda: logits(georm, *inputs))
    yield "GeoRM, views to logits of points", compared(logits, georm, *inputs)
    single, half, exact = (x[0] > 0.0 for x in in_three_precisions(logits, georm, *inputs))
    if bool(exact.any()) and not bool(exact.all()):  # Random weights may find all of the box on one side.
        name = f"GeoRM, points of {exact.numel():,} that change sides"
        yield name, (str(int((single != exact).sum())), str(int((half != exact).sum())))

    painter = built("instant_albedo", preset.instant_albedo, shipped)
    atlas = _atlas(views)
    yield from _part_errors(painter, ALBEDO_PARTS, lambda: painter(*atlas))
    yield "InstantAlbedo, views to colours", compared(lambda network, *args: network(*args), painter, *atlas)


def built(name: str, config: Any, shipped: bool) -> nn.Module:
    """A network of `networks.NETWORKS` with the weights of `small`, or with seeded random ones."""
    torch.manual_seed(0)
    network = networks.build(name, config)
    if shipped:
        path = Settings().weights(name)
        checkpoints.restore(network, checkpoints.load(path, type(config))[1], path)
    return network.eval()


def _part_errors(network: nn.Module, parts: dict[str, str], run: Callable[[], object]) -> Iterator[tuple[str, Cells]]:
    """Each part of `network`, if it has it, on what it read when the whole was run."""
    read: dict[str, tuple[Any, ...]] = {}
    modules = {part: network.get_submodule(name) for part, name in parts.items() if hasattr(network, name)}
    handles = [
        module.register_forward_pre_hook(lambda _, args, part=part: read.setdefault(part, args) and None)
        for part, module in modules.items()
    ]
    try:
        run()
    finally:
        for handle in handles:
            handle.remove()
    for part in parts:
        found = modules.get(part)
        yield part, compared(lambda network, *args: network(*args), found, *read[part]) if found else NOTHING


def _atlas(views: ViewSet) -> tuple[Tensor, TexelMap, TexelViews, Tensor]:
    """What InstantAlbedo takes: images, texels, what the views say of them, and their blend; on a small atlas."""
    mesh, _ = unwrap(decimate(pipeline.shape(views, Settings(grid=48)), 1500), UnwrapConfig(texture_size=256))
    texels = texel_map(mesh, 128)
    seen = backproject(mesh, texels, views)
    colors, weight = blend(seen, views.weights)
    return views.images, texels, seen, diffuse_fill(colors, (weight > 0.0) & texels.mask, texels)


def graphics_errors(views: ViewSet) -> Iterator[tuple[str, Cells]]:
    """The parts without weights: on the shape that `small` finds in the views, a ball, and random directions."""
    mesh, camera = decimate(pipeline.shape(views, Settings(grid=48)), 1500), views.cameras[0]
    fragments = rasterize(mesh.vertices, mesh.faces, camera)

    def positions(_: None, vertices: Tensor, c2w: Tensor, K: Tensor) -> Tensor:
        """By the rasteriser's own coordinates in float32; in float64 by those of the same faces, found anew."""
        exact = vertices.dtype == torch.float64
        there = replace(camera, c2w=c2w, K=K)
        found = with_gradient(fragments, vertices, mesh.faces, there) if exact else fragments
        return interpolate(vertices, mesh.faces, found)

    yield "rasteriser, positions at the pixels", compared(positions, None, mesh.vertices, camera.c2w, camera.K)
    edges = crossed_edges(lambda p: 50.0 * (0.7 - p.norm(dim=1)), IsosurfaceConfig(48, iso=0.0))
    ends = edges.a, edges.b, edges.density_a, edges.density_b
    yield "iso-surface, vertices", compared(lambda _, a, b, x, y: vertices_from_densities(a, b, x, y, 0.0), None, *ends)
    random = torch.Generator().manual_seed(0)
    normal, light, view = torch.nn.functional.normalize(torch.randn(3, 4096, 3, generator=random), dim=-1)
    finish = torch.rand(4096, 5, generator=random).split((3, 1, 1), dim=1)
    inputs = normal, light, view, *finish
    for form in get_args(Form):
        errors = compared(lambda _, n, i, o, c, r, m, form=form: evaluate(n, i, o, c, r, m, form), None, *inputs)
        yield f"GGX BRDF, {form}", errors


def compared(function: Callable[..., Any], network: nn.Module | None, *inputs: Any) -> Cells:
    """Errors of what `in_three_precisions` gives."""
    single, half, exact = in_three_precisions(function, network, *inputs)
    return f"{_worst(single, exact):.1e}", f"{_worst(half, exact):.1e}"


def in_three_precisions(
    function: Callable[..., Any], network: nn.Module | None, *inputs: Any
) -> tuple[list[Tensor], list[Tensor], list[Tensor]]:
    """What `function(network, *inputs)` gives in float32, under autocast to bfloat16, and in float64.

    Args:
        function: gives a tensor or several.
        network: in float32.
        inputs: tensors in float32, or dataclasses and sequences of them.
    """
    single = _tensors(function(network, *inputs))
    with torch.autocast("cpu", torch.bfloat16):
        half = _tensors(function(network, *inputs))
    with _doubles_by_default():
        exact = _tensors(function(copy.deepcopy(network).double() if network else None, *_doubled(inputs)))
    return single, half, exact


@contextmanager
def _doubles_by_default() -> Iterator[None]:
    """What a network makes by itself, such as the centres of cells, is then float64 as well."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


def _doubled(value: Any) -> Any:
    """The same, every tensor of float32 in float64."""
    if isinstance(value, Tensor):
        return value.double() if value.is_floating_point() else value
    if isinstance(value, tuple | list):
        return type(value)(_doubled(item) for item in value)
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{field.name: _doubled(getattr(value, field.name)) for field in fields(value)})
    return value


def _tensors(value: Any) -> list[Tensor]:
    return [value] if isinstance(value, Tensor) else list(value)


def _worst(found: list[Tensor], exact: list[Tensor]) -> float:
    """The largest of the errors of all tensors, each over how far its tensor's values lie from their mean at most."""
    return max(
        float((x.double() - y).abs().max() / (y - y.mean()).abs().max().clamp(min=1e-30))
        for x, y in zip(found, exact, strict=True)
    )
