"""The ground without what stands on it, and which pixels look like it: shadows do, the object does not."""

import pytest
import torch

from arm_blender.photographs.masks.ground_colors import REACH, ground_colors, unlike_ground

from .ball_on_ground import GROUND, HEIGHT, SHADOW, WIDTH, eyes, pattern_of, photograph

GAINS = [1.0 + 0.25 * (-1) ** k * (k % 4) / 3.0 for k in range(12)]


@pytest.fixture(scope="module")
def taken():
    own = eyes()
    return own, [photograph(eye, gain) for eye, gain in zip(own, GAINS, strict=True)]


@pytest.fixture(scope="module")
def ground(taken):
    own, shots = taken
    masks = [(ball | shadow).float() for _, ball, shadow in shots]  # A first look takes the shadow along.
    return ground_colors([picture for picture, _, _ in shots], own, masks, GROUND)


def places() -> torch.Tensor:
    x, y = (2.0 * (torch.arange(size) + 0.5) / size - 1.0 for size in (WIDTH, HEIGHT))
    return torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)


def test_the_ground_is_its_pattern_and_its_shadow(ground):
    axis = torch.linspace(-2.2, 2.2, 40)
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    points = torch.stack([x, y, torch.full_like(x, GROUND)], dim=-1)
    found = ground.at(points)
    off_ball = points[..., :2].norm(dim=-1) > 1.3
    distance = (points[..., :2] - torch.tensor(SHADOW[:2])).norm(dim=-1)
    expected = pattern_of(points) * torch.where(distance < SHADOW[2], 0.4, 1.0)
    asked = off_ball & ((distance - SHADOW[2]).abs() > 0.1) & (points[..., :2].abs().amax(dim=-1) < REACH)
    scale = (found[:3, asked] / expected[:, asked]).median()  # Which exposure is right nobody knows.
    assert float((found[:3, asked] - scale * expected[:, asked]).abs().mean()) < 0.015
    assert bool((found[5, asked] > 0.5).all())


def test_exposures_are_evened(ground):
    evened = ground.gains[:, 1] * torch.tensor(GAINS)
    assert float(evened.std() / evened.mean()) < 0.02


def test_the_ball_is_unlike_the_ground_and_the_shadow_is_not(taken, ground):
    own, shots = taken
    for view in (0, 4, 7):
        picture, ball, shadow = shots[view]
        told = unlike_ground(ground, picture, view, own[view], places())
        known = told[3] > 0.5
        assert float(told[0, ball & known].median()) > 0.1
        assert float(told[0, shadow & known].median()) < 0.03
        assert float(told[2, shadow & known].mean()) > 0.6  # Though all masks hide it.


def test_above_the_horizon_nothing_is_known(taken, ground):
    own, shots = taken
    told = unlike_ground(ground, shots[1][0], 1, own[1], places())
    assert not bool(told[:, 0].any())
