"""Networks find their weights, stay while they are worth their memory, and run in the precision that was chosen."""

import os
import subprocess
import sys
import weakref
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from arm_blender import networks, pipeline
from arm_blender.config import FEW_VIEWS, PRESETS, QUALITIES, Preset, Settings
from arm_blender.errors import ArmError, CheckpointError, OutOfMemory
from arm_blender.machine.memory import lower_if_short
from arm_blender.machine.precision import chosen, gains_from_bfloat16, running_in
from arm_blender.models.atlas_network import AtlasNetworkConfig
from arm_blender.models.ffc import FfcConfig
from arm_blender.models.image_encoder import ImageEncoderConfig
from arm_blender.models.material_encoder import MaterialEncoderConfig
from arm_blender.models.network_views import network_views
from arm_blender.models.paper.reconstruction import ReconstructionConfig
from arm_blender.models.transformer import TransformerConfig
from arm_blender.models.triplane import DecoderConfig, UpsamplerConfig
from arm_blender.models.unet import UnetConfig
from arm_blender.models.vit import VitConfig
from arm_blender.report import Report
from arm_blender.structures import ViewSet
from arm_blender.views import load_views
from arm_blender.weight_files import checkpoints

EXAMPLE = Path(__file__).parents[1] / "arm_blender" / "examples" / "barrel"
SHAPE = ReconstructionConfig(
    encoder=ImageEncoderConfig(image_size=32, patch_size=8, position_grid=4, width=16, depth=1, heads=2),
    transformer=TransformerConfig(width=16, layers=1, heads=2, grid=8),
    upsampler=UpsamplerConfig(filters=8, blocks=1, growth=4, doublings=2, channels=4),
    decoder=DecoderConfig(hidden_layers=2, hidden=16),
)
COLOR = AtlasNetworkConfig(
    MaterialEncoderConfig(VitConfig(8, 16, 4, 2, 2, 4), (0, 1, 2, 3), 32, 8, 4),
    UnetConfig((8, 8), 8),
    FfcConfig(8, 2, 1),
)
TINY = Settings(preset="paper", texture_size=256, faces=1000, random_weights=0)


@pytest.fixture(autouse=True)
def tiny_paper(monkeypatch):
    """The paper's configuration with every number small; nothing that was kept by another test."""
    monkeypatch.setitem(PRESETS, "paper", Preset(SHAPE, SHAPE, COLOR, grid=32))
    monkeypatch.setattr(networks, "_kept", {})


@pytest.fixture(scope="module")
def views() -> ViewSet:
    return load_views(EXAMPLE)


@pytest.fixture
def files(tmp_path, monkeypatch) -> Path:
    """The tiny networks' weights as files, where the program looks for them."""
    for name in TINY.networks:
        module = networks.load(name, TINY)
        checkpoints.save(tmp_path / f"paper.{name}.safetensors", module.state_dict(), module.config, name)
    monkeypatch.setattr(checkpoints.shipped, "__defaults__", (tmp_path,))
    return tmp_path


def test_random_weights_make_a_whole_asset_that_says_so(views):
    asset, report = pipeline.generate(views, TINY)
    assert asset.name == "barrel-random-weights"
    assert "trained weights" in [note.what for note in report.left_out]
    assert 100 < len(asset.mesh.faces) <= 1000 and report.seen_share > 0.3
    for image in map(asset.maps.image, ("albedo", "baked", "roughness", "metallic")):
        assert bool(image.isfinite().all()) and 0.0 <= float(image.min()) <= float(image.max()) <= 1.0


def test_weights_from_files_are_those_that_were_saved(files):
    for name in TINY.networks:
        drawn, loaded = networks.load(name, TINY), networks.load(name, Settings(preset="paper"))
        assert loaded.state_dict().keys() == drawn.state_dict().keys()
        for (path, tensor), other in zip(loaded.state_dict().items(), drawn.state_dict().values(), strict=True):
            assert torch.equal(tensor, other), path
        # What is no weight is there as well: a network that was built on the meta device runs.
        assert not any(tensor.is_meta for tensor in loaded.buffers())


def test_own_weights_are_taken_by_their_names_and_what_they_lack_from_those_that_ship(files, tmp_path):
    own = tmp_path / "own"
    trained = networks.load("georm", replace(TINY, random_weights=7))
    checkpoints.save(own / "paper.georm.safetensors", trained.state_dict(), trained.config, "paper.georm")
    settings, plain = Settings(preset="paper", weights_folder=own), Settings(preset="paper")
    for name in settings.networks:
        expected = trained if name == "georm" else networks.load(name, plain)
        for one, other in zip(networks.load(name, settings).parameters(), expected.parameters(), strict=True):
            assert torch.equal(one, other), name
    report = Report("paper", "cpu", 0)
    networks.check_weights(settings, report, settings.networks)
    assert report.weights["paper.georm"] == "your own"


def test_weights_that_are_trained_anew_are_read_anew(files):
    settings = Settings(preset="paper")
    first = networks.load("georm", settings)
    trained = networks.load("georm", replace(TINY, random_weights=7))
    path = settings.weights("georm")
    written = path.stat().st_mtime_ns
    checkpoints.save(path, trained.state_dict(), trained.config, "georm")
    os.utime(path, ns=(written, written + 1))  # Clocks of file systems are coarse.
    for one, other in zip(networks.load("georm", settings).parameters(), trained.parameters(), strict=True):
        assert torch.equal(one, other)
    assert networks.load("georm", settings) is not first


def test_the_config_that_a_file_carries_decides_the_class(files):
    for name in TINY.networks:
        configs = [getattr(PRESETS[preset], name) for preset in ("small", "paper")]
        classes = {type(networks.build(name, config)) for config in configs if config is not None}
        assert classes == set(networks.NETWORKS[name].values())
        assert type(networks.read(name, Settings(preset="paper").weights(name))) in classes
    checkpoints.save(files / "mixed.safetensors", {}, PRESETS["small"].finish, "finish")
    with pytest.raises(CheckpointError, match="holds the model 'finish'.* but VolumeGeoRMConfig or Reconstruction"):
        networks.read("georm", files / "mixed.safetensors")


@pytest.mark.parametrize("there", [True, False])
def test_a_folder_without_weights_of_the_preset_is_not_passed_over(tmp_path, there):
    folder = tmp_path / "own"
    if there:
        folder.mkdir()
        (folder / "paper.georm.safetensors").touch()
    match = "own: holds none of small.georm.safetensors, " if there else "own: no such folder; name one that holds"
    with pytest.raises(CheckpointError, match=match):
        networks.check_weights(Settings(weights_folder=folder), Report("small", "cpu", 0), ["georm"])


@pytest.mark.parametrize("large", [False, True])
def test_only_small_networks_are_kept_for_the_next_item(files, monkeypatch, large):
    monkeypatch.setattr(networks, "LARGE", 1 if large else 2**25)
    first = networks.load("georm", Settings(preset="paper"))
    assert (networks.load("georm", Settings(preset="paper")) is first) is not large
    alive = weakref.ref(first)
    del first
    assert (alive() is None) is large


def test_a_network_is_gone_before_the_next_stage(views, monkeypatch):
    """Its memory is free when the mesh is cleaned, and InstantAlbedo's when GlossyRM is read."""
    loaded: list[weakref.ref] = []
    load = networks.load

    def watched(name: str, settings: Settings) -> torch.nn.Module:
        assert not any(other() for other in loaded)
        module = load(name, settings)
        loaded.append(weakref.ref(module))
        return module

    clean = pipeline.clean

    def cleaned(mesh):
        assert loaded[0]() is None
        return clean(mesh)

    monkeypatch.setattr(networks, "load", watched)
    monkeypatch.setattr(pipeline, "clean", cleaned)
    pipeline.generate(views, TINY)
    assert len(loaded) == 3


def test_the_papers_grid_holds_at_every_quality_and_the_users_before_it():
    assert {Settings(preset="paper", quality=quality).resolved.grid for quality in QUALITIES} == {32}
    assert Settings(preset="paper", grid=48).resolved.grid == 48
    assert Settings(quality="draft").resolved.grid == QUALITIES["draft"].grid


@pytest.mark.parametrize("name", [name for name in Settings().networks if name != "finish"])  # It takes no time.
def test_small_networks_stay_in_single_precision_unless_asked(name):
    module = networks.load(name, Settings())
    report = Report("small", "cpu", 0)
    with networks.running(module, Settings(), report, list):
        assert not torch.is_autocast_enabled("cpu")
    assert report.left_out == []
    with networks.running(module, Settings(precision="bfloat16"), report, list):
        assert torch.is_autocast_enabled("cpu")
    assert [note.what for note in report.left_out] == [f"float32 in {type(module).__name__}"]


def test_large_networks_take_what_the_device_multiplies_faster(monkeypatch):
    assert chosen("auto", "cpu", large=True) == (torch.bfloat16 if gains_from_bfloat16("cpu") else torch.float32)
    monkeypatch.setattr("arm_blender.machine.precision.gains_from_bfloat16", lambda device: device == "cuda")
    assert chosen("auto", "cuda", large=True) == torch.bfloat16
    assert chosen("auto", "cpu", large=True) == chosen("float32", "cuda", large=True) == torch.float32
    assert not gains_from_bfloat16("mps")


def test_an_encoding_in_bfloat16_is_close_and_decoded_in_single_precision(views):
    module = networks.load("georm", TINY)
    inputs = network_views(views, module.config)
    planes = []
    with torch.inference_mode():
        for dtype in (torch.float32, torch.bfloat16):
            with running_in(dtype, "cpu"):
                planes.append(module.encode(inputs).float().planes)
    assert planes[1].dtype == torch.float32
    error = float((planes[1] - planes[0]).norm() / planes[0].norm())
    assert 0.0 < error < 0.03  # A rounding is 0.4 %, and there are some ten layers.


def test_spectra_stay_in_single_precision_under_autocast(monkeypatch):
    seen, transform = [], torch.fft.rfft2
    monkeypatch.setattr(torch.fft, "rfft2", lambda x, **words: seen.append(x.dtype) or transform(x, **words))
    module = networks.load("instant_albedo", TINY)
    with torch.inference_mode(), running_in(torch.bfloat16, "cpu"):
        module.ffc(torch.rand(1, 8 + 7, 32, 32))
    assert set(seen) == {torch.float32}


def allocator_error() -> None:
    torch.empty(2**60, dtype=torch.uint8)


def cuda_error() -> None:
    raise torch.cuda.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB")


def python_error() -> None:
    raise MemoryError


@pytest.mark.parametrize("fail", [allocator_error, cuda_error, python_error])
def test_a_lack_of_memory_names_what_to_lower(fail):
    with pytest.raises(OutOfMemory, match="the material: .*lower --texture-size"):
        with lower_if_short("the material", "lower --texture-size"):
            fail()


def test_other_errors_pass_as_they_are():
    for error in (RuntimeError("shapes disagree"), ArmError("cup.png: no foreground")):
        with pytest.raises(type(error)) as found, lower_if_short("the material", "lower --texture-size"):
            raise error
        assert found.value is error


@pytest.mark.parametrize(
    "place, remedy",
    [
        ("normalise", "fewer or smaller"),
        ("networks.load", "GeoRM: .*fewer views"),
        ("extract", "lower --grid"),
        ("unwrap", "lower --faces"),
        ("backproject", "lower --texture-size"),
    ],
)
def test_each_stage_has_its_own_remedy(views, monkeypatch, place, remedy):
    monkeypatch.setattr(f"arm_blender.pipeline.{place}", lambda *_, **__: allocator_error())
    with pytest.raises(OutOfMemory, match=remedy):
        pipeline.generate(views, TINY)


@pytest.mark.parametrize("name", [name for name in Settings().networks if name != "finish"])  # It takes no time.
def test_a_stop_is_heard_between_the_blocks_of_a_network(name):
    """So that nobody waits for a whole pass."""
    module = networks.load(name, Settings())
    with networks.running(module, Settings(), Report("small", "cpu", 0), list):
        hooked = sum(bool(part._forward_pre_hooks) for part in module.modules())
    assert hooked > 10
    assert not any(part._forward_pre_hooks for part in module.modules())


def test_the_report_names_the_licences_of_what_a_run_needs(monkeypatch, tmp_path):
    header = {"name": "instantmesh.georm", "licence": "CC-BY-NC-4.0"}
    own = checkpoints.read_header(Settings().weights("finish"))
    path = tmp_path / "instantmesh.georm.safetensors"
    monkeypatch.setattr(
        checkpoints, "read_header", lambda asked: header if asked == path else own | {"name": "mine.finish"}
    )
    monkeypatch.setattr(Settings, "weights", lambda _, name: path if name == "georm" else Path(name))
    for given, expected in (
        (False, {**{header["name"]: header["licence"]}, "mine.finish": "your own"}),
        (True, {"mine.finish": "your own"}),
    ):
        report = Report("instantmesh", "cpu", 0)
        networks.check_weights(Settings(), report, networks.needed(Settings(), 6, given))
        assert report.weights == expected == report.as_dict()["weights"]


def test_a_run_needs_the_networks_of_its_number_of_views_and_no_others():
    material = {"finish", "instant_albedo"}
    for count in range(1, 17):
        shape = "ray_occupancy" if count <= FEW_VIEWS else "georm"
        assert set(networks.needed(Settings(), count)) == material | {shape}
        assert set(networks.needed(Settings(preset="paper"), count)) == {"georm", "glossyrm", "instant_albedo"}
        assert set(networks.needed(Settings(preset="instantmesh"), count)) == material | {"georm"}
        assert set(networks.needed(Settings(), count, given_shape=True)) == material
    assert set(networks.NETWORKS) == {*Settings().networks, *Settings(preset="paper").networks}


def test_networks_are_built_without_memory_and_without_the_compiler():
    program = """
import sys
from arm_blender.config import PRESETS
from arm_blender.networks import build
from arm_blender.weight_files.unallocated import unallocated
for preset in PRESETS.values():
    with unallocated():
        networks = [build(name, getattr(preset, name)) for name in preset.networks]
    assert all(value.is_meta for network in networks for value in network.parameters())
assert "torch._dynamo" not in sys.modules
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=EXAMPLE.parents[2], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
