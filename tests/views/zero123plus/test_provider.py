"""From a picture to posed views with the tiny pipeline; and what a stop, another seed, a missing part do to it."""

import json
from dataclasses import replace

import pytest
import torch

from arm_blender.errors import ArmError, Cancelled, CheckpointError, InputImageError
from arm_blender.progress import silent
from arm_blender.views import ViewOptions, load_views
from arm_blender.views.image_io import read_image, write_png
from arm_blender.views.rigs import zero123plus_rig
from arm_blender.views.zero123plus import provider
from arm_blender.views.zero123plus.provider import drawn_views
from arm_blender.views.zero123plus.sampling import Zero123PlusConfig
from arm_blender.views.zero123plus.view_folder import read_seeds


@pytest.fixture
def cup(picture, tmp_path):
    path = tmp_path / "cup.png"
    write_png(path, picture, srgb=True)
    return path


@pytest.fixture
def config(tiny, tmp_path) -> Zero123PlusConfig:
    return Zero123PlusConfig(tiny, tmp_path / "out" / "views", steps=2, side=32)


@pytest.fixture
def on_a_ground(monkeypatch):
    """The random network's views get a plain border: it has never learnt one."""
    real = provider.six_views

    def framed(networks, picture, config, noise, progress):
        views = real(networks, picture, config, noise, progress)
        border = torch.ones(config.side, config.side, dtype=torch.bool)
        border[6:-6, 6:-6] = False
        return torch.where(border, 0.5, views * 0.3)

    monkeypatch.setattr(provider, "six_views", framed)


def options(config: Zero123PlusConfig, **more) -> ViewOptions:
    return ViewOptions(multiview="zero123plus", zero123plus=config, **more)


def test_one_picture_becomes_six_views_in_the_rig(cup, config, on_a_ground):
    heard = []
    views = load_views(cup, options(config, rig_distance=3.5), lambda *report: heard.append(report))
    assert views.name == "cup" and views.images.shape == (6, 4, 32, 32)
    for camera, expected in zip(views.cameras, zero123plus_rig(3.5, 30.0, 32), strict=True):
        torch.testing.assert_close(camera.c2w, expected.c2w)
        torch.testing.assert_close(camera.K, expected.K)
    again = load_views(config.folder)  # The folder alone says as much.
    assert torch.equal(again.images, views.images) and again.name == "views"
    fractions = [fraction for fraction, _ in heard]
    assert fractions == sorted(fractions) and 0.0 <= fractions[0] and fractions[-1] <= 1.0
    messages = list(dict.fromkeys(message for _, message in heard))
    assert [message for message in messages if "step" in message] == [f"Zero123++: step {k} of 2" for k in (1, 2)]


def test_one_view_is_drawn_anew_and_the_others_keep_their_files(cup, config, on_a_ground):
    load_views(cup, options(config))
    before = {path.name: path.read_bytes() for path in config.folder.glob("*.png")}
    load_views(cup, options(replace(config, seed=8, reseed=(2,))))
    changed = {path.name for path in config.folder.glob("*.png") if path.read_bytes() != before[path.name]}
    assert changed == {"2.png"} and read_seeds(config.folder) == (0, 0, 8, 0, 0, 0)
    load_views(cup, options(replace(config, reseed=(2,))))  # Back to where it was.
    assert {path.name: path.read_bytes() for path in config.folder.glob("*.png")} == before


def test_nothing_to_keep_is_said_before_the_weights_are_read(cup, config, monkeypatch):
    monkeypatch.setattr(provider, "load_networks", lambda *_: 1 / 0)
    with pytest.raises(InputImageError, match="views: has no six views.*without --reseed"):
        load_views(cup, options(replace(config, reseed=(2,))))


def test_views_that_cannot_be_cut_out_stay_for_the_user(cup, config):
    """A random network draws no plain background."""
    with pytest.raises(InputImageError, match=r"0\.png: no foreground found"):
        load_views(cup, options(config))
    assert float(read_image(config.folder / "0.png")[3].min()) == 1.0
    assert len(json.loads((config.folder / "transforms.json").read_text())["frames"]) == 6


def test_a_stop_leaves_no_folder_and_no_half_a_view(cup, config):
    def progress(fraction, message):
        if "step 2" in message:
            raise Cancelled("stopped by the user")

    with pytest.raises(Cancelled):
        drawn_views(cup, config, 4.0, None, progress)
    assert not config.folder.parent.exists()


def test_threads_are_the_runs_own_and_the_callers_come_back(cup, config, monkeypatch):
    threads = torch.get_num_threads()
    inside = []
    monkeypatch.setattr(provider, "six_views", lambda *_: inside.append(torch.get_num_threads()) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        drawn_views(cup, replace(config, threads=3), 4.0, None, silent)
    assert inside == [3] and torch.get_num_threads() == threads


def test_missing_weights_are_named_with_the_remedy(cup, config, tmp_path):
    with pytest.raises(CheckpointError, match="gone: no such folder; put the weights"):
        load_views(cup, options(replace(config, model=tmp_path / "gone")))
    with pytest.raises(ArmError, match="--multiview zero123plus: no weights.*--multiview-model"):
        ViewOptions(multiview="zero123plus")
    with pytest.raises(ArmError, match="--multiview magic: unknown; choose one of none, zero123plus"):
        ViewOptions(multiview="magic")
