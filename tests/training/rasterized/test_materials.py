"""Materials in space and the files that they and the light come from."""

import json
from dataclasses import replace

import numpy as np
import OpenImageIO as oiio
import pytest
import torch
from PIL import Image

from arm_blender.errors import ArmError
from training.rasterized.lights import HEIGHT, WIDTH, lighting, mirrored, random_sky, studio
from training.rasterized.materials import Finish, Pattern, Projected, random_finish, random_pattern, random_substance
from training.rasterized.pictures import read_library
from training.rasterized.textures import LABELS, TEXELS, TextureSet
from training.rendering.metals import METALS

KINDS = [kind for kind in LABELS if kind != "other"]


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def points(count: int = 2000) -> tuple[torch.Tensor, torch.Tensor]:
    places, normals = torch.randn(2, count, 3, generator=seeded(9))
    return 0.6 * places, torch.nn.functional.normalize(normals, dim=1)


@pytest.mark.parametrize("kind", ["noise", "waves", "checks"])
def test_a_hard_pattern_has_borders_and_a_soft_one_none(kind):
    pattern: Pattern = replace(random_pattern(seeded(), 1.0, 2.0), kind=kind)
    place = torch.linspace(-1.0, 1.0, 4000)[:, None] * torch.tensor([[0.5, 0.6, 0.7]])
    hard = replace(pattern, hard=True)(place)
    soft = replace(pattern, hard=False)(place)
    assert set(hard.unique().tolist()) <= {0.0, 1.0} and len(hard.unique()) == 2
    assert soft.diff(dim=0).abs().max() < 0.05
    assert soft.min() >= 0.0 and soft.max() <= 1.0


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_substances_have_values_that_exist(kind, seed):
    substance = random_substance(kind, seeded(seed))
    values = substance(*points())
    assert values.isfinite().all() and values.min() >= 0.0 and values.max() <= 1.0
    assert (values[:, 4] == (1.0 if kind == "metal" else 0.0)).all()
    if kind == "metal":  # A measured colour, or a darker shade of it.
        ratio = values[:, None, :3] / torch.tensor(METALS)
        assert ((ratio.amax(dim=2) - ratio.amin(dim=2)).amin(dim=1) < 1e-4).all()
        assert ratio.amax(dim=2).amin() > 0.7


def test_roughness_reaches_exactly_0_and_1():
    """Over many substances the ends of the range occur closely, so that no network is spared them."""
    found = [random_substance(kind, seeded(seed)).ends[:, 3] for kind in KINDS for seed in range(60)]
    roughness = torch.cat(found)
    assert roughness.min() < 0.01 and roughness.max() > 0.99


@pytest.mark.parametrize("division", ["parts", "bands", "cells", "wear"])
def test_every_point_has_one_material_and_its_label(division):
    materials = tuple(random_substance(kind, seeded()) for kind in ("metal", "fabric"))
    pattern = replace(random_pattern(seeded(), 1.0, 2.0), hard=True)
    finish = Finish(materials, division, pattern, torch.randn(6, 3, generator=seeded()))
    places, normals = points()
    part = torch.arange(len(places)) % 3
    values, label = finish(places, normals, part)
    assert {LABELS[k] for k in label.unique()} == {"metal", "fabric"}
    assert torch.equal(values[:, 4] == 1.0, label == LABELS.index("metal"))
    if division == "parts":
        assert torch.equal(label == LABELS.index("fabric"), part == 1)


def test_textures_repeat_and_follow_the_axis_that_a_surface_faces():
    maps = torch.rand(5, TEXELS, TEXELS, generator=seeded())
    material = Projected(TextureSet(0, maps), 1.0, torch.zeros(3), torch.ones(3))
    places = torch.rand(50, 3, generator=seeded(1))
    up, aside = torch.tensor([0.0, 0.1, 1.0]).expand(50, 3), torch.tensor([-1.0, 0.0, 0.0]).expand(50, 3)
    torch.testing.assert_close(
        material(places, up), material(places + torch.tensor([1.0, 2.0, 0.3]), up), atol=2e-3, rtol=0.0
    )
    assert not torch.allclose(material(places, up), material(places, aside), atol=0.1)


@pytest.fixture
def data(tmp_path):
    """A manifest with two texture sets and two environments, of which one is for evaluation."""
    (tmp_path / "t").mkdir()
    for name, value in (("color", (200, 100, 50)), ("rough", (64, 64, 64)), ("arm", (10, 128, 255))):
        Image.fromarray(np.full((8, 8, 3), value, np.uint8)).save(tmp_path / "t" / f"{name}.png")
    sky = np.ones((8, 16, 3), np.float32)
    for name in ("train", "eval"):
        pixels = oiio.ImageBuf(oiio.ImageSpec(16, 8, 3, oiio.FLOAT))
        pixels.set_pixels(pixels.roi, 3.0 * sky)
        assert pixels.write(str(tmp_path / f"{name}.exr"))
    textures = [
        {"id": "acg_wood07", "maps": {"basecolor": "t/color.png", "roughness": "t/rough.png"}},
        {"id": "ph_thing", "maps": {"basecolor": "t/color.png", "arm": "t/arm.png"}},
    ]
    hdris = [{"files": [f"{name}.exr"], "split": name} for name in ("train", "eval")]
    (tmp_path / "manifest.json").write_text(json.dumps({"objects": [], "textures": textures, "hdris": hdris}))
    return tmp_path


def test_a_manifest_s_materials_and_light_are_read(data):
    library = read_library(data)
    wood, thing = library.textures
    assert (LABELS[wood.label], LABELS[thing.label]) == ("wood", "other")
    assert wood.maps.mean(dim=(1, 2)).tolist() == pytest.approx([0.578, 0.127, 0.032, 64 / 255, 0.0], abs=1e-3)
    assert thing.maps[3:].mean(dim=(1, 2)).tolist() == pytest.approx([128 / 255, 1.0], abs=1e-3)
    (sky,) = library.environments
    assert sky.shape == (3, HEIGHT, WIDTH)
    assert (sky - 1.0).abs().max() < 1e-3
    finish = random_finish(library.textures, seeded(1))
    assert 1 <= len(finish.materials) <= 4


@pytest.mark.parametrize("broken", ["t/rough.png", "train.exr"])
def test_a_broken_file_is_named(data, broken):
    (data / broken).write_bytes(b"no picture")
    with pytest.raises(ArmError, match=broken.split("/")[-1]):
        read_library(data)


def test_a_rough_mirror_sees_the_mean_of_its_surroundings_and_a_smooth_one_what_is_there():
    """A half sky: straight up and straight down even a matt lobe sees one half alone, sideways it sees half of it."""
    radiance = torch.zeros(3, HEIGHT, WIDTH)
    radiance[:, : HEIGHT // 2] = 1.0
    levels = lighting(radiance).levels
    up, down, aside = torch.eye(3)[2:], -torch.eye(3)[2:], torch.eye(3)[:1]
    for roughness in (0.0, 0.3, 1.0):
        rough = torch.tensor([[roughness]])
        assert mirrored(levels, up, rough).min() > 0.97
        assert mirrored(levels, down, rough).max() < 0.03
        assert mirrored(levels, aside, rough)[0, 0] == pytest.approx(0.5, abs=0.03)


def test_made_light_is_positive_and_of_mean_1():
    for seed in range(8):
        radiance = studio(seeded(seed))
        assert radiance.isfinite().all() and radiance.min() >= 0.0
        area = (torch.arange(HEIGHT + 1) / HEIGHT * torch.pi).cos().diff().neg()
        mean = (radiance.mean(dim=2) * area / 2.0).sum(dim=1) @ torch.tensor([0.2126, 0.7152, 0.0722])
        assert float(mean) == pytest.approx(1.0, rel=1e-3)
        assert random_sky([], seeded(seed))[0].shape == (3, HEIGHT, WIDTH)
