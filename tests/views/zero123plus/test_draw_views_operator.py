"""From the panel's one picture to six views beside it, through the operator, with the tiny pipeline."""

from functools import partial

import pytest
import torch

import arm_blender
from arm_blender.views.image_io import write_png
from arm_blender.views.zero123plus import provider, sampling

bpy = pytest.importorskip("bpy")

pytestmark = pytest.mark.blender


@pytest.fixture
def panel(picture, tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    arm_blender.register()
    write_png(tmp_path / "cup.png", picture, srgb=True)
    settings = bpy.context.scene.arm
    settings.views_path, settings.multiview_steps, settings.seed = str(tmp_path / "cup.png"), 2, 3
    yield settings
    arm_blender.unregister()


@pytest.fixture
def small_views(monkeypatch):
    """Views of 32 pixels, with the plain border that a random network has never learnt."""
    real = provider.six_views

    def framed(networks, picture, config, noise, progress):
        border = torch.ones(config.side, config.side, dtype=torch.bool)
        border[6:-6, 6:-6] = False
        return torch.where(border, 0.5, real(networks, picture, config, noise, progress) * 0.3)

    monkeypatch.setattr(provider, "six_views", framed)
    monkeypatch.setattr(sampling, "Zero123PlusConfig", partial(sampling.Zero123PlusConfig, side=32))


def test_six_views_are_drawn_beside_the_picture_and_chosen(panel, tiny, small_views, tmp_path):
    panel.multiview_model = str(tiny)
    assert bpy.ops.arm.draw_views() == {"FINISHED"}
    folder = tmp_path / "cup-views"
    assert panel.views_path == str(folder) and len(list(folder.glob("*.png"))) == 6
    assert bpy.ops.arm.look() == {"FINISHED"}
    assert panel.views_kind == "posed" and len(panel.views) == 6


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("views_path", "", "Choose pictures first"),
        ("views_path", ".", "Choose one picture first"),
        ("multiview_model", "", "Choose the folder of Zero123\\+\\+'s weights"),
        ("multiview_model", "gone", "gone"),
    ],
)
def test_what_is_missing_is_one_line_and_nothing_is_written(panel, tmp_path, name, value, match):
    panel.multiview_model = str(tmp_path)
    setattr(panel, name, str(tmp_path / value) if value else "")
    with pytest.raises(RuntimeError, match=match):
        bpy.ops.arm.draw_views()
    assert [path.name for path in tmp_path.iterdir()] == ["cup.png"]
    assert "\n" not in bpy.context.window_manager.arm.error
