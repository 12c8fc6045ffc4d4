"""One object through the evaluation, with a pipeline whose answer is known; nothing is lit, so no Blender is needed."""

import numpy as np
import pytest
import torch
import trimesh

from arm_blender import pipeline
from arm_blender.config import Settings
from arm_blender.errors import EmptyMeshError
from arm_blender.graphics.color import linear_from_srgb, srgb_from_linear
from arm_blender.report import Report
from arm_blender.structures import MaterialMaps, RelightableAsset, TriangleMesh
from arm_blender.uv.unwrap import UnwrapConfig, unwrap
from arm_blender.views import ViewOptions
from arm_blender.views.image_io import write_png
from arm_blender.views.transforms_json import write_transforms
from training.evaluation import contact_sheet, sheets
from training.evaluation.alignment import AlignmentConfig
from training.evaluation.asset_pictures import map_pictures
from training.evaluation.geometry import FAILED
from training.evaluation.image_scores import MISSED, PSNR_CAP
from training.evaluation.measure import BLEND, HULL, ONE_VIEW, OURS, PICTURE, PROVIDER, SCALED, measure
from training.evaluation.objects import EvaluationObject
from training.evaluation.protocol import EvaluationEntry, Protocol
from training.evaluation.trial import Trial
from training.evaluation.truth import FRONT, Truth

PROTOCOL = Protocol(resolution=64, views=4)
SETTINGS = Settings(grid=32, faces=1000, texture_size=256)


@pytest.fixture(scope="module")
def asset() -> RelightableAsset:
    """A ball whose colours, roughness and metallic change over it."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.9)
    mesh = TriangleMesh(torch.tensor(np.asarray(ball.vertices), dtype=torch.float32), torch.tensor(ball.faces.copy()))
    unwrapped, _ = unwrap(mesh, UnwrapConfig(256, time_limit=0.0))
    ramp = torch.linspace(0.1, 0.6, 64).expand(1, 64, 64)
    color = torch.cat([ramp, ramp.flip(2), 0.5 * ramp])
    return RelightableAsset("ball", unwrapped, MaterialMaps(color, color, ramp + 0.2, ramp))


@pytest.fixture
def scene(asset, tmp_path):
    """Entry, views as files and truth of the ball, which glows in its own colour."""
    for folder, cameras in ((tmp_path, PROTOCOL.inputs()), (tmp_path / FRONT, (PROTOCOL.front(),))):
        folder.mkdir(exist_ok=True)
        shown = map_pictures(asset, cameras)
        names = [f"{k:03d}.png" for k in range(len(cameras))]
        for name, color, alpha in zip(names, shown.albedo, shown.alpha, strict=True):
            write_png(folder / name, torch.cat([linear_from_srgb(color), alpha]), srgb=True)
        write_transforms(folder / "transforms.json", names, cameras)
    np.savez(tmp_path / "mesh.npz", vertices=asset.mesh.vertices.numpy(), faces=asset.mesh.faces.numpy())
    truth = Truth(map_pictures(asset, PROTOCOL.tests()), map_pictures(asset, (PROTOCOL.front(),)), tmp_path, tmp_path)
    return EvaluationEntry("ball", tmp_path / "ball.glb", "pbr"), EvaluationObject("ball", tmp_path), truth


def answer(monkeypatch, asset: RelightableAsset) -> None:
    monkeypatch.setattr(pipeline, "generate", lambda views, settings, mesh=None: (asset, Report("small", "cpu", 0)))


def trial(**changes) -> Trial:
    alignment = AlignmentConfig(scales=(0.7, 1.0, 1.4), points=300, refined=2, rounds=10)
    return Trial(SETTINGS, PROTOCOL, points=5_000, alignment=alignment, cycles=False, **changes)


def test_the_truth_scores_its_bounds(scene, asset, monkeypatch):
    answer(monkeypatch, asset)
    result, shown = measure(*scene, trial(one_view=False))
    ours = result.systems[OURS]
    assert ours.geometry.f_coarse == ours.aligned.f_coarse == ours.overlap == 1.0
    assert {scores.psnr_in for scores in ours.maps.values()} == {PSNR_CAP}
    assert ours.maps["albedo"].ssim == pytest.approx(1.0)
    assert "lit" not in ours.maps  # Nothing was rendered by Cycles.
    # The views are unlit colours: blending them finds the albedo, as far as pixels tell, and so does the hull.
    assert result.systems[BLEND].maps["albedo"].psnr_in > 25.0
    assert result.systems[HULL].maps["albedo"].psnr_in > 20.0
    assert result.systems[HULL].geometry.chamfer > ours.geometry.chamfer
    assert [len(result.moments[name]) for name in ("roughness", "metallic")] == [4, 4]
    assert sheets.object_sheet(shown).width == 6 * contact_sheet.TILE


def test_a_darker_albedo_is_wrong_but_for_its_scale(scene, asset, monkeypatch):
    maps = asset.maps
    darker = MaterialMaps(0.5 * maps.albedo, maps.baked, maps.roughness, maps.metallic)
    answer(monkeypatch, RelightableAsset("ball", asset.mesh, darker))
    result, _ = measure(*scene, trial(one_view=False))
    found = result.systems[OURS].maps
    assert found[SCALED].psnr_in > 40.0
    error = (srgb_from_linear(maps.albedo) - srgb_from_linear(0.5 * maps.albedo)).square().mean()
    assert found["albedo"].psnr_in == pytest.approx(float(-10.0 * torch.log10(error)), abs=1.5)


def test_what_finds_no_surface_scores_nothing_and_the_hull_still_counts(scene, monkeypatch):
    def nothing(views, settings, mesh=None):
        raise EmptyMeshError("no surface")

    monkeypatch.setattr(pipeline, "generate", nothing)
    result, shown = measure(*scene, trial(others={"ablation": SETTINGS}))
    for name in (OURS, "ablation", ONE_VIEW):
        assert result.systems[name].geometry == FAILED
        assert set(result.systems[name].maps.values()) == {MISSED}
    assert result.systems[PICTURE].aligned == FAILED and result.systems[PICTURE].geometry is None
    assert result.systems[HULL].geometry.f_coarse > 0.95 and result.moments == {}
    assert sheets.object_sheet(shown).size[0] > 0  # Gaps where nothing came out.


def test_single_views_and_a_provider_are_tried_where_they_are_asked_for(scene, asset, monkeypatch):
    turned = asset.mesh.moved(lambda v: 0.5 * torch.stack([-v[:, 1], v[:, 0], v[:, 2]], dim=1) + 3.0)
    answer(monkeypatch, RelightableAsset("ball", turned, asset.maps))
    result, _ = measure(*scene, trial(provider=lambda name: ViewOptions()))
    for name in (PICTURE, PROVIDER):  # Their frame is unknown: aligned, a moved copy is the truth.
        assert result.systems[name].geometry is None
        assert result.systems[name].aligned.f_coarse == 1.0
        assert result.systems[name].overlap > 0.95
    assert result.systems[ONE_VIEW].geometry.f_coarse == 0.0  # Its frame is known: elsewhere is wrong.
