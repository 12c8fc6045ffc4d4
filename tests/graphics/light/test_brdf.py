"""What a BRDF must obey, by quadrature in float64, for the standard formulas and for those that the paper prints."""

import math
from typing import get_args

import pytest
import torch
from torch import Tensor

from arm_blender.graphics.light.brdf import Form, distribution, evaluate, fresnel, geometry
from arm_blender.graphics.light.specular_albedo import specular_albedo
from training.studies.furnace import furnace, polar_quadrature

ROUGHNESS = (0.05, 0.2, 0.5, 0.8, 1.0)


def random_directions(count: int, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    directions = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    directions[:, 2] = directions[:, 2].abs()
    return torch.nn.functional.normalize(directions, dim=1)


@pytest.mark.parametrize("roughness", ROUGHNESS)
def test_the_density_of_normals_integrates_to_one(roughness: float) -> None:
    theta, weight = polar_quadrature(100_000)
    density = distribution(1.0 - theta.cos(), torch.tensor(roughness).double())
    assert float((density * theta.cos() * weight).sum() * 2 * math.pi) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize(("roughness", "published"), [(0.2, 1.98), (0.5, 1.74), (0.8, 1.29)])
def test_the_printed_density_does_not_integrate_to_one(roughness: float, published: float) -> None:
    theta, weight = polar_quadrature(100_000)
    density = distribution(1.0 - theta.cos(), torch.tensor(roughness).double(), printed=True)
    assert float((density * theta.cos() * weight).sum() * 2 * math.pi) == pytest.approx(published, abs=5e-3)


@pytest.mark.parametrize("form", ("standard", "cycles"))
@pytest.mark.parametrize("metallic", (0.0, 1.0))
@pytest.mark.parametrize("roughness", ROUGHNESS)
def test_white_furnace_never_gains_energy(roughness: float, metallic: float, form: Form) -> None:
    for n_dot_v in (0.05, 0.2, 0.5, 0.8, 1.0):
        assert 0.0 < furnace(roughness, metallic, n_dot_v, form) <= 1.0 + (1e-4 if form == "standard" else 2e-3)


@pytest.mark.parametrize("roughness", ROUGHNESS)
def test_the_diffuse_layer_of_cycles_gets_all_that_the_lobe_leaves(roughness: float) -> None:
    for n_dot_v in (0.1, 0.4, 0.75, 1.0):
        assert furnace(roughness, 0.0, n_dot_v, "cycles") == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("roughness", ROUGHNESS)
def test_the_table_of_the_lobes_albedo_is_its_integral(roughness: float) -> None:
    for n_dot_v in (0.1, 0.37, 0.8, 1.0):
        # White metal is the lobe alone, its Fresnel term 1.
        cosine, rough = torch.tensor([n_dot_v]).double(), torch.tensor([roughness]).double()
        found = float(specular_albedo(cosine, rough, torch.ones(1).double()))
        assert found == pytest.approx(furnace(roughness, 1.0, n_dot_v, "cycles"), abs=1.5e-3)


def test_white_furnace_of_the_printed_formulas_gains_energy() -> None:
    assert furnace(0.5, 0.0, 0.8, "printed") > 1.05
    assert furnace(0.2, 1.0, 0.8, "printed") > 1.8


@pytest.mark.parametrize("roughness", (0.0, *ROUGHNESS))
def test_the_printed_formulas_gain_no_more_than_their_lobe(roughness: float) -> None:
    """White plastic is black plastic and a diffuse term that nothing was taken from: 1 / pi, 1 in the furnace."""
    light, view = random_directions(400, 1), random_directions(400, 2)
    normal, rough, plastic = torch.tensor([0.0, 0.0, 1.0]).double(), torch.tensor([roughness]), torch.zeros(1)
    white, black = (
        evaluate(normal, light, view, torch.full((3,), c).double(), rough, plastic, "printed") for c in (1, 0)
    )
    torch.testing.assert_close(white - black, torch.full((400, 3), 1.0 / math.pi).double(), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("roughness", (0.0, *ROUGHNESS))
def test_the_lobe_alone_never_gains_energy(roughness: float) -> None:
    """White metal, whose Fresnel term is 1: no lobe of these formulas is larger."""
    for n_dot_v in (1e-3, 0.05, 0.5, 1.0):
        for form in ("standard", "cycles"):
            assert furnace(roughness, 1.0, n_dot_v, form) <= 1.0 + 2e-3


def test_smooth_metal_mirrors_everything_at_normal_incidence() -> None:
    # Schlick-GGX hides nothing at normal incidence, and F of white metal is 1: all that is left is that D integrates.
    assert furnace(0.05, 1.0, 1.0, "standard") == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("form", ("standard", "printed"))
def test_light_and_view_may_be_exchanged(form: Form) -> None:
    light, view = random_directions(200, 1), random_directions(200, 2)
    normal, albedo = torch.tensor([0.0, 0.0, 1.0]).double(), torch.tensor([0.8, 0.4, 0.1]).double()
    rough, metal = torch.linspace(0, 1, 200).double()[:, None], torch.linspace(1, 0, 200).double()[:, None]
    there = evaluate(normal, light, view, albedo, rough, metal, form)
    back = evaluate(normal, view, light, albedo, rough, metal, form)
    torch.testing.assert_close(there, back, rtol=1e-9, atol=1e-12)
    assert (there > 0).all()


def test_metal_has_no_diffuse_and_takes_its_tint_from_the_albedo() -> None:
    normal = torch.tensor([0.0, 0.0, 1.0])
    value = evaluate(normal, normal, normal, torch.tensor([1.0, 0.5, 0.0]), torch.ones(1), torch.ones(1))
    # At roughness 1 and normal incidence D = 1 / pi, G = 1, F = albedo: f = albedo / (4 pi).
    torch.testing.assert_close(value, torch.tensor([1.0, 0.5, 0.0]) / (4 * math.pi))


def test_terms_have_their_known_values() -> None:
    assert float(fresnel(torch.tensor(1.0), torch.tensor(0.04))) == pytest.approx(0.04)
    assert float(fresnel(torch.tensor(0.0), torch.tensor(0.04))) == pytest.approx(1.0)
    one, half, rough = torch.tensor(1.0), torch.tensor(0.5), torch.tensor(0.5)
    for printed, k in ((False, 1.5**2 / 8), (True, 1.25**2 / 8)):  # .281 and .195
        assert float(geometry(one, half, rough, printed)) == pytest.approx(0.5 / (0.5 * (1 - k) + k))


def test_nothing_is_reflected_below_the_surface() -> None:
    normal, view = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([0.6, 0.0, 0.8])
    light = torch.tensor([[0.6, 0.0, -0.8], [-0.6, 0.0, -0.8]])  # The second is opposite to the view.
    value = evaluate(normal, light, view, torch.ones(3), torch.full((1,), 0.3), torch.zeros(1))
    assert torch.equal(value, torch.zeros(2, 3))


@pytest.mark.parametrize("form", get_args(Form))
@pytest.mark.parametrize("roughness", (0.0, 1e-4, 1.0))
def test_gradients_are_finite_at_the_extremes(roughness: float, form: Form) -> None:
    normal = torch.tensor([0.0, 0.0, 1.0])
    grazing = torch.tensor([1.0, 0.0, 1e-9])
    up, away = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([-1.0, 0.0, 0.0])
    for light, view in ((up, up), (grazing, grazing), (grazing, away), (up, grazing), (grazing, -grazing)):
        inputs = [light.clone(), view.clone(), torch.zeros(3), torch.tensor([roughness]), torch.zeros(1)]
        inputs = [tensor.requires_grad_() for tensor in inputs]
        value = evaluate(normal, *inputs, form)
        assert torch.isfinite(value).all()
        for gradient in torch.autograd.grad(value.sum(), inputs):
            assert torch.isfinite(gradient).all()


@pytest.mark.parametrize("form", get_args(Form))
@pytest.mark.parametrize("roughness", (0.0, 0.3, 1.0))
def test_no_cosine_and_no_vector_without_length_gives_what_is_no_number(roughness: float, form: Form) -> None:
    normal, nothing = torch.tensor([0.0, 0.0, 1.0]), torch.zeros(3)
    cosines = torch.tensor([1.0, 0.5, *(10.0**-k for k in range(1, 8)), 0.0, -1e-7, -0.5, -1.0])
    around = torch.stack([(1.0 - cosines**2).sqrt(), torch.zeros_like(cosines), cosines], dim=1)
    vectors = torch.cat([around, around * torch.tensor([-1.0, 1.0, 1.0]), nothing[None]])
    for up in (normal, nothing):
        light, view = (x.reshape(-1, 3).clone().requires_grad_() for x in torch.broadcast_tensors(
            vectors[:, None], vectors[None]
        ))  # fmt: skip
        finish = [x.requires_grad_() for x in (torch.ones(3), torch.full((1,), roughness), torch.full((1,), 0.5))]
        value = evaluate(up, light, view, *finish, form)
        assert bool(value.isfinite().all()) and bool((value >= 0.0).all())
        for gradient in torch.autograd.grad(value.sum(), (light, view, *finish)):
            assert bool(gradient.isfinite().all())


@pytest.mark.parametrize("form", get_args(Form))
@pytest.mark.parametrize("roughness", (0.0, 0.03, 0.1, 0.5))
def test_single_precision_holds_the_lobe_of_a_mirror(roughness: float, form: Form) -> None:
    """Half-way vectors all over the lobe; cosines alone would be wrong by a tenth in the median at roughness 0."""
    normal, view = random_directions(500, 3), random_directions(500, 4)
    view = torch.where((normal * view).sum(1, keepdim=True) < 0.0, -view, view)
    aside = 0.5 * max(roughness**2, 1e-3) * torch.randn(500, 3, generator=torch.Generator().manual_seed(5)).double()
    half = torch.nn.functional.normalize(normal + aside, dim=1)
    light = 2.0 * (half * view).sum(1, keepdim=True) * half - view
    single = [x.float() for x in (normal, light, view)]
    finish = torch.ones(3), torch.full((1,), roughness), torch.ones(1)
    found = evaluate(*single, *finish, form)
    exact = evaluate(*(x.double() for x in (*single, *finish)), form)
    above = exact[:, 0] > 0.0
    assert float(above.double().mean()) > 0.9
    torch.testing.assert_close(found[above].double(), exact[above], rtol=1e-3, atol=0.0)


def test_autocast_leaves_the_brdf_in_single_precision() -> None:
    normal, light, view = (random_directions(100, seed).float() for seed in range(3))
    finish = torch.rand(100, 5, generator=torch.Generator().manual_seed(0)).split((3, 1, 1), dim=1)
    for form in get_args(Form):
        expected = evaluate(normal, light, view, *finish, form)
        with torch.autocast("cpu", torch.bfloat16):
            assert torch.equal(evaluate(normal, light, view, *finish, form), expected)


@pytest.mark.parametrize("dtype", (torch.float16, torch.bfloat16))
def test_half_precision_is_computed_in_single(dtype: torch.dtype) -> None:
    up, rough = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([0.05])
    value = evaluate(*(x.to(dtype) for x in (up, up, up, torch.ones(3), rough, torch.ones(1))))
    exact = evaluate(up, up, up, torch.ones(3), rough.to(dtype).float(), torch.ones(1))
    assert value.dtype == torch.float32 and torch.equal(value, exact)
