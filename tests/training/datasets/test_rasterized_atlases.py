"""Samples and a prior without stored pictures: drawn again they are the same, and networks learn from them."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
import trimesh

from arm_blender import networks
from arm_blender.errors import ArmError, CheckpointError
from arm_blender.graphics.color import srgb_from_linear
from arm_blender.models.ffc import FfcConfig
from arm_blender.models.material_encoder import MaterialEncoderConfig
from arm_blender.models.small.instant_albedo import InstantAlbedo, InstantAlbedoConfig
from arm_blender.models.unet import UnetConfig
from arm_blender.models.vit import VitConfig
from arm_blender.weight_files import checkpoints
from training.datasets.atlas_lookup import AtlasLookup
from training.datasets.atlases import AtlasConfig, sample_arrays
from training.datasets.rasterized_atlases import RasterizedAtlases
from training.rasterized.lights import HEIGHT, WIDTH, lighting
from training.rasterized.materials import Finish, Procedural, random_pattern
from training.rasterized.pictures import Library, random_rig, rig_of
from training.rasterized.textures import LABELS, NOTHING
from training.rendering.camera_rigs import random_views
from training.rendering.shards import save_arrays
from training.stages import instant_albedo, material_prior
from training.stages.instant_albedo_start import Start
from training.studies.ablated_albedo import AblatedConfig, ablated, without
from training.trainer import TrainerConfig

ENCODER = MaterialEncoderConfig(VitConfig(8, 16, 4, 2, 4, 4), (0, 1, 2, 3), 32, 8, 4)
TINY = InstantAlbedoConfig(ENCODER, UnetConfig((8, 8), 8, 2), FfcConfig(8, 2, 1), resolution=32)
NOTHING_STORED = Library([], [])


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Meshes of a cube and of a capsule."""
    root = tmp_path_factory.mktemp("shards")
    shapes = {"cube": trimesh.creation.box((1.1, 1.2, 1.3)), "pill": trimesh.creation.capsule(0.8, 0.5, count=(8, 8))}
    for name, shape in shapes.items():
        (root / name).mkdir()
        arrays = {"vertices": shape.vertices.astype("float32"), "faces": shape.faces.astype("int32")}
        save_arrays(root / name / "mesh.npz", arrays)
    return root


@pytest.fixture(scope="module")
def source(folder, tmp_path_factory) -> RasterizedAtlases:
    meshes = sorted(folder.glob("*/mesh.npz"))
    kept = tmp_path_factory.mktemp("kept") / "shapes"
    return RasterizedAtlases(meshes, kept, NOTHING_STORED, 64, AtlasConfig(size=32, faces=400))


@pytest.fixture(scope="module")
def sample(source):
    return source.draw(torch.Generator().manual_seed(1))


def test_a_sample_is_drawn_again_from_what_is_kept(source, sample):
    """The second time the shape is read, not made; nothing of the pictures was stored."""
    again = replace(source, meshes=list(source.meshes)).draw(torch.Generator().manual_seed(1))
    for name in ("images", "base", "baked", "albedo"):
        assert torch.equal(getattr(sample, name), getattr(again, name))
    assert torch.equal(sample.lookup.texel, again.lookup.texel)
    kinds = {path.name.split(".", 1)[1] for path in source.folder.iterdir()}
    assert kinds == {"32.atlas.npz", "32.surface.npz"}


def test_views_and_atlas_are_of_one_surface(sample):
    """What a view shows, the blend shows at the look-up, wherever the views agree on the light: in the median."""
    shown = srgb_from_linear(sample.lookup.render(sample.base))
    error = (shown - sample.baked).abs().amax(dim=1)[sample.lookup.mask]
    assert len(error) > 2000
    assert error.median() < 0.1


def test_a_mesh_without_an_atlas_is_passed_over(source, tmp_path):
    flat = tmp_path / "flat" / "mesh.npz"
    flat.parent.mkdir()
    save_arrays(flat, {"vertices": torch.zeros(3, 3).numpy(), "faces": torch.tensor([[0, 1, 2]]).int().numpy()})
    alone = replace(source, meshes=[flat], without=set())
    with pytest.raises(ArmError, match="no object that can be unwrapped"):
        alone.draw(torch.Generator().manual_seed(0))
    mixed = replace(source, meshes=[flat, source.meshes[0]], without=set())
    first = [mixed.draw(torch.Generator().manual_seed(seed)).baked for seed in (3, 4)]
    assert mixed.without == {flat}
    assert all(torch.equal(mixed.draw(torch.Generator().manual_seed(3 + k)).baked, first[k]) for k in (1, 0))


def test_instant_albedo_overfits_one_sample(sample):
    """A minute's worth of steps, on one object: both pictures come much closer than the blend does."""
    torch.manual_seed(0)
    model, settings = InstantAlbedo(TINY), instant_albedo.FitConfig(views=4)
    optimizer = torch.optim.Adam(model.parameters(), 5e-3)
    losses = []
    for _ in range(60):
        loss, numbers = instant_albedo.sample_loss(model, sample, settings, torch.Generator().manual_seed(0))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[0] == pytest.approx(numbers["blend"])
    assert losses[-1] < 0.6 * losses[0]


def unseen(sample):
    """Nothing in front of the cameras."""
    empty = AtlasLookup(sample.lookup.texel, 0.0 * sample.lookup.weight, torch.zeros_like(sample.lookup.mask))
    seen = replace(
        sample.seen, visibility=torch.zeros_like(sample.seen.visibility), color=torch.zeros_like(sample.seen.color)
    )
    return replace(sample, images=torch.zeros_like(sample.images), seen=seen, lookup=empty)


@pytest.mark.parametrize("ablation", ["none", "local-unet"])
def test_extreme_inputs_give_finite_gradients(sample, ablation, monkeypatch):
    monkeypatch.setitem(networks.NETWORKS["instant_albedo"], AblatedConfig, ablated)
    torch.manual_seed(0)
    model = networks.build("instant_albedo", without(TINY, ablation))
    for atlas in (unseen(sample), sample):
        loss, _ = instant_albedo.sample_loss(model, atlas, instant_albedo.FitConfig(), torch.Generator().manual_seed(0))
        model.zero_grad()
        loss.backward()
        assert loss.isfinite()
        assert all(p.grad.isfinite().all() for p in model.parameters() if p.grad is not None)


def test_batch_norm_over_one_atlas_stays_finite(sample):
    torch.manual_seed(0)
    model = InstantAlbedo(replace(TINY, ffc=FfcConfig(8, 2, 1, norm="batch")))
    loss, _ = instant_albedo.sample_loss(model, sample, instant_albedo.FitConfig(), torch.Generator().manual_seed(0))
    loss.backward()
    assert loss.isfinite()
    assert all(p.grad.isfinite().all() for p in model.parameters() if p.grad is not None)


@pytest.fixture(scope="module")
def pictures(source):
    """A cube of gold, but for the half that is red rubber, under an even sky."""
    surface, generator = source.shape(source.meshes[0])[1], torch.Generator().manual_seed(2)
    pattern = replace(random_pattern(generator, 1.0, 2.0), axes=torch.eye(3), shift=torch.zeros(3))
    ends = {"metal": (1.0, 0.8, 0.4, 0.2, 1.0), "rubber": (0.3, 0.02, 0.02, 1.0, 0.0)}
    halves = tuple(
        Procedural(LABELS.index(kind), torch.tensor([end, end]), pattern, pattern) for kind, end in ends.items()
    )
    finish = Finish(halves, "bands", pattern, torch.zeros(1, 3))
    sky = lighting(torch.full((3, HEIGHT, WIDTH), 0.7))
    return material_prior.material_sample(rig_of(surface, random_views(32, generator)[:3], finish, sky))


def test_the_prior_overfits_one_object(pictures):
    torch.manual_seed(0)
    model, settings = material_prior.MaterialPrior(ENCODER), material_prior.PriorConfig()
    optimizer = torch.optim.Adam(model.parameters(), 5e-3)
    before = material_prior.prior_loss(model, pictures, settings)[0].item()
    for _ in range(60):
        loss, _ = material_prior.prior_loss(model, pictures, settings)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    found = material_prior.validate(model, [pictures])
    assert loss.item() < 0.4 * before
    assert found["accuracy"] > 0.9
    for name in ("albedo", "roughness", "metallic"):
        assert found[name] < 0.5 * found[f"{name}, best constant"]


def test_the_prior_on_empty_pictures_has_no_gradient(pictures):
    model = material_prior.MaterialPrior(ENCODER)
    nothing = replace(pictures, label=torch.full_like(pictures.label, NOTHING))
    loss, _ = material_prior.prior_loss(model, nothing, material_prior.PriorConfig())
    loss.backward()
    assert loss.item() == 0.0
    assert all((p.grad == 0).all() for p in model.parameters() if p.grad is not None)
    assert material_prior.validate(model, [nothing]) == {}


def test_instant_albedo_begins_with_the_prior(folder, tmp_path):
    """From one command's file to the other's network, in half precision; another size is refused."""
    output, settings = tmp_path / "prior.safetensors", material_prior.PriorConfig(views=1, held_out=2)
    meshes = sorted(folder.glob("*/mesh.npz"))
    scenes = material_prior.Scenes(meshes, tmp_path / "surfaces", NOTHING_STORED)
    encoder = material_prior.fit(ENCODER, scenes, output, TrainerConfig(minutes=1e-9), settings)
    model = Start(TINY, material_prior=output).network()
    for key, value in encoder.state_dict().items():
        assert torch.equal(model.encoder.state_dict()[key], value.half().float())
    assert checkpoints.read_header(output)["labels"].split(", ") == list(LABELS)
    wider = replace(TINY, encoder=replace(ENCODER, channels=12))
    with pytest.raises(CheckpointError, match="prior.safetensors"):
        Start(wider, material_prior=output).network()


def test_a_share_of_the_samples_is_rasterised_and_held_out_objects_are_not(source, tmp_path, monkeypatch):
    """A rasterised rig stands in for a rendered one; of two objects the second is held out, and never drawn."""
    samples, drawn = tmp_path / "cache", []
    samples.mkdir()
    for path in source.meshes:
        mesh, surface = source.shape(path)
        rig = random_rig(surface, NOTHING_STORED, 64, torch.Generator().manual_seed(0))
        save_arrays(
            samples / f"{path.parent.name}.rig_0.npz",
            sample_arrays(mesh, rig, 32, torch.ones(1, 6, dtype=torch.bool), 128),
        )
    draw = RasterizedAtlases.draw
    monkeypatch.setattr(RasterizedAtlases, "draw", lambda self, random: drawn.append(self.meshes) or draw(self, random))
    output, settings = tmp_path / "x.safetensors", instant_albedo.FitConfig(views=2)
    config = TrainerConfig(minutes=1e-9)
    whole = instant_albedo.Samples(samples, held_out=2, rasterized=source, share=1.0)
    instant_albedo.fit(Start(TINY), whole, output, config, settings)
    assert [[path.parent.name for path in meshes] for meshes in drawn] == [["cube"]]
    header = checkpoints.read_header(output)
    assert (header["rasterized_share"], header["material_prior"], header["samples"]) == ("1.0", "random", "1")
    assert checkpoints.load(output, InstantAlbedoConfig)[0] == TINY
