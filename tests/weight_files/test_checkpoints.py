"""A checkpoint comes back as it was saved, or is refused with a line that names the file and the remedy."""

import hashlib
import json
import struct
from dataclasses import dataclass, make_dataclass, replace
from typing import ClassVar, Literal

import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from arm_blender.errors import CheckpointError
from arm_blender.machine.config_json import config_from_dict
from arm_blender.weight_files import checkpoints


@dataclass(frozen=True)
class InnerConfig:
    widths: tuple[int, ...] = (4, 8)
    pair: tuple[float, str] = (0.5, "a")


@dataclass(frozen=True)
class OuterConfig:
    inner: InnerConfig
    stages: tuple[InnerConfig, ...] = ()
    norm: Literal["batch", "group"] = "group"
    limit: int | None = None
    scale: float = 1.0
    bias: bool = True


@dataclass(frozen=True)
class OtherConfig:
    inner: InnerConfig


CONFIG = OuterConfig(InnerConfig((1, 2, 3)), (InnerConfig(), InnerConfig(pair=(0.1, "b"))), "batch", 7, 2.0, False)


def module() -> nn.Module:
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(3, 5), nn.BatchNorm1d(5))


@pytest.fixture
def path(tmp_path):
    target = tmp_path / "deep" / "model.safetensors"
    checkpoints.save(target, module().state_dict(), CONFIG, "test", {"data": "none"})
    return target


def test_config_and_weights_come_back_equal(path):
    config, state = checkpoints.load(path, OuterConfig)
    assert config == CONFIG
    assert {type(config.inner), type(config.stages[1])} == {InnerConfig}
    expected = module().state_dict()
    assert state.keys() == expected.keys()
    assert all(torch.equal(state[key], expected[key]) for key in expected)
    assert checkpoints.read_header(path)["data"] == "none"


def test_tensors_that_share_memory_come_back_each_by_itself(path):
    whole = torch.arange(12.0).reshape(4, 3)
    state = {"whole": whole, "tied": whole, "rows": whole[1:3], "turned": whole.T}
    checkpoints.save(path, state, CONFIG, "test")
    _, found = checkpoints.load(path, OuterConfig)
    assert all(torch.equal(found[key], state[key]) for key in state)
    checkpoints.save(path, {"rows": whole[1:3], "last": whole[3:]}, CONFIG, "test")
    assert torch.equal(checkpoints.load(path, OuterConfig)[1]["rows"], whole[1:3])


def test_half_precision_rounds_once_and_loads_as_float32(path):
    checkpoints.save(path, module().state_dict(), CONFIG, "test", half=True)
    _, state = checkpoints.load(path, OuterConfig)
    weight = module().state_dict()["0.weight"]
    assert state["0.weight"].dtype == torch.float32
    assert torch.equal(state["0.weight"], weight.half().float())
    assert state["1.num_batches_tracked"].dtype == torch.int64


def test_value_beyond_half_precision_is_refused_and_the_old_file_stays(path):
    before = path.read_bytes()
    with pytest.raises(ValueError, match="weight"):
        checkpoints.save(path, {"weight": torch.tensor([1e6])}, CONFIG, "test", half=True)
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_default_fills_a_field_that_the_file_does_not_know():
    assert config_from_dict(OuterConfig, {"inner": {}}) == OuterConfig(InnerConfig())


@pytest.mark.parametrize(
    "values",
    [
        {"inner": {}, "unheard": 1},
        {"inner": {"unheard": 1}},
        {"inner": {"widths": ["x"]}},
        {"inner": {"pair": [0.5]}},
        {"inner": {}, "norm": "layer"},
        {"inner": {}, "bias": 1},
        {"inner": 3},
    ],
)
def test_unknown_key_or_unfit_value_is_refused(values):
    with pytest.raises(ValueError):
        config_from_dict(OuterConfig, values)


def test_a_retired_field_is_known_by_the_value_that_it_stands_for():
    """Weights from before load as what they were; other choices of the field are no longer there."""

    @dataclass(frozen=True)
    class Fewer(InnerConfig):
        RETIRED: ClassVar = {"residual": True}

    assert config_from_dict(Fewer, {"residual": True}) == Fewer()
    with pytest.raises(ValueError, match="residual"):
        config_from_dict(Fewer, {"residual": False})


def test_missing_file_names_itself_and_its_remedy(tmp_path):
    with pytest.raises(CheckpointError, match=r"paper\.georm\.safetensors: no such weights.*--preset small"):
        checkpoints.load(checkpoints.shipped("paper.georm", tmp_path), OuterConfig)


@pytest.mark.parametrize("keep", [0, 4, 100, -3])
def test_truncated_file_is_damaged(path, keep):
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(CheckpointError, match=r"model\.safetensors: damaged"):
        checkpoints.load(path, OuterConfig)


def test_other_model_and_foreign_file_are_refused(path, tmp_path):
    with pytest.raises(CheckpointError, match="OtherConfig is needed"):
        checkpoints.load(path, OtherConfig)
    foreign = tmp_path / "foreign.safetensors"
    save_file({"weight": torch.zeros(1)}, foreign)
    with pytest.raises(CheckpointError, match="not a checkpoint of this program"):
        checkpoints.load(foreign, OuterConfig)


def test_config_of_another_version_is_refused(path):
    shrunk = make_dataclass("OuterConfig", [("scale", float, 1.0)], frozen=True)
    with pytest.raises(CheckpointError, match="unknown config key"):
        checkpoints.load(path, shrunk)


def test_a_network_built_without_memory_takes_the_tensors_themselves(path):
    _, state = checkpoints.load(path, OuterConfig)
    with torch.device("meta"):
        target = nn.Sequential(nn.Linear(3, 5), nn.BatchNorm1d(5))
    checkpoints.restore(target, state, path)
    for key, tensor in target.state_dict().items():
        assert tensor.data_ptr() == state[key].data_ptr(), key


def test_restore_takes_every_key_or_none(path):
    _, state = checkpoints.load(path, OuterConfig)
    target = nn.Sequential(nn.Linear(3, 5), nn.BatchNorm1d(5))
    checkpoints.restore(target, state, path)
    assert torch.equal(target[0].weight, module()[0].weight)
    with pytest.raises(CheckpointError, match="extra belongs nowhere"):
        checkpoints.restore(target, state | {"extra": torch.zeros(1)}, path)
    with pytest.raises(CheckpointError, match=r"0\.bias is missing"):
        checkpoints.restore(target, {k: v for k, v in state.items() if k != "0.bias"}, path)
    with pytest.raises(CheckpointError, match=r"0\.bias is \(4,\) instead of \(5,\)"):
        checkpoints.restore(target, state | {"0.bias": torch.zeros(4)}, path)


def test_verify_notices_a_changed_file(tmp_path):
    path = checkpoints.shipped("small.georm", tmp_path)
    checkpoints.save(path, module().state_dict(), CONFIG, "georm")
    with pytest.raises(CheckpointError, match="is not in SHA256SUMS"):
        checkpoints.verify("small.georm", tmp_path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    (tmp_path / checkpoints.SUMS).write_text(f"{digest}  {path.name}\n")
    assert checkpoints.verify("small.georm", tmp_path) == digest
    checkpoints.save(path, module().state_dict(), replace(CONFIG, scale=3.0), "georm")
    with pytest.raises(CheckpointError, match="differs from SHA256SUMS"):
        checkpoints.verify("small.georm", tmp_path)


@pytest.mark.parametrize("text", ["", "garbage\n", "garbage\n\0\xff"])
def test_verify_survives_a_damaged_list_of_hashes(tmp_path, text):
    path = checkpoints.shipped("small.georm", tmp_path)
    checkpoints.save(path, module().state_dict(), CONFIG, "georm")
    (tmp_path / checkpoints.SUMS).write_bytes(text.encode("latin-1"))
    with pytest.raises(CheckpointError, match=checkpoints.SUMS):
        checkpoints.verify("small.georm", tmp_path)


def test_a_list_of_hashes_made_by_sha256sum_will_do(tmp_path):
    path = checkpoints.shipped("small.georm", tmp_path)
    checkpoints.save(path, module().state_dict(), CONFIG, "georm")
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    for mark in (" ", "*"):  # Text and binary mode.
        (tmp_path / checkpoints.SUMS).write_text(f"{digest} {mark}{path.name}\n")
        assert checkpoints.verify("small.georm", tmp_path) == digest


def test_weights_that_are_no_numbers_are_damaged(path):
    checkpoints.save(path, {"weight": torch.ones(64)}, CONFIG, "georm")
    stored = path.read_bytes()
    path.write_bytes(stored[:-4] + b"\xff" * 4)  # The last float32 becomes a NaN.
    with pytest.raises(CheckpointError, match="weight is not finite"):
        checkpoints.load(path, OuterConfig)


def test_only_registered_names_resolve():
    assert checkpoints.shipped("small.georm").name == "small.georm.safetensors"
    with pytest.raises(CheckpointError, match="weights list"):
        checkpoints.shipped("huge.georm")


def written(path, kind: str, size: int, config: str) -> None:
    """A file of safetensors with one tensor of four values."""
    metadata = {"format": checkpoints.FORMAT, "name": "a", "type": "InnerConfig", "config": config}
    header = json.dumps(
        {"__metadata__": metadata, "a": {"dtype": kind, "shape": [4], "data_offsets": [0, size]}}
    ).encode()
    path.write_bytes(struct.pack("<Q", len(header)) + header + bytes(size))


@pytest.mark.parametrize(
    ("kind", "size", "config", "says"),
    [
        ("F8_E4M3", 4, "{}", "of type F8_E4M3; store it as F32"),
        ("F6_E2M3", 3, "{}", "F6_E2M3"),
        ("F4", 2, "{}", "x.safetensors"),
        ("C64", 32, "{}", "x.safetensors"),
        ("F32", 16, "[" * 100_000, "another version"),
        ("F32", 16, '{"pair": [1' + "0" * 400 + ', "a"]}', "config key pair"),
        ("F32", 16, '{"pair": [1' + "0" * 5000 + ', "a"]}', "another version"),
    ],
)
def test_types_and_configs_that_are_not_ours_are_refused_by_name(tmp_path, kind, size, config, says):
    written(tmp_path / "x.safetensors", kind, size, config)
    with pytest.raises(CheckpointError, match=says) as caught:
        checkpoints.load(tmp_path / "x.safetensors", InnerConfig)
    assert "x.safetensors" in str(caught.value) and len(str(caught.value)) < 2000


def test_an_integer_stands_for_a_number_with_a_point(tmp_path):
    written(tmp_path / "x.safetensors", "F32", 16, '{"pair": [3, "a"]}')
    assert checkpoints.load(tmp_path / "x.safetensors", InnerConfig)[0].pair == (3.0, "a")
