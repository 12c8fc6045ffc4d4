"""When the stage is left out, and what the report says of it."""

from dataclasses import replace

import pytest
import torch

from arm_blender.refinement.refined import refined
from arm_blender.report import Report
from training.studies.extremes.pebble import ball, pictures, radius, wrong_radius


@pytest.fixture(scope="module")
def views():
    return pictures(ball(radius, 96))


def report() -> Report:
    return Report("small", "cpu", 0)


def test_the_report_tells_what_was_done(views):
    start, said = ball(wrong_radius, 32), report()
    assert not torch.equal(refined(start, views, 1, said).vertices, start.vertices)
    told = said.as_dict()["refinement"]
    assert told["rounds"] == 1 and told["seconds"] > 0.0
    assert told["outline_error_after"] < told["outline_error_before"]
    assert len(told["trust"]) == len(views.cameras) and not said.left_out


def test_few_views_are_not_met(views):
    start, said = ball(wrong_radius, 32), report()
    assert refined(start, views.only([0, 3]), 2, said) is start
    assert said.refinement is None and "3 views" in said.left_out[0].why


def test_no_rounds_say_nothing(views):
    start, said = ball(wrong_radius, 32), report()
    assert refined(start, views, 0, said) is start and not said.left_out


def test_pictures_that_contradict_each_other_leave_the_mesh(views):
    start, said = ball(wrong_radius, 32), report()
    # Masks stand where no two agree: each as far off as the object is wide.
    shifts = ((50, 0), (-50, 20), (0, 50), (20, -50), (-40, -40), (45, 45))
    mixed = [image.roll(shift, (1, 2)) for image, shift in zip(views.images, shifts, strict=True)]
    mesh = refined(start, replace(views, images=torch.stack(mixed)), 1, said)
    told = said.as_dict()["refinement"]
    assert torch.equal(mesh.vertices, start.vertices)
    assert told["outline_error_after"] > 0.8 * told["outline_error_before"]
    assert "contradict" in said.left_out[0].why
