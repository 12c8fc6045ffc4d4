"""Which attempts are made: from cheap to thorough, and none that could not be better."""

import pytest
import torch

from arm_blender.photographs.cameras import attempts
from arm_blender.photographs.cameras.trust import Trust
from arm_blender.progress import silent

FOUND = {"registered": 1.0, "allowed": 0.9, "contradicted": 0.15, "agreement": 0.8, "apart": 0.001}


class _Job:
    focal_is_known = True


@pytest.fixture
def tried(monkeypatch):
    """Names of the ways that were matched; each ends doubtful, with the measures that a test sets."""
    ways: list[str] = []
    jobs = [(way, _Job()) for way in ("object and ground", "whole picture", "object")]
    monkeypatch.setattr(attempts, "_jobs", lambda *_: iter(jobs))
    monkeypatch.setattr(attempts, "match", lambda job, _: ways.append(next(w for w, j in jobs if j is job)))
    monkeypatch.setattr(attempts, "solve", lambda *_: ([None], [["0"]]))
    monkeypatch.setattr(attempts, "_chosen", lambda fits, _: fits[0])
    monkeypatch.setattr(attempts, "solve_again", lambda *_: None)
    monkeypatch.setattr(attempts, "compared", lambda trust, *_: trust)
    return ways


def _try(monkeypatch, **measures):
    trust = Trust("doubtful", ("some pictures contradict each other",), FOUND | measures)
    hull = torch.zeros(1)  # Only whether there is one is asked.
    monkeypatch.setattr(attempts, "_judged", lambda way, *_: attempts.Attempt(way, None, [], hull, trust, []))
    return attempts.best_attempt([], None, 1, 0, silent)


def test_a_thing_that_stands_still_is_not_solved_without_its_surroundings(monkeypatch, tried):
    assert _try(monkeypatch).way == "object and ground"
    assert tried == ["object and ground", "whole picture"]


@pytest.mark.parametrize("measures", [{"agreement": 0.6}, {"registered": 0.8}, {"apart": 0.1}])
def test_one_that_may_have_turned_is(monkeypatch, tried, measures):
    _try(monkeypatch, **measures)
    assert tried == ["object and ground", "whole picture", "object"]
