"""The table of the user interface: what misses its bar says so."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def tool(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import window_table

    return window_table


def run_of(longest: float, left: int = 0) -> dict:
    gap = {"longest": longest, "p95": longest / 2, "number": 9}
    return {
        "seconds": 8.0,
        "error": "",
        "made": 1,
        "left after undo": left,
        "intervals": {"timer events": gap},
        "silences": {"reading": 0.3},
    }


def stop_of(said: float | None, ended: float) -> dict:
    return {"stages": {"reading": {"said": said, "ended": ended, "stopped": True}}}


@pytest.mark.parametrize("longest, left, missed", [(0.25, 0, 0), (0.26, 0, 1), (0.1, 1, 1)])
def test_a_freeze_and_what_undo_leaves_are_missed_bars(tool, longest, left, missed):
    lines = tool.checks({"run": run_of(longest, left)})
    assert [line.held for line in lines].count(False) == missed
    assert tool.table(lines).count("**missed**") == missed


@pytest.mark.parametrize(
    "said, ended, held", [(0.1, 0.9, True), (0.3, 0.9, False), (0.1, 1.1, False), (None, 0.2, True), (None, 0.3, False)]
)
def test_a_stop_is_said_and_made_in_time(tool, said, ended, held):
    (line,) = tool.checks({"cancel": stop_of(said, ended)})
    assert line.held == held


def test_the_page_states_machine_and_silences(tool):
    page = tool.document({"run": run_of(0.1)}, "A machine of its own")
    assert "A machine of its own" in page and "| reading | 0.30 s |" in page
    assert "Without a result: example, cancel, load, quit, disable, engines, photographs, doubtful, materials." in page


@pytest.mark.parametrize("change, missed", [({}, 0), ({"editors": ["VIEW"]}, 1), ({"cameras": 3, "browser": False}, 2)])
def test_photographs_that_are_not_listed_solved_or_painted_are_missed_bars(tool, change, missed):
    rows = [[f"IMG_{index}.png", f"IMG_{index}.png", "painted mask" if index == 0 else "alpha"] for index in range(12)]
    found = {"browser": True, "listed": 12, "cameras": 12, "ground": True, "seconds": 30.0, "rows": rows}
    found |= {"editors": ["PAINT", "VIEW"], "painted": True, "made": 1, "error": "", "rows after": rows} | change
    assert [line.held for line in tool.checks({"photographs": found})].count(False) == missed


@pytest.mark.parametrize("eevee, held", [(0.46, True), (0.54, True), (0.44, False), (0.56, False)])
def test_two_engines_agree_within_a_tenth(tool, eevee, held):
    (line,) = tool.checks({"engines": {"mean colors": {"studio": {"cycles": [0.5] * 3, "eevee": [eevee] * 3}}}})
    assert line.held == held


@pytest.mark.parametrize("doubts, held", [(["002.png does not fit the others"], True), ([], False)])
def test_a_doubtful_result_has_to_say_so(tool, doubts, held):
    (line,) = tool.checks({"doubtful": {"doubts": doubts}})
    assert line.held == held


@pytest.mark.parametrize(
    "change, missed",
    [({}, 0), ({"picked": 1}, 2), ({"left by Esc": False}, 1), ({"left after undo": 1}, 1), ({"set": {}}, 1)],
)
def test_a_region_that_is_not_picked_or_not_undone_is_a_missed_bar(tool, change, missed):
    found = {"regions": 3, "panel": True, "left by Esc": True, "expected": 2, "picked": 2, "set": {"2": 1.0}}
    found |= {"left after undo": 0} | change
    assert [line.held for line in tool.checks({"materials": found})].count(False) == missed
    assert "images/materials.png" in tool.document({"run": run_of(0.1), "materials": found}, "a machine")


@pytest.mark.parametrize(
    "change, missed",
    [({}, 0), ({"views": 0}, 1), ({"made": 0}, 1), ({"hidden by": ""}, 1), ({"path after two undos": "barrel"}, 1)],
)
def test_two_clicks_that_make_nothing_or_cannot_be_undone_are_missed_bars(tool, change, missed):
    found = {"path": "barrel", "views": 6, "kind": "posed", "seconds": 20.0, "error": "", "hidden by": "Cube"}
    found |= {"made": 1, "path after two undos": ""} | change
    assert [line.held for line in tool.checks({"example": found})].count(False) == missed
    assert "images/panel-example.png" in tool.document({"run": run_of(0.1), "example": found}, "a machine")
