"""What all masks have in common, as each picture sees it; the shadow on the ground is not part of it."""

import pytest
import torch

from arm_blender.photographs.masks.evidence import CHANNELS, evidence, places_of, scene, window

from .ball_on_ground import GROUND, HEIGHT, WIDTH, eyes, photograph

SIDE = 96


@pytest.fixture(scope="module")
def taken():
    own = eyes()
    return own, [photograph(eye) for eye in own]


@pytest.fixture(scope="module")
def seen(taken):
    own, shots = taken
    logits = [8.0 * (ball | shadow).float() - 4.0 for _, ball, shadow in shots]
    logits[5] = torch.zeros_like(logits[5])  # Of one picture nothing was found.
    return scene([picture for picture, _, _ in shots], logits, own, GROUND)


def masks_in(box, masks) -> torch.Tensor:
    grid = places_of(box, SIDE).expand(len(masks), -1, -1, -1)
    return torch.nn.functional.grid_sample(masks[:, None].float(), grid, align_corners=False)[:, 0] > 0.5


def test_a_window_holds_the_object(taken, seen):
    for view in (0, 3, 5):
        box = window(seen, view)
        ball = masks_in(box, taken[1][view][1][None])[0]
        share = float(ball.float().mean())
        assert 0.12 < share < 0.6
        assert not bool(ball[0].any() | ball[-1].any() | ball[:, 0].any() | ball[:, -1].any())
        square = (box[2] - box[0]) * WIDTH / ((box[3] - box[1]) * HEIGHT)
        assert float(square) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("view", [0, 3, 5])
def test_what_stands_above_the_ground_is_told_from_its_shadow(taken, seen, view):
    box = window(seen, view)
    rgb, told = evidence(seen, view, box, SIDE)
    assert rgb.shape == (3, SIDE, SIDE) and told.shape == (CHANNELS, SIDE, SIDE) and float(told.abs().max()) <= 1.0
    _, ball, shadow = (taken[1][view][k] for k in range(3))
    ball, shadow = masks_in(box, torch.stack([ball, shadow]))
    assert float((told[3, ball] > 0.0).float().mean()) > 0.95
    assert float(told[3, ball].mean() - told[3, shadow].mean()) > 0.5
    assert bool((told[3] <= told[2] + 1e-6).all()) and float((told[2] - told[3])[shadow].mean()) > 0.05


def test_without_a_ground_its_channels_are_empty(taken):
    own, shots = taken
    logits = [8.0 * ball.float() - 4.0 for _, ball, _ in shots]
    seen = scene([picture for picture, _, _ in shots], logits, own, None)
    _, told = evidence(seen, 0, window(seen, 0), SIDE)
    assert not bool(told[4:8].any()) and bool((told[3] > 0.0).any())


def test_what_no_mask_shows_is_looked_for_everywhere(taken):
    own, shots = taken
    logits = [torch.full((HEIGHT, WIDTH), -4.0) for _ in own]
    seen = scene([picture for picture, _, _ in shots], logits, own, GROUND)
    box = window(seen, 2)
    assert float(box[0]) < -0.9 and float(box[2]) > 0.9
