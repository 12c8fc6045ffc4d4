"""The whole pipeline with the shipped weights on the committed example."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
import trimesh

from arm_blender import pipeline
from arm_blender.config import Settings
from arm_blender.errors import ArmError, Cancelled, CheckpointError, EmptyMeshError
from arm_blender.graphics.cameras import project
from arm_blender.knobs.finishes import PRESETS
from arm_blender.models.image_encoder import ImageEncoderConfig
from arm_blender.models.paper.georm import GeoRM
from arm_blender.models.paper.reconstruction import ReconstructionConfig
from arm_blender.models.transformer import TransformerConfig
from arm_blender.models.triplane import DecoderConfig, UpsamplerConfig
from arm_blender.report import Report
from arm_blender.structures import RelightableAsset, TriangleMesh, ViewSet
from arm_blender.uv.normal_map import DETAIL_TEXELS
from arm_blender.views import load_views
from arm_blender.weight_files import checkpoints

EXAMPLE = Path(__file__).parents[1] / "arm_blender" / "examples" / "barrel"
QUICK = Settings(quality="draft", grid=48, faces=1500, texture_size=256)


@pytest.fixture(scope="module")
def views() -> ViewSet:
    return load_views(EXAMPLE)


@pytest.fixture(scope="module")
def result(views):
    return pipeline.generate(views, QUICK)


def covered(asset: RelightableAsset, views: ViewSet, view: int) -> tuple[float, float]:
    """Share of the mesh's vertices that fall into the silhouette, and of the silhouette's box that they span."""
    pixels, _ = project(asset.mesh.vertices, views.cameras[view])
    alpha = views.images[view, 3]
    column, row = pixels.long().clamp(0, alpha.shape[-1] - 1).unbind(1)
    inside = float((alpha[row, column] > 0.5).float().mean())
    rows = (alpha > 0.5).any(dim=1).nonzero()
    return inside, float((pixels[:, 1].max() - pixels[:, 1].min()) / (rows.max() - rows.min()))


def test_the_shape_fills_the_silhouettes(result, views):
    for view in range(len(views.cameras)):
        inside, span = covered(result[0], views, view)
        assert inside > 0.9 and 0.9 < span < 1.1


def test_the_light_is_kept_and_the_asset_under_it_is_near_the_views(result, views):
    asset, report = result
    told = report.as_dict()["light"]
    assert [one["view"] for one in told["views"]] == list(views.called)
    # Of a barrel so bright under so bright a sky: without the light's level the two would be 10 dB apart.
    assert all(14.0 < one["psnr"] < 40.0 for one in told["views"])
    torch.testing.assert_close(torch.tensor(told["harmonics"]), asset.maps.light)
    height = asset.comparison.shape[1] // len(views.cameras)
    assert asset.comparison.dtype == torch.uint8 and asset.comparison.shape[2] == 3 * height


def test_the_maps_are_whole_and_in_range(result):
    maps = result[0].maps
    for name, channels in (("albedo", 3), ("baked", 3), ("roughness", 1), ("metallic", 1)):
        image = maps.image(name)
        assert image.shape[0] == channels and image.shape[1] == image.shape[2]
        assert bool(image.isfinite().all()) and float(image.min()) >= 0.0 and float(image.max()) <= 1.0


def test_the_barrel_is_blue(result):
    red, green, blue = result[0].maps.albedo.flatten(1).median(dim=1).values.tolist()
    assert blue > 2.0 * red and blue > green


def test_the_report_says_what_was_made(result):
    report = result[1].as_dict()
    assert report["faces"] == len(result[0].mesh.faces) <= QUICK.resolved.faces
    assert set(report["seconds"]) == {"shape", "unwrap", "appearance", "check by light"}
    assert 0.5 < report["seen_share"] <= 1.0


def test_the_barrel_is_one_blue_region_and_little_else(result):
    regions, listed = result[0].maps.regions, result[1].as_dict()["regions"]
    assert regions.index.shape == result[0].maps.albedo.shape[1:] and len(listed) == regions.count
    assert regions.area[0] > 0.6 and sum(regions.area) == pytest.approx(1.0)
    red, green, blue = regions.swatch[0]
    assert blue > 2.0 * red and blue > green
    assert all(one["finish"] is None for one in listed)


def test_a_finish_is_set_beside_what_is_predicted(result, views):
    asset, report = pipeline.generate(views, replace(QUICK, finish="1=chrome,8=gold"))
    assert torch.equal(asset.maps.albedo, result[0].maps.albedo)
    assert asset.maps.regions.finishes == {1: PRESETS["chrome"]}
    assert report.regions[0]["finish"] == "chrome"
    assert any("there is no region 8" in doubt for doubt in report.doubts)


def test_the_same_seed_gives_the_same_asset(result, views):
    again, _ = pipeline.generate(views, QUICK)
    assert torch.equal(again.mesh.vertices, result[0].mesh.vertices)
    assert torch.equal(again.maps.albedo, result[0].maps.albedo)


def test_a_view_of_weight_zero_counts_as_absent(views):
    weights = torch.tensor([1.0, 1.0, 0.0, 1.0, 1.0, 1.0])
    silenced, report = pipeline.generate(replace(views, weights=weights), QUICK)
    keep = [0, 1, 3, 4, 5]
    absent = ViewSet(views.images[keep], tuple(views.cameras[i] for i in keep), torch.ones(5), views.name)
    assert torch.equal(silenced.mesh.vertices, pipeline.generate(absent, QUICK)[0].mesh.vertices)
    assert any(note.why == "their weight is 0" for note in report.left_out)


def test_a_scene_of_another_scale_gives_the_same_object_there(result, views):
    scale = 30.0
    cameras = []
    for camera in views.cameras:
        c2w = camera.c2w.clone()
        c2w[:3, 3] *= scale
        cameras.append(replace(camera, c2w=c2w))
    asset, _ = pipeline.generate(replace(views, cameras=tuple(cameras)), QUICK)
    moved = replace(views, cameras=tuple(cameras))
    inside, span = covered(asset, moved, 0)
    assert inside > 0.85 and 0.85 < span < 1.15
    extent = (asset.mesh.vertices.amax(0) - asset.mesh.vertices.amin(0)) / scale
    plain = result[0].mesh.vertices
    assert torch.allclose(extent, plain.amax(0) - plain.amin(0), rtol=0.15)


def test_the_longest_side_is_as_long_as_is_asked_for(result, views):
    asset, _ = pipeline.generate(replace(views, length=0.19), QUICK)
    plain = result[0].mesh.vertices
    sides, before = (vertices.amax(0) - vertices.amin(0) for vertices in (asset.mesh.vertices, plain))
    assert float(sides.max()) == pytest.approx(0.19, rel=1e-5)
    torch.testing.assert_close(sides / sides.max(), before / before.max(), rtol=1e-4, atol=1e-4)


def test_one_view_is_enough(views):
    single = ViewSet(views.images[:1], views.cameras[:1], torch.ones(1), views.name)
    asset, report = pipeline.generate(single, QUICK)
    inside, span = covered(asset, single, 0)
    assert inside > 0.8 and 0.9 < span < 1.1
    assert report.seen_share < 0.7
    assert "GeoRM" in {note.what for note in report.left_out}
    assert set(report.weights) == {"small.ray_occupancy", "small.finish", "small.instant_albedo"}


def test_where_views_can_be_compared_they_are(result):
    assert set(result[1].weights) == {"small.georm", "small.finish", "small.instant_albedo"}


def cylinder_mesh(x: float = 0.0) -> TriangleMesh:
    cylinder = trimesh.creation.cylinder(0.45, 1.9, sections=24)
    return TriangleMesh(torch.tensor(cylinder.vertices + [x, 0.0, 0.0]).float(), torch.tensor(cylinder.faces).long())


def test_a_users_mesh_keeps_its_shape(views):
    cylinder = cylinder_mesh()
    asset, report = pipeline.generate(views, QUICK, mesh=cylinder)
    assert torch.allclose(asset.mesh.vertices.amax(0), cylinder.vertices.amax(0), atol=1e-5)
    assert len(asset.mesh.faces) == len(cylinder.faces)
    assert "reconstruction of the shape" in {note.what for note in report.left_out}


def test_a_mesh_with_edges_of_three_faces_keeps_them(views):
    cylinder = cylinder_mesh()
    a, b, _ = cylinder.faces[0].tolist()
    tip = torch.tensor([[0.0, -0.9, 0.0]])
    vertices, faces = torch.cat([cylinder.vertices, tip]), torch.cat([cylinder.faces, torch.tensor([[a, b, 50]])])
    asset, report = pipeline.generate(views, QUICK, mesh=TriangleMesh(vertices, faces))
    found, given = (one.sort(dim=1).values for one in (asset.mesh.faces, faces))
    assert torch.equal(found, given) and report.seen_share > 0.5, "all are there; a fin seen from behind is turned"


def test_a_mesh_that_no_view_sees_is_said(views):
    with pytest.raises(EmptyMeshError, match="no view sees the given mesh"):
        pipeline.generate(views, QUICK, mesh=cylinder_mesh(x=50.0))


@pytest.mark.parametrize(
    "missing, count", [("georm", 6), ("finish", 6), ("instant_albedo", 6), ("ray_occupancy", 1), ("finish", 1)]
)
def test_missing_weights_are_known_before_the_work(views, tmp_path, monkeypatch, missing, count):
    real = Settings.weights
    there = {name: real(QUICK, name) for name in QUICK.networks} | {missing: tmp_path / "gone.safetensors"}
    monkeypatch.setattr(Settings, "weights", lambda _, name: there[name])
    report = Report("small", "cpu", 0)
    with pytest.raises(CheckpointError, match="gone.safetensors"):
        pipeline.generate(views.only([*range(count)]), QUICK, report=report)
    assert report.seconds == {}


def test_a_density_without_a_surface_names_the_views(views, monkeypatch):
    def nothing(*_):
        raise EmptyMeshError("no surface")

    monkeypatch.setattr(pipeline, "extract", nothing)
    with pytest.raises(EmptyMeshError, match=f"{views.name}: no surface"):
        pipeline.shape(views, QUICK)


STOPS = ("GeoRM: reading the views", "Filling silhouettes", "Packing charts")
STOPS += ("back-projecting the views", "filling unseen texels", "Finish: reading the views")


@pytest.mark.parametrize("stage", STOPS)
def test_cancelling_stops_at_the_next_report_of_progress(views, stage):
    """At the first report of the first stage, of the one that waits for a process, of the last, and of long ones."""
    heard = []

    def progress(fraction: float, message: str) -> None:
        heard.append(fraction)
        if message == stage:
            raise Cancelled("stopped")

    report = Report("small", "cpu", 0)
    with pytest.raises(Cancelled):
        pipeline.generate(views, QUICK, progress, report)
    assert heard == sorted(heard) and 0.0 <= heard[0] <= heard[-1] <= 1.0
    expected = {
        "GeoRM": ["shape"],
        "Filling silhouettes": ["shape"],
        "Packing charts": ["shape", "unwrap"],
        "back-projecting the views": ["shape", "unwrap", "appearance"],
        "filling unseen texels": ["shape", "unwrap", "appearance"],
        "Finish": ["shape", "unwrap", "appearance"],
    }
    assert list(report.seconds) == expected[stage.partition(":")[0]]


@pytest.mark.parametrize("stage", ["Ray occupancy: reading the views", "Filling silhouettes"])
def test_cancelling_stops_with_one_view_as_well(views, stage):
    def progress(fraction: float, message: str) -> None:
        if message == stage:
            raise Cancelled("stopped")

    report = Report("small", "cpu", 0)
    with pytest.raises(Cancelled):
        pipeline.generate(views.only([0]), QUICK, progress, report)
    assert list(report.seconds) == ["shape"]


def test_the_callers_threads_and_seed_come_back(views):
    threads, random = torch.get_num_threads(), torch.get_rng_state()
    with pytest.raises(ArmError):
        pipeline.generate(views, replace(QUICK, threads=threads + 1, preset="paper"))
    assert torch.get_num_threads() == threads and torch.equal(torch.get_rng_state(), random)


def front_half() -> GeoRM:
    """A network in InstantMesh's layout that finds all of the box with x > 0 in its own frame to be inside."""
    config = ReconstructionConfig(
        encoder=ImageEncoderConfig(image_size=16, patch_size=8, position_grid=2, width=8, depth=1, heads=1),
        transformer=TransformerConfig(width=8, layers=1, heads=1, grid=8),
        upsampler=UpsamplerConfig(filters=8, blocks=1, growth=4, doublings=2, channels=1, deconvolution=True),
        decoder=DecoderConfig(hidden_layers=0),
        front="+x",
    )
    network = GeoRM(config).requires_grad_(False)
    block = network.model.transformer.layers[0]
    for layer in (block.cross_attn.out, block.self_attn.out, block.mlp[2]):
        layer.weight.zero_()  # Tokens stay what they are.
    block.mlp[2].bias.zero_()
    pattern = torch.tensor([1.0, -1.0]).repeat(4)
    token = torch.where(torch.arange(8) < 4, -1.0, 1.0)[:, None] * pattern  # A row of the plane (x, y), along x.
    network.model.transformer.position.copy_(token.repeat(24, 1))
    network.model.upsampler.deconv.weight.copy_(pattern[:, None, None, None].expand(8, 1, 2, 2))
    network.model.upsampler.deconv.bias.zero_()
    last = network.model.decoder[-1]
    last.weight.copy_(torch.tensor([[1.0, 0.0, 0.0]]))
    last.bias.zero_()
    return network


def test_a_network_in_instantmeshs_frame_puts_its_front_where_blenders_is(views, tmp_path, monkeypatch):
    network = front_half()
    path = tmp_path / "georm.safetensors"
    checkpoints.save(path, network.state_dict(), network.config, "georm")
    monkeypatch.setattr(Settings, "weights", lambda _, name: path)
    vertices = pipeline.shape(views, replace(QUICK, preset="instantmesh")).vertices
    assert float(vertices[:, 1].max()) == pytest.approx(0.0, abs=0.02)
    assert float(vertices[:, 1].min()) < -0.9
    assert float(vertices[:, 0].min()) < -0.9 and float(vertices[:, 0].max()) > 0.9


def test_instantmesh_takes_the_material_from_small():
    settings = Settings(preset="instantmesh")
    assert settings.weights("georm").name == "instantmesh.georm.safetensors"
    for network in ("finish", "instant_albedo"):
        assert settings.weights(network) == Settings(preset="small").weights(network)


def test_the_detail_that_decimation_takes_is_kept_where_it_is_asked_for(views):
    asset, report = pipeline.generate(views, replace(QUICK, faces=200, normal_map=True))
    normal = asset.maps.normal
    assert normal.shape[0] == 3 and normal.shape[-1] <= DETAIL_TEXELS and "normal map" in report.seconds
    torch.testing.assert_close(normal.norm(dim=0), torch.ones(normal.shape[1:]), atol=1e-4, rtol=0.0)
    assert float(normal[2].min()) < 0.999, "a ball of 200 faces has lost something"
    whole, report = pipeline.generate(views, replace(QUICK, faces=10**6, normal_map=True))
    assert whole.maps.normal is None and "normal map" in [note.what for note in report.left_out]
