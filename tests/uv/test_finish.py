"""Finishes change whole regions, and nothing of what was predicted."""

import pytest
import torch

from arm_blender.knobs.finishes import PRESETS, Finish
from arm_blender.report import Report
from arm_blender.structures import MaterialMaps, Regions
from arm_blender.uv.finish import chosen_finishes, finished

T = 8
LIGHT = (2.0, 1.0, 0.5)


@pytest.fixture
def maps() -> MaterialMaps:
    """Left half region 1, right half region 2; roughness is a map with half of the texels a side."""
    generator = torch.Generator().manual_seed(0)
    index = torch.ones(T, T, dtype=torch.uint8)
    index[:, T // 2 :] = 2
    albedo, baked = torch.rand(3, T, T, generator=generator), torch.rand(3, T, T, generator=generator)
    roughness = torch.rand(1, T // 2, T // 2, generator=generator)
    return MaterialMaps(albedo, baked, roughness, 0.0, None, Regions(index, (0.5, 0.5), ((0.5,) * 3,) * 2, LIGHT))


def set_to(maps: MaterialMaps, words: str | None) -> MaterialMaps:
    return chosen_finishes(maps, words, Report("small", "cpu", 0))


def test_without_a_finish_the_maps_are_the_predicted_ones(maps):
    assert finished(set_to(maps, None)) == maps


def test_a_finish_changes_its_region_alone(maps):
    before = maps.albedo.clone(), maps.roughness.clone()
    shown = finished(set_to(maps, "2=rubber"))
    right = maps.regions.index == 2
    assert bool((shown.roughness[0][right] == torch.tensor(PRESETS["rubber"].roughness)).all())
    assert torch.equal(shown.albedo, maps.albedo)
    assert shown.metallic is not None and float(shown.image("metallic").max()) == 0.0
    left = shown.roughness[0][:, : T // 2 - 1]
    assert float(left.min()) >= float(maps.roughness.min()) and float(left.max()) <= float(maps.roughness.max())
    assert torch.equal(maps.albedo, before[0]) and torch.equal(maps.roughness, before[1])


@pytest.mark.parametrize("name", ["chrome", "gold", "brushed-steel"])
def test_a_named_metal_has_the_colour_of_the_metal(maps, name):
    shown = finished(set_to(maps, f"2={name}"))
    right = maps.regions.index == 2
    assert torch.allclose(shown.albedo[:, right].mean(dim=1), torch.tensor(PRESETS[name].f0), atol=1e-6)
    assert bool((shown.metallic[0] == right.float()).all())
    assert torch.equal(shown.albedo[:, ~right], maps.albedo[:, ~right])


def test_a_metal_without_a_name_has_what_the_views_say_over_their_light(maps):
    shown = finished(set_to(maps, "1=0.3/1"))
    left = maps.regions.index == 1
    expected = (maps.baked / torch.tensor(LIGHT)[:, None, None]).clamp(0.0, 1.0)
    assert torch.allclose(shown.albedo[:, left], expected[:, left])


def test_half_a_metal_is_half_way(maps):
    shown = finished(set_to(maps, "1=0.3/0.5"))
    left = maps.regions.index == 1
    remade = (maps.baked / torch.tensor(LIGHT)[:, None, None]).clamp(0.0, 1.0)
    assert torch.allclose(shown.albedo[:, left], (0.5 * (maps.albedo + remade))[:, left], atol=1e-6)


def test_a_map_that_is_one_value_stays_one_where_it_can(maps):
    assert finished(set_to(maps, "1=chrome,2=gold")).metallic == 1.0
    assert finished(set_to(maps, "1=chrome,2=rubber")).metallic.shape == (1, T, T)


def test_the_report_lists_the_regions(maps):
    report = Report("small", "cpu", 0)
    chosen_finishes(maps, "2=0.3/1", report)
    first, second = report.as_dict()["regions"]
    assert first["number"] == 1 and first["share"] == 0.5 and first["swatch"] == "#bcbcbc" and first["finish"] is None
    assert second["finish"] == "0.3/1" and second["metallic"] == 0.0
    assert second["roughness"] == pytest.approx(float(maps.roughness[0][:, T // 4 :].mean()), abs=1e-4)
    assert report.as_dict()["values"] == {"metallic": 0.0} and not report.doubts


def test_a_number_that_there_is_no_region_of_makes_the_result_doubtful(maps):
    report = Report("small", "cpu", 0)
    given = chosen_finishes(maps, "1=gold,5=chrome", report)
    assert given.regions.finishes == {1: PRESETS["gold"]}
    assert report.doubts == ["--finish 5=chrome was not used, as there is no region 5; regions.png shows 1 to 2"]


def test_a_region_that_is_not_there_is_a_bug():
    with pytest.raises(ValueError, match="1 regions"):
        Regions(torch.ones(2, 2, dtype=torch.uint8), (1.0,), ((0.5,) * 3,), LIGHT, {2: Finish(0.1, 0.2)})
