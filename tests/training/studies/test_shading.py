"""Our shading is Cycles'; the other forms of the BRDF are not, so that the comparison can tell."""

import pytest
import torch
from torch.nn import functional as F

from arm_blender.graphics.cameras import orbit_camera
from training.evaluation.scores.image_scores import psnr_inside

pytestmark = pytest.mark.blender


def test_the_form_cycles_renders_as_cycles(tmp_path, monkeypatch) -> None:
    shading = pytest.importorskip("training.studies.shading_blender")
    monkeypatch.setattr(shading, "SKY", (12, 24))
    radiance = torch.rand(3, 12, 24, generator=torch.Generator().manual_seed(0)) ** 4 * 3.0
    sky = tmp_path / "sky.exr"
    shading.write_linear(sky, radiance)
    torch.testing.assert_close(shading.read_linear(sky), radiance)
    camera, finish = orbit_camera(25.0, 20.0, 4.5, 30.0, 32, 32), shading.maps(64)
    ball = next(iter(shading.subjects()))
    truth = shading.by_cycles(ball, finish, sky, camera, samples=512)
    pictures = shading.ours(ball, finish, radiance, camera)
    inner = -F.max_pool2d(-truth[None, 3:], 3, stride=1, padding=1)[0, 0] > 0.999
    assert inner.sum() > 200
    found = {form: psnr_inside(picture, truth, inner) for form, picture in pictures.items()}
    assert found["cycles"] > 35.0
    assert max(found["standard"], found["printed"]) < found["cycles"] - 5.0


def test_surfaces_are_closed_and_point_outwards() -> None:
    shading = pytest.importorskip("training.studies.shading_blender")
    for subject in shading.subjects():
        corners = subject.mesh.vertices[subject.mesh.faces]
        volume = torch.linalg.cross(corners[:, 0], corners[:, 1]).mul(corners[:, 2]).sum() / 6.0
        assert float(volume) > 0.1
        assert float(subject.mesh.vertices.norm(dim=1).max()) < 1.01
