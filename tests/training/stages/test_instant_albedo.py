"""Fitting InstantAlbedo, on a painted cube whose texture is known: what is prepared, compared, augmented, learned."""

import argparse
import math

import numpy as np
import pytest
import torch

from arm_blender.config import PRESETS
from arm_blender.errors import ArmError
from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.color import linear_from_srgb, srgb_from_linear
from arm_blender.graphics.raster.rasterize import interpolate, rasterize
from arm_blender.models.ffc import FfcConfig
from arm_blender.models.material_encoder import MaterialEncoderConfig
from arm_blender.models.small.instant_albedo import InstantAlbedo, InstantAlbedoConfig
from arm_blender.models.unet import UnetConfig
from arm_blender.models.vit import VitConfig
from arm_blender.structures import UvMesh
from arm_blender.weight_files import checkpoints
from training.datasets import atlases
from training.datasets.atlas_augmentation import augment
from training.rendering.shards import save_arrays
from training.stages import instant_albedo as stage
from training.trainer import TrainerConfig

SIZE, TEXELS, SHADE = 72, 64, 0.5
TINY = InstantAlbedoConfig(
    encoder=MaterialEncoderConfig(VitConfig(8, 16, 4, 2, 2, 4), (0, 1, 2, 3), 32, 8, 4),
    unet=UnetConfig((8, 8), 8, 2),
    ffc=FfcConfig(8, 2, 1),
    resolution=32,
)


def cube() -> UvMesh:
    """A cube of edge 1.2, each side a square of the atlas with a margin."""
    corners = torch.tensor([[x, y, z] for x in (-0.6, 0.6) for y in (-0.6, 0.6) for z in (-0.6, 0.6)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces, uvs, face_uvs = [], [], []
    for k, (a, b, c, d) in enumerate(quads):
        low = torch.tensor([(k % 3) / 3.0 + 0.02, (k // 3) / 3.0 + 0.02])
        uvs += [low + 0.29 * torch.tensor(corner) for corner in ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))]
        faces += [(a, b, c), (a, c, d)]
        face_uvs += [(4 * k, 4 * k + 1, 4 * k + 2), (4 * k, 4 * k + 2, 4 * k + 3)]
    return UvMesh(corners, torch.tensor(faces), torch.stack(uvs), torch.tensor(face_uvs), 6)


def painted() -> torch.Tensor:
    """(3, T, T) sRGB: a smooth albedo."""
    v, u = torch.meshgrid(torch.linspace(0, 6, TEXELS), torch.linspace(0, 6, TEXELS), indexing="ij")
    return torch.stack([0.6 + 0.2 * torch.sin(u), 0.6 + 0.2 * torch.cos(v), 0.5 + 0.2 * torch.sin(u + v)])


def places(mesh: UvMesh, camera) -> tuple[torch.Tensor, torch.Tensor]:
    """(S, S, 2) where each pixel lies in the atlas, v up, and (S, S) where the mesh is."""
    fragments = rasterize(mesh.vertices, mesh.faces, camera)
    return interpolate(mesh.uvs, mesh.face_uvs, fragments).permute(1, 2, 0), fragments.mask


def looked_up(image: torch.Tensor, uv: torch.Tensor) -> torch.Tensor:
    """(V, C, S, S) of an atlas (C, T, T) at uv (V, S, S, 2), plainly bilinear."""
    grid = torch.stack([2.0 * uv[..., 0] - 1.0, 1.0 - 2.0 * uv[..., 1]], dim=-1)
    return torch.nn.functional.grid_sample(
        image.expand(len(uv), -1, -1, -1), grid, padding_mode="border", align_corners=False
    )


def rig() -> dict[str, np.ndarray]:
    """Ten views of the cube; light is half as bright everywhere as the albedo."""
    mesh, albedo = cube(), linear_from_srgb(painted())
    angles = [(30 + 60 * k, (20, -10)[k % 2]) for k in range(6)] + [(0, 60), (90, 10), (180, -60), (270, 40)]
    views = [orbit_camera(azimuth, elevation, 3.5, 30.0, SIZE, SIZE) for azimuth, elevation in angles]
    arrays = {"rgba": [], "albedo": [], "roughness": [], "metallic": [], "c2w": [], "K": []}
    for camera in views:
        uv, shown = places(mesh, camera)
        for key, texture in (("rgba", SHADE * albedo), ("albedo", albedo)):
            image = srgb_from_linear(looked_up(texture, uv[None]))[0].permute(1, 2, 0) * shown[..., None]
            image = torch.cat([image, shown[..., None].float()], dim=-1) if key == "rgba" else image
            arrays[key].append((image * 255.0).round().to(torch.uint8).numpy())
        for key, value in (("roughness", 153), ("metallic", 255)):
            arrays[key].append((value * shown).to(torch.uint8).numpy())
        arrays["c2w"].append(camera.c2w.numpy())
        arrays["K"].append(camera.K.numpy())
    return {key: np.stack(values) for key, values in arrays.items()}


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """Samples of the cube, as if of three objects."""
    folder = tmp_path_factory.mktemp("cache")
    config = atlases.AtlasConfig(size=TEXELS)
    subsets = atlases.random_subsets(config.subsets, torch.Generator().manual_seed(0))
    sample = atlases.sample_arrays(cube(), rig(), config.size, subsets)
    for name in ("a", "b", "c"):
        save_arrays(folder / f"{name}.rig_0.npz", sample)
    return folder


@pytest.fixture
def atlas(cache):
    return atlases.load(cache / "a.rig_0.npz", 0)


def test_true_textures_cost_next_to_nothing(atlas):
    albedo = linear_from_srgb(painted())
    loss = stage.atlas_loss(albedo, SHADE * albedo, atlas, torch.arange(10), stage.FitConfig())
    wrong = stage.atlas_loss(albedo, albedo, atlas, torch.arange(10), stage.FitConfig())
    assert loss < 0.002
    assert wrong > 20 * loss


def test_base_rendered_into_the_views_recovers_what_they_saw(atlas):
    lookup = atlas.lookup.part(torch.arange(6), slice(None), slice(None))
    shown = srgb_from_linear(lookup.render(atlas.base))
    # Between four texels of its side; at a border the one that is left may lie half a texel away.
    inner = lookup.mask & (lookup.weight > 0).all(dim=-1)
    seen = inner & (lookup.render(atlas.seen.seen[None].float())[:, 0] > 0.99)
    assert seen.sum() > 0.7 * lookup.mask.sum()
    assert (shown - atlas.baked[:6]).abs().amax(dim=1)[seen].quantile(0.95) < 0.03


def test_pixels_lie_where_the_rasterised_mesh_says(atlas):
    """The position map looked up at a pixel projects back into that pixel, where it lies between texels of its side."""
    points = atlas.lookup.render(atlas.texels.position).permute(0, 2, 3, 1)
    for view, camera in enumerate(atlases.cameras(rig())):
        # At a side's border the texels on one side alone are left, and their mean lies inside.
        inner = atlas.lookup.mask[view] & (atlas.lookup.weight[view] > 0).all(dim=-1)
        pixels, _ = atlases.project(points[view][inner], camera)
        row, column = inner.nonzero(as_tuple=True)
        assert len(pixels) > 100
        assert (pixels - torch.stack([column, row], dim=1) - 0.5).abs().max() < 0.1


def test_a_look_up_never_mixes_charts(atlas):
    """Every chart a colour of its own, the gaps another: each pixel shows exactly that of its side of the cube."""
    arrays = atlases.sample_arrays(cube(), rig(), TEXELS, torch.ones(1, 6, dtype=torch.bool))
    chart = torch.from_numpy(arrays["chart"])
    face, owner = torch.from_numpy(arrays["face"]).long(), torch.from_numpy(arrays["face_chart"]).long()
    assert len(owner.unique()) == 6
    found = atlas.lookup.render(torch.where(chart >= 0, chart.float(), 100.0)[None])[:, 0]
    shown = atlas.lookup.mask
    assert shown.sum() > 0.99 * (face >= 0).sum()
    assert (found[shown] - owner[face[shown]]).abs().max() < 1e-4


def test_the_gradient_of_a_look_up_stays_in_the_charts(atlas):
    texture = torch.zeros(2, TEXELS, TEXELS, requires_grad=True)
    atlas.lookup.render(texture).sum().backward()
    assert (texture.grad[:, ~atlas.texels.mask] == 0).all()
    assert texture.grad[0].sum() == pytest.approx(int(atlas.lookup.mask.sum()), rel=1e-4)


def facing(part: atlases.Atlas) -> torch.Tensor:
    """(V, T, T) n.v, at least 0."""
    towards = [part.seen.direction(view, part.texels.position) for view in range(len(part.images))]
    return (torch.stack(towards) * part.texels.normal).sum(dim=1).clamp(min=0)


def test_fewer_input_views_are_a_part_of_all(cache, atlas):
    sizes = []
    for subset in range(3):
        part = atlases.load(cache / "a.rig_0.npz", subset)
        sizes.append(len(part.images))
        assert len(part.seen.color) == len(part.images)
        assert bool((part.seen.seen <= atlas.seen.seen).all())
        assert part.base.isfinite().all()
        assert torch.allclose(facing(part), part.seen.cosine, atol=1e-5)
    assert sizes[0] == 6
    assert all(1 <= size < 6 for size in sizes[1:])


def test_augmentation_changes_colours_and_frame_alike(atlas):
    channels = torch.tensor([2, 0, 1])
    changed = augment(atlas, channels, math.pi / 2)
    assert torch.allclose(changed.seen.cosine, atlas.seen.cosine)
    assert torch.allclose(facing(changed), atlas.seen.cosine, atol=1e-5)
    x, y, z = atlas.texels.position
    assert torch.allclose(changed.texels.position, torch.stack([-y, x, z]), atol=1e-6)
    views, settings = torch.arange(10), stage.FitConfig()
    before = stage.atlas_loss(atlas.base, atlas.base, atlas, views, settings)
    after = stage.atlas_loss(changed.base, changed.base, changed, views, settings)
    assert after.item() == pytest.approx(before.item(), rel=1e-4)


def test_all_rigs_of_an_object_fall_on_one_side(tmp_path):
    paths = [tmp_path / f"{name}.rig_{k}.npz" for name in "abcdefgh" for k in (0, 1)]
    training, held_out = stage.split(paths, 4)
    assert len(held_out) == 4
    assert sorted(training + held_out) == paths
    assert not {p.name[0] for p in training} & {p.name[0] for p in held_out}


def test_a_few_steps_beat_the_blend_on_another_object(cache):
    """The light is half as bright as the albedo everywhere: the correction is learned in no time."""
    torch.manual_seed(0)
    model, settings = InstantAlbedo(TINY), stage.FitConfig(views=3)
    training, held_out = stage.split(atlases.files(cache), 3)
    optimizer = torch.optim.Adam(model.parameters(), 5e-3)
    untrained = stage.validate(model, held_out, settings)
    assert untrained["albedo"] == pytest.approx(untrained["blend as albedo"])
    for step in range(10):
        random = torch.Generator().manual_seed(step)
        loss, numbers = stage.sample_loss(model, stage.draw(training, random), settings, random)
        if step == 0:
            assert loss.item() == pytest.approx(numbers["blend"])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert stage.validate(model, held_out, settings)["albedo"] > untrained["albedo"] + 1.0


def test_fit_writes_weights_that_load(cache, tmp_path):
    """Without time the untrained network is written: whole, in half precision, and it still returns the blend."""
    output = tmp_path / "new" / "small.instant_albedo.safetensors"
    settings = stage.FitConfig()
    stage.fit(stage.Start(TINY), stage.Samples(cache, held_out=3), output, TrainerConfig(minutes=0.0), settings)
    config, state = checkpoints.load(output, InstantAlbedoConfig)
    assert config == TINY
    model = InstantAlbedo(config)
    checkpoints.restore(model, state, output)
    numbers = stage.validate(model, stage.split(atlases.files(cache), 3)[1], settings)
    assert numbers["baked"] == pytest.approx(numbers["blend as baked"])


def test_nothing_to_fit_is_said(tmp_path):
    with pytest.raises(ArmError, match="no samples; give --shards"):
        stage.fit(stage.Start(TINY), stage.Samples(tmp_path), tmp_path / "x.safetensors", TrainerConfig(minutes=0.0))


def test_unwrapped_shards_are_prepared_once(tmp_path):
    """From a file's split vertices to samples: the cube's sides are welded, unwrapped and seen."""
    folder = tmp_path / "shards" / "cube"
    folder.mkdir(parents=True)
    mesh = cube()
    save_arrays(
        folder / "mesh.npz",
        {
            "vertices": mesh.vertices[mesh.faces].flatten(0, 1).numpy(),
            "faces": np.arange(3 * len(mesh.faces), dtype=np.int32).reshape(-1, 3),
        },
    )
    save_arrays(folder / "rig_0.npz", rig())
    cache = tmp_path / "cache"
    config = atlases.AtlasConfig(size=TEXELS)
    assert atlases.prepare(tmp_path / "shards", cache, config) == 1
    (path,) = cache.iterdir()
    written = path.stat().st_mtime_ns
    assert atlases.prepare(tmp_path / "shards", cache, config) == 1
    assert path.stat().st_mtime_ns == written
    atlas = atlases.load(path, 0)
    assert (atlas.texels.position.abs().amax(dim=0)[atlas.texels.mask] - 0.6).abs().max() < 1e-3
    assert atlas.seen.seen.sum() > 0.6 * atlas.texels.mask.sum()
    lookup = atlas.lookup
    seen = lookup.mask & (lookup.render(atlas.seen.seen[None].float())[:, 0] > 0.99)
    shown = srgb_from_linear(lookup.render(atlas.base))
    assert (shown - atlas.baked).abs().amax(dim=1)[seen].quantile(0.9) < 0.04


def test_samples_of_an_earlier_version_are_refused_and_made_anew(tmp_path, cache):
    with np.load(cache / "a.rig_0.npz") as file:
        arrays = {name: file[name] for name in file.files if name != "barycentric"}
    save_arrays(tmp_path / "a.rig_0.npz", arrays)
    assert not atlases.is_current(tmp_path / "a.rig_0.npz") and atlases.is_current(cache / "a.rig_0.npz")
    with pytest.raises(ArmError, match="a.rig_0.npz: made by an earlier version"):
        atlases.load(tmp_path / "a.rig_0.npz", 0)


def test_every_preset_has_its_size():
    parser = argparse.ArgumentParser()
    stage.add_arguments(parser)
    for preset, config in stage.SIZES.items():
        args = parser.parse_args(["--cache", "c", "--output", "o", "--preset", preset])
        assert stage.SIZES[args.preset] == PRESETS[preset].instant_albedo == config
