"""Weights of others come by a download or from a folder, verified and recorded, and only when the user says so."""

import dataclasses
import functools
import hashlib
import io
import sys

import pytest
import torch

from arm_blender.__main__ import main
from arm_blender.errors import Cancelled, CheckpointError, DownloadError
from arm_blender.models.material_encoder import MaterialEncoderConfig
from arm_blender.models.vit import VisionTransformer, VitConfig
from arm_blender.weight_files import checkpoints
from arm_blender.weight_files import imported as weights_import
from arm_blender.weight_files import install as weights_install

VIT = VitConfig(patch=8, dim=32, depth=2, heads=2, grid=4)
CONFIG = MaterialEncoderConfig(VIT, (0, 0, 1, 1), image_size=32, channels=8, out_channels=4)
NAME = "paper.material_encoder"


@pytest.fixture
def dino(tmp_path, monkeypatch) -> bytes:
    """A tiny DINO as it is published: pickled."""
    convert = functools.partial(weights_import.material_encoder_from_dino, config=CONFIG)
    monkeypatch.setitem(weights_import.KINDS, "material-encoder", (NAME, convert))
    torch.manual_seed(0)
    state = VisionTransformer(VIT).state_dict() | {"norm.weight": torch.rand(32), "norm.bias": torch.rand(32)}
    file = io.BytesIO()
    torch.save(state, file)
    return file.getvalue()


@pytest.fixture
def published(publisher, dino, weights_folder, monkeypatch):
    """The registry, with the publisher of DINO on this machine."""
    file = publisher.published("dino_vitbase8_pretrain.pth", dino, sha256=hashlib.sha256(dino).hexdigest())
    others = [weights for weights in checkpoints.REGISTRY if weights.name != NAME]
    here = dataclasses.replace(checkpoints.registered(NAME), files=(file,))
    monkeypatch.setattr(checkpoints, "REGISTRY", (*others, here))
    return publisher


def test_a_download_is_converted_recorded_and_leaves_nothing_else(published, weights_folder):
    heard = []
    installed = weights_install.download(NAME, lambda fraction, message: heard.append(fraction))
    assert installed.path == weights_folder / f"{NAME}.safetensors" and installed.licence == "Apache-2.0"
    assert checkpoints.condition(NAME) == "whole" and heard == sorted(heard)
    assert checkpoints.load(installed.path, MaterialEncoderConfig)[0] == CONFIG
    names = sorted(path.name for path in weights_folder.iterdir())
    assert names == [f"{NAME}.safetensors", f"{NAME}.safetensors.sha256"]
    weights_install.download(NAME)
    assert published.asked == [None]


def test_a_stopped_download_goes_on(published, dino):
    def stop(fraction, message):
        if fraction > 0.0:
            raise Cancelled("stopped")

    published.breaks = [len(dino) // 2]
    with pytest.raises(Cancelled):
        weights_install.download(NAME, stop)
    assert checkpoints.condition(NAME) == "not installed"
    weights_install.download(NAME)
    assert checkpoints.condition(NAME) == "whole"
    first, second = published.asked
    assert first is None and 0 < int(second.removeprefix("bytes=").removesuffix("-")) <= len(dino) // 2


def test_without_network_the_line_says_what_to_put_where(published, weights_folder):
    published.refusals = [404]
    place = weights_folder / f"{NAME}.safetensors"
    with pytest.raises(DownloadError) as caught:
        weights_install.download(NAME)
    for word in ("dino_vitbase8_pretrain.pth", "weights import", "--as material-encoder", str(place)):
        assert word in str(caught.value)
    assert list(weights_folder.iterdir()) == []


def test_what_is_no_network_is_refused_after_the_download(published):
    published.files["/dino_vitbase8_pretrain.pth"] = b"a page that says sorry"
    with pytest.raises(DownloadError, match="SHA-256"):
        weights_install.download(NAME)
    assert checkpoints.condition(NAME) == "not installed"


def test_what_nobody_publishes_cannot_be_downloaded():
    with pytest.raises(DownloadError, match="paper.georm: nobody publishes.*train it"):
        weights_install.download("paper.georm")
    with pytest.raises(CheckpointError, match="nonsense: no such weights"):
        weights_install.download("nonsense")


@pytest.mark.parametrize("answer", ["", "no", "YES"])
def test_nothing_is_downloaded_before_the_licence_is_accepted(published, monkeypatch, capsys, answer):
    monkeypatch.setattr(sys, "stdin", io.StringIO(answer))
    assert main(["weights", "download", NAME]) == 2  # Nobody to ask.
    assert "--accept-licence" in capsys.readouterr().err and published.asked == []
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    agreed = answer == "YES"
    assert main(["weights", "download", NAME]) == (0 if agreed else 1)
    assert "Apache-2.0" in capsys.readouterr().out and published.asked == [None] * agreed


def test_the_word_on_the_command_line_is_enough(published, weights_folder, capsys):
    assert main(["weights", "download", NAME, "--accept-licence"]) == 0
    said = capsys.readouterr().out
    assert published.address in said and str(weights_folder / f"{NAME}.safetensors") in said
    assert main(["weights", "download", NAME]) == 0  # What is there needs no word.
    assert "whole" in capsys.readouterr().out and len(published.asked) == 1


def test_a_folder_is_imported_offline(dino, weights_folder, tmp_path, matting_model, capsys):
    folder = tmp_path / "stick"
    folder.mkdir()
    (folder / "dino_vitbase8_pretrain.pth").write_bytes(dino)
    (folder / "holiday.jpg").touch()
    matting_model(folder / "u2net.onnx")
    assert main(["weights", "import", str(folder)]) == 0
    assert capsys.readouterr().out.count("Apache-2.0") == 2
    assert {checkpoints.condition(name) for name in (NAME, "matting")} == {"whole"}
    assert (weights_folder / "matting.onnx").read_bytes() == (folder / "u2net.onnx").read_bytes()


def test_what_one_machine_has_installed_serves_another(dino, weights_folder, tmp_path, monkeypatch):
    (tmp_path / "dino.pth").write_bytes(dino)
    list(weights_install.install(tmp_path / "dino.pth", "material-encoder"))
    other = tmp_path / "other"
    other.mkdir()
    for function in (checkpoints.shipped, checkpoints.verify, checkpoints.condition):
        monkeypatch.setattr(function, "__defaults__", (other,))
    (installed,) = weights_install.install(weights_folder)
    assert installed.licence == "Apache-2.0" and checkpoints.condition(NAME) == "whole"
    assert installed.path.read_bytes() == (weights_folder / installed.path.name).read_bytes()
    with (weights_folder / installed.path.name).open("r+b") as file:
        file.seek(-1, io.SEEK_END)
        file.write(b"?")
    with pytest.raises(CheckpointError, match="damaged, or not what its name says"):
        list(weights_install.install(weights_folder))


def test_a_file_is_known_by_its_name_or_by_the_users_word(dino, weights_folder, tmp_path, matting_model, capsys):
    odd = tmp_path / "odd.pth"
    odd.write_bytes(dino)
    assert main(["weights", "import", str(odd)]) == 1
    said = capsys.readouterr().err
    assert "odd.pth" in said and "dino_vitbase8_pretrain.pth" in said and "--as" in said
    assert main(["weights", "import", str(odd.rename(tmp_path / "dino_vitbase8_pretrain.pth"))]) == 0
    assert main(["weights", "import", str(matting_model(tmp_path / "mine.onnx", 1024)), "--as", "matting"]) == 0
    assert "licence of the weights: that of its publisher" in capsys.readouterr().out
    assert {checkpoints.condition(name) for name in (NAME, "matting")} == {"whole"}


def test_a_folder_without_weights_says_what_it_could_hold(weights_folder, tmp_path):
    with pytest.raises(CheckpointError, match="instant_nerf_large.ckpt.*u2net.onnx"):
        list(weights_install.install(tmp_path))


def test_damage_to_an_opaque_file_is_noticed(weights_folder, tmp_path, matting_model):
    with pytest.raises(CheckpointError, match="matting.onnx: no such weights; .*weights download matting"):
        checkpoints.verify("matting")
    list(weights_install.install(matting_model(tmp_path / "m.onnx"), "matting"))
    assert checkpoints.condition("matting") == "whole"
    with (weights_folder / "matting.onnx").open("ab") as file:
        file.write(b"more")
    assert checkpoints.condition("matting") == "damaged"
    with pytest.raises(CheckpointError, match=r"differs from matting\.onnx\.sha256"):
        checkpoints.verify("matting")
    checkpoints.record(weights_folder / "matting.onnx")  # On purpose.
    assert checkpoints.condition("matting") == "whole"


def test_what_was_recorded_with_the_shipped_before_still_counts(weights_folder, tmp_path, matting_model):
    (installed,) = weights_install.install(matting_model(tmp_path / "m.onnx"), "matting")
    beside = weights_folder / "matting.onnx.sha256"
    beside.rename(weights_folder / checkpoints.SUMS)
    assert checkpoints.condition("matting") == "whole"
    (weights_folder / checkpoints.SUMS).write_text("0123  matting.onnx\n", encoding="utf-8")
    assert checkpoints.condition("matting") == "damaged"
    checkpoints.record(installed.path)
    assert checkpoints.condition("matting") == "whole" and beside.is_file()
