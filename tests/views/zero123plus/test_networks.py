"""Weights are read from the real on-disk format, whole, or refused by a line that names the part and the remedy."""

import json
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from arm_blender.errors import ArmError, CheckpointError
from arm_blender.views.zero123plus.network_picture import network_picture, preprocessor_config
from arm_blender.views.zero123plus.networks import EXTRA, check_model, load_networks

ROOT = Path(__file__).parents[3]
WEIGHTS = ["unet", "vae", "vision_encoder", "text_encoder"]


def weights_file(folder: Path) -> Path:
    return next(folder.glob("*.safetensors"))


def change_json(path: Path, **values) -> None:
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


def only_line(error: pytest.ExceptionInfo) -> str:
    assert len(str(error.value).splitlines()) == 1
    return str(error.value)


@pytest.mark.parametrize("name", WEIGHTS)
def test_every_weight_is_that_of_its_file(tiny, networks, name):
    stored = load_file(weights_file(tiny / name))
    found = getattr(networks, name).state_dict()
    endings = {key.removeprefix("text_model."): tensor for key, tensor in found.items()}
    for key, tensor in stored.items():
        assert torch.equal(endings[key.removeprefix("text_model.")], tensor), key
    assert not getattr(networks, name).training


def test_the_empty_prompt_is_its_two_ends_and_padding(networks):
    assert networks.empty_prompt.tolist() == [[0, 1, 2, 2, 2, 2, 2]]
    torch.testing.assert_close(networks.ramp, torch.linspace(0.0, 1.0, 7))


def test_the_text_encoder_of_the_published_folder_has_a_prefix(own, networks):
    """Versions of transformers write it with a prefix and without; the published file has it, and old positions."""
    path = weights_file(own / "text_encoder")
    keys = {f"text_model.{key.removeprefix('text_model.')}": tensor for key, tensor in load_file(path).items()}
    keys["text_model.embeddings.position_ids"] = torch.arange(7)[None]
    save_file(keys, path, metadata={"format": "pt"})
    again = load_networks(own, "cpu").text_encoder(networks.empty_prompt)[0]
    assert torch.equal(again, networks.text_encoder(networks.empty_prompt)[0])


def test_the_attention_of_older_vaes_has_other_names(own, networks):
    path = weights_file(own / "vae")
    names = {"to_q": "query", "to_k": "key", "to_v": "value", "to_out.0": "proj_attn"}
    keys = load_file(path)
    for key in [key for key in keys if ".attentions." in key]:
        old = key
        for new_name, old_name in names.items():
            old = old.replace(f".{new_name}.", f".{old_name}.")
        keys[old] = keys.pop(key)
    assert not any(".to_q." in key for key in keys)
    save_file(keys, path, metadata={"format": "pt"})
    again = load_networks(own, "cpu").vae.state_dict()
    assert all(torch.equal(again[key], tensor) for key, tensor in networks.vae.state_dict().items())


def test_a_folder_that_is_not_there_says_what_goes_where(tmp_path):
    with pytest.raises(CheckpointError) as error:
        check_model(tmp_path / "nothing")
    line = only_line(error)
    for word in ("nothing: no such folder", "model_index.json", "unet/", "vision_encoder/", "feature_extractor_*/"):
        assert word in line


PARTS = ["model_index.json", "unet/config.json", "tokenizer/tokenizer_config.json", "scheduler/scheduler_config.json"]
PARTS += ["feature_extractor_vae/preprocessor_config.json", "vae/*.safetensors", "text_encoder/*.safetensors"]


@pytest.mark.parametrize("part", PARTS)
def test_a_part_that_is_missing_is_named(own, part):
    for path in own.glob(part):
        path.unlink()
    with pytest.raises(CheckpointError) as error:
        load_networks(own, "cpu")
    assert part.partition("*")[0].rstrip("/") in only_line(error)


@pytest.mark.parametrize("name", WEIGHTS)
def test_pickled_weights_are_never_read(own, name):
    """The pickle would leave a file behind, if anything read it."""
    path = weights_file(own / name)
    path.unlink()
    trace = own / "was_here"

    class Trap:
        def __reduce__(self):
            return Path.touch, (trace,)

    torch.save({"weight": Trap()}, path.with_suffix(".bin"))
    with pytest.raises(CheckpointError, match=f"{name}: no .*convert them to safetensors"):
        load_networks(own, "cpu")
    assert not trace.exists()


@pytest.mark.parametrize("name", WEIGHTS)
@pytest.mark.parametrize("damage", ["missing", "shape", "truncated"])
def test_weights_that_are_not_whole_are_refused(own, name, damage):
    path = weights_file(own / name)
    tensors = load_file(path)
    key = next(key for key, tensor in tensors.items() if tensor.ndim == 2)
    if damage == "missing":
        del tensors[key]
    else:
        tensors[key] = tensors[key][1:].clone()
    save_file(tensors, path, metadata={"format": "pt"})
    if damage == "truncated":
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(CheckpointError, match=f"{name}: .*copy") as error:
        load_networks(own, "cpu")
    only_line(error)


@pytest.mark.parametrize(
    ("file", "values"),
    [
        ("model_index.json", {"ramping_coefficients": [1.0, 2.0]}),
        ("model_index.json", {"ramping_coefficients": None}),
        ("scheduler/scheduler_config.json", {"prediction_type": "epsilon"}),
        ("scheduler/scheduler_config.json", {"beta_schedule": "squaredcos_cap_v2"}),
        ("feature_extractor_vae/preprocessor_config.json", {"image_mean": None}),
        ("feature_extractor_clip/preprocessor_config.json", {"do_normalize": False}),
    ],
)
def test_another_models_settings_are_refused(own, file, values):
    change_json(own / file, **values)
    with pytest.raises(CheckpointError, match=file) as error:
        load_networks(own, "cpu")
    only_line(error)


@pytest.mark.parametrize("library", ["diffusers", "transformers"])
def test_without_the_extra_the_line_says_how_to_get_it(tiny, monkeypatch, library):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ArmError, match=f"{library}.*pip install") as error:
        check_model(tiny)
    only_line(error)


def test_the_remedy_names_what_the_project_declares():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for package in project["optional-dependencies"]["multiview"]:
        assert f"'{package}'" in EXTRA


def test_reading_leaves_the_libraries_as_talkative_as_they_were(tiny, networks, capfd):
    log = pytest.importorskip("transformers").utils.logging
    before = log.get_verbosity()
    log.set_verbosity_info()
    try:
        load_networks(tiny, "cpu")
        assert log.get_verbosity() == log.INFO
    finally:
        log.set_verbosity(before)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("size", [(24, 24), (37, 37), (50, 31), (20, 44), (9, 9)])
def test_pictures_are_scaled_as_the_encoders_own_processor_does(size):
    transformers = pytest.importorskip("transformers")
    processor = transformers.CLIPImageProcessor(
        size={"shortest_edge": 24}, crop_size=16, image_mean=[0.1, 0.2, 0.3], image_std=[0.8, 0.7, 0.6]
    )
    picture = torch.randint(0, 256, (3, *size), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    expected = processor(images=np.array(picture.permute(1, 2, 0)), return_tensors="pt").pixel_values
    values = json.loads(processor.to_json_string())
    torch.testing.assert_close(network_picture(picture, preprocessor_config(values)), expected, rtol=1e-5, atol=1e-5)


def test_the_image_scaling_is_in_the_encoders_settings():
    """Mean 0.5 and deviation 0.8 of [0, 1] are x * 0.5 / 0.8 of [-1, 1]: the published scaling."""
    config = preprocessor_config({"size": 4, "crop_size": 4, "image_mean": [0.5] * 3, "image_std": [0.8] * 3})
    picture = torch.randint(0, 256, (3, 4, 4), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    expected = (picture / 255.0 * 2.0 - 1.0) * 0.5 / 0.8
    torch.testing.assert_close(network_picture(picture, config), expected[None])
