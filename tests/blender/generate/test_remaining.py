"""The guess at the remaining seconds: right where all goes as expected, and it adapts where it does not."""

import pytest

from arm_blender.blender.generate.remaining import Remaining, clock
from arm_blender.progress import SHARES
from arm_blender.quality_levels import STAGES, measured_levels
from arm_blender.run import LOADING_SHARE


def reports(preset: str, slowness: float, own_mesh: bool = False, start: float = 2.0):
    """(progress, elapsed, truly left) of a run in which every stage takes `slowness` times what was measured."""
    seconds = {name: slowness * value for name, value in measured_levels()["balanced"].seconds.items()}
    if own_mesh:
        seconds["shape"] = 0.0
    elapsed, total = start, start + sum(seconds.values())
    for stage in STAGES:
        low, high = SHARES[stage]
        for step in range(4):
            now = elapsed + seconds[stage] * step / 4
            yield LOADING_SHARE + (1 - LOADING_SHARE) * (low + (high - low) * step / 4) + 1e-9, now, total - now
        elapsed += seconds[stage]


@pytest.mark.parametrize("own_mesh", [False, True])
def test_a_run_as_fast_as_the_measured_one_is_foretold_exactly(own_mesh):
    guess = Remaining("small", "balanced", own_mesh)
    for fraction, elapsed, left in reports("small", 1.0, own_mesh):
        assert guess.seconds(fraction, elapsed) == pytest.approx(left, abs=1e-3)


@pytest.mark.parametrize("slowness", [0.25, 5.0])
def test_on_another_machine_the_guess_comes_nearer_and_nearer(slowness):
    guess, errors = Remaining("small", "balanced", False), []
    for fraction, elapsed, left in reports("small", slowness):
        errors.append(abs(guess.seconds(fraction, elapsed) - left))
    assert errors == sorted(errors, reverse=True) and errors[-1] < 0.1 * errors[0]


def test_of_a_preset_that_was_not_measured_nothing_is_said_at_first():
    guess = Remaining("paper", "final", False)
    assert guess.seconds(0.0, 1.0) is None
    assert guess.seconds(LOADING_SHARE + 0.1, 10.0) is not None
    assert guess.seconds(1.0, 60.0) == pytest.approx(0.0)


def test_seconds_read_as_on_a_stopwatch():
    assert [clock(s) for s in (0.4, 59.6, 60.0, 3725.0)] == ["0:00", "1:00", "1:00", "62:05"]
