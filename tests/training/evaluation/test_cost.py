"""What a user pays is measured of the very trial, its own weights and knobs among it."""

import math
from types import SimpleNamespace

from arm_blender.__main__ import parser
from arm_blender.config import Settings
from training.evaluation import cost
from training.evaluation.trials.trial import Trial
from training.evaluation.truth.protocol import Protocol


def test_a_cold_start_takes_the_words_of_the_trial(monkeypatch, tmp_path):
    asked = []

    def answered(words, **options):
        asked.append(words)
        return SimpleNamespace(returncode=1, stderr="cup: no views")

    monkeypatch.setattr(cost.subprocess, "run", answered)
    own = tmp_path / "own"
    own.mkdir()
    (own / "small.georm.safetensors").touch()
    settings = Settings(quality="draft", grid=40, faces=777, refinement=1, weights_folder=own)
    found = cost.measured_cost(tmp_path, Trial(settings, Protocol()))
    assert math.isnan(found.cold) and math.isnan(found.warm)  # Neither ended well: there are no views.
    words = parser().parse_args(asked[0][3:])  # What follows `python -m arm_blender`.
    assert (words.views, words.weights_folder) == (tmp_path, own)
    assert (words.preset, words.quality, words.grid, words.faces, words.refinement) == ("small", "draft", 40, 777, 1)
