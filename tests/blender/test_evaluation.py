"""The evaluation's truth and its assets, rendered by Cycles: what is the truth scores as the truth."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import OpenImageIO as oiio
import pytest
import torch

bpy = pytest.importorskip("bpy")

from arm_blender.export.gltf import write_glb  # noqa: E402
from arm_blender.structures import RelightableAsset, TriangleMesh  # noqa: E402
from training.__main__ import main  # noqa: E402
from training.evaluation import evaluate  # noqa: E402
from training.evaluation.scores.image_scores import compare_pictures, mask_overlap  # noqa: E402
from training.evaluation.scores.relighting import under_lights  # noqa: E402
from training.evaluation.trials.asset_pictures import map_pictures, vertex_pictures  # noqa: E402
from training.evaluation.trials.asset_render_blender import asset_lights, colored_lights  # noqa: E402
from training.evaluation.trials.baselines import ColoredMesh  # noqa: E402
from training.evaluation.truth import truth_blender  # noqa: E402
from training.evaluation.truth.objects import EvaluationObject  # noqa: E402
from training.evaluation.truth.protocol import EvaluationEntry, Protocol  # noqa: E402
from training.evaluation.truth.truth import is_whole, read_truth  # noqa: E402

pytestmark = [pytest.mark.blender, pytest.mark.usefixtures("empty_file")]

TINY = Protocol(resolution=64, samples=16, asset_samples=16, views=4)
WORDS = ["--resolution", "64", "--samples", "16", "--test-views", "4"]


def sky(path, low: float, high: float) -> None:
    """An environment that grows brighter to one side."""
    ramp = np.linspace(low, high, 16, dtype=np.float32)[None, :, None].repeat(8, 0).repeat(3, 2)
    pixels = oiio.ImageBuf(oiio.ImageSpec(16, 8, 3, oiio.FLOAT))
    pixels.set_pixels(pixels.roi, np.ascontiguousarray(ramp))
    pixels.write(str(path))


@pytest.fixture
def asset(make_mesh, make_plain_maps) -> RelightableAsset:
    return RelightableAsset("ring", make_mesh(48, 24), make_plain_maps((0.6, 0.25, 0.1), 0.4, 0.0))


@pytest.fixture
def data(tmp_path, asset):
    """A data folder with one object, whose longest side is 2 as it is, and an environment for each split."""
    write_glb(asset, tmp_path / "ring.glb")
    sky(tmp_path / "day.exr", 0.2, 2.0)
    sky(tmp_path / "night.exr", 1.0, 0.0)
    entry = {"id": "ring", "set": "pbr", "split": "eval", "main": "ring.glb", "attribution": "us", "licence": "CC0-1.0"}
    hdris = [{"files": ["day.exr"], "split": "train"}, {"files": ["night.exr"], "split": "eval"}]
    (tmp_path / "manifest.json").write_text(json.dumps({"objects": [entry], "hdris": hdris}))
    return tmp_path


def render(data, kind: str = "pbr", protocol: Protocol = TINY):
    entry, cache = EvaluationEntry("ring", data / "ring.glb", kind), data / "cache"
    lights = {"train": [data / "day.exr"], "eval": [data / "night.exr"]}
    truth_blender.render_missing([entry], cache, data, lights, protocol)
    return read_truth(EvaluationObject("ring", cache / "ring"), data, protocol)


def test_an_asset_that_is_the_truth_shows_the_truth(data, asset):
    """Our rasteriser against the AOVs of Cycles, and Cycles against itself by way of a GLB."""
    truth = render(data)
    tests = truth.tests
    found = map_pictures(asset, tests.cameras)
    # Sixteen random rays through a pixel of the outline are not the four that the rasteriser takes.
    assert mask_overlap(found.alpha, tests.alpha) > 0.95
    assert found.alpha.sum(dim=(1, 2, 3)) == pytest.approx(tests.alpha.sum(dim=(1, 2, 3)), rel=0.01)
    for name in ("albedo", "roughness", "metallic"):
        scores = compare_pictures(getattr(found, name), getattr(tests, name), found.alpha, tests.alpha)
        assert scores.psnr_in > 40.0, name
    lit, relit = asset_lights(asset, tests.cameras, (truth.input_light, truth.other_light), TINY)
    assert compare_pictures(lit, tests.lit, tests.alpha, tests.alpha).psnr_in > 45.0
    assert compare_pictures(relit, tests.relit, tests.alpha, tests.alpha).psnr_in > 45.0
    # The lights are not alike, so the one is not the other's truth.
    assert compare_pictures(relit, tests.lit, tests.alpha, tests.alpha).psnr_in < 25.0


def test_more_views_are_relit_under_more_lights(data, asset):
    protocol = replace(TINY, views=1, relit_views=3, environments=2)
    truth = render(data, protocol=protocol)
    relighting = truth.relighting
    assert relighting.lights[0] == data / "night.exr" and relighting.lights[1].parent.name == "world"  # Blender's own.
    assert len(truth.tests.cameras) == 1 and len(relighting.cameras) == 3 and truth.tests.relit is None
    render_asset = partial(asset_lights, asset, protocol=protocol)
    _, scores = under_lights(truth.tests, partial(map_pictures, asset), render_asset, truth, None)
    assert scores["relit"].psnr_in > 45.0
    swapped = replace(relighting, lights=relighting.lights[::-1])
    _, scores = under_lights(
        truth.tests, partial(map_pictures, asset), render_asset, replace(truth, relighting=swapped), None
    )
    assert scores["relit"].psnr_in < 30.0


def test_the_paper_protocol_measures_the_meshes_of_another_system(data, monkeypatch):
    """By fewer views and lights; the truth's own file is the other system."""
    monkeypatch.setattr(evaluate, "PAPER_COUNTS", {"views": 2, "relit_views": 3, "environments": 2})
    words = ["--data", str(data), "--cache", str(data / "cache"), "--output", str(data / "out"), *WORDS[:4]]
    assert main(["evaluate", *words, "--paper-protocol", "--meshes", str(data)]) == 0
    record = json.loads((data / "out" / "results.json").read_text())
    assert "relighting of 3 views under 2 environments" in record["setting"]
    systems = record["objects"][0]["systems"]
    assert min(systems["ours"]["maps"][name]["psnr_in"] for name in ("albedo", "lit", "relit")) > 45.0
    assert 0.0 < systems["hull"]["maps"]["relit"]["psnr_in"] < 30.0
    assert (data / "out" / "large" / "ring.jpg").stat().st_size > 0


def test_colours_at_vertices_are_lit_as_a_texture_of_that_colour(data, asset):
    truth = render(data)
    lights = (truth.input_light, truth.other_light)
    mesh = TriangleMesh(asset.mesh.vertices, asset.mesh.faces)
    colors = torch.tensor([0.6, 0.25, 0.1]).expand(len(mesh.vertices), 3)
    by_vertex = colored_lights(ColoredMesh(mesh, colors, 0.4, 0.0), truth.tests.cameras, lights, TINY)
    by_texture = asset_lights(asset, truth.tests.cameras, lights, TINY)
    alpha = truth.tests.alpha
    for a, b in zip(by_vertex, by_texture, strict=True):
        assert compare_pictures(a, b, alpha, alpha).psnr_in > 35.0
    drawn = vertex_pictures(mesh, colors, (0.4, 0.0), truth.tests.cameras)
    assert compare_pictures(drawn.albedo, truth.tests.albedo, drawn.alpha, alpha).psnr_in > 40.0


def test_scans_without_a_finish_get_the_agreed_one(data, asset):
    """And the highlight that every material of ours has, whatever the scan's file says of its own."""
    imported = truth_blender.import_object

    def matte(path, up):
        objects = imported(path, up)
        for material in bpy.data.materials:
            truth_blender.principled(material).inputs["Specular IOR Level"].default_value = 0.0
        return objects

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(truth_blender, "import_object", matte)
        truth = render(data, kind="gso")
    inside = truth.tests.mask
    agreed = replace(asset, maps=replace(asset.maps, roughness=torch.full((1, 4, 4), 0.5)))
    (lit,) = asset_lights(agreed, truth.tests.cameras, (truth.input_light,), TINY)
    assert compare_pictures(lit, truth.tests.lit, truth.tests.alpha, truth.tests.alpha).psnr_in > 45.0
    assert truth.tests.roughness[inside].mean() == pytest.approx(0.5, abs=0.01)
    assert truth.tests.metallic[inside].max() < 0.01


def test_what_breaks_while_the_truth_is_rendered_leaves_nothing_and_is_made_up_for(data, monkeypatch):
    rendered = truth_blender.render_views

    def breaks(cameras):
        raise KeyboardInterrupt

    monkeypatch.setattr(truth_blender, "render_views", breaks)
    with pytest.raises(KeyboardInterrupt):
        render(data)
    assert not (data / "cache").exists()
    monkeypatch.setattr(truth_blender, "render_views", rendered)
    render(data)
    assert is_whole(data / "cache" / "ring")
    monkeypatch.setattr(truth_blender, "render_views", breaks)
    render(data)  # Nothing is missing: nothing is rendered.


def test_the_meshes_of_another_system_are_scored_by_the_same_rules(data, capsys):
    """The truth's own file is the other system."""
    words = ["--data", str(data), "--cache", str(data / "cache"), "--output", str(data / "out"), *WORDS]
    picture = ["--picture", str(data / "docs" / "front.jpg"), "--picture-of", "ring"]
    assert main(["evaluate", *words, "--meshes", str(data), *picture]) == 0
    (item,) = json.loads((data / "out" / "results.json").read_text())["objects"]
    ours, hull = item["systems"]["ours"], item["systems"]["hull"]
    assert ours["geometry"]["f_coarse"] == ours["aligned"]["f_coarse"] == 1.0
    assert ours["geometry"]["chamfer"] < 0.02 < hull["geometry"]["chamfer"]
    assert min(ours["maps"][name]["psnr_in"] for name in ("albedo", "roughness", "metallic")) > 45.0
    assert min(ours["maps"][name]["psnr_in"] for name in ("lit", "relit")) > 45.0
    pictures = ("out/ring.jpg", "out/large/ring.jpg", "out/worst-1.jpg", "docs/front.jpg")
    assert all((data / name).stat().st_size > 0 for name in pictures)
    assert "PBR set relit PSNR in" in capsys.readouterr().out
