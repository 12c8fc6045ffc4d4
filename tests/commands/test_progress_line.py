"""Stage, share and time left, on a terminal and off one; the clock is the test's."""

import io

import pytest

from arm_blender.commands.progress_line import Counted, ProgressLine, rest_of


def test_a_terminal_is_written_to_only_for_what_is_new():
    """Before each block of a network the same report comes again."""
    stream = io.StringIO()
    stream.isatty = lambda: True
    line = ProgressLine(stream)
    for fraction, message in [(0.0, "a"), (0.0, "a"), (0.5, "a"), (0.5, "a"), (0.5, "b")]:
        line(fraction, message)
    assert stream.getvalue().split("\r\x1b[K") == ["", "  0% a", " 50% a", " 50% b"]
    line.clear()
    line(0.5, "b")
    assert stream.getvalue().endswith(" 50% b")


def lines_of(reports, quiet: float = 0.0) -> list[str]:
    """What is written off a terminal of (seconds, fraction, message)."""
    stream, now = io.StringIO(), iter([report[0] for report in reports])
    line = ProgressLine(stream, quiet, lambda: next(now))
    for _, fraction, message in reports:
        line(fraction, message)
    return stream.getvalue().splitlines()


def test_lines_tell_the_stage_the_share_and_the_time_left():
    reports = [(0.0, 0.0, "a"), (1.0, 0.1, "a"), (3.0, 0.2, "b"), (6.0, 0.3, "b"), (30.0, 0.3, "c"), (40.0, 0.5, "c")]
    assert lines_of(reports) == [
        "  0% a", " 20% b, about 12 s left", " 30% c, about 70 s left", " 50% c, about 40 s left",
    ]  # fmt: skip


def test_a_run_of_less_than_two_seconds_writes_no_lines():
    reports = [(0.0, 0.0, "a"), (1.0, 0.5, "b"), (1.9, 1.0, "c")]
    assert lines_of(reports, quiet=2.0) == [] and len(lines_of(reports)) == 3
    assert lines_of([*reports[:2], (3.0, 0.5, "c")], quiet=2.0) == [" 50% c, about 3 s left"]


@pytest.mark.parametrize(
    ("seconds", "fraction", "begun_at", "wanted"),
    [(600.0, 0.5, 0.0, ", about 10 min left"), (36000.0, 0.25, 0.0, ", about 30 h left"), (9.0, 1.0, 0.0, ""),
     (100.0, 0.6, 0.5, ", about 7 min left"), (100.0, 0.001, 0.0, ""), (1.0, 0.5, 0.0, "")],
)  # fmt: skip
def test_the_time_left_is_as_long_as_what_was_done_says(seconds, fraction, begun_at, wanted):
    """Of a run that goes on, only what was done since then says anything."""
    assert rest_of(seconds, fraction, begun_at) == wanted


def test_items_are_counted_with_the_time_left():
    said, now = [], iter([0.0, 30.0, 60.0])
    count = Counted(2, said.append, lambda: next(now))
    count("cup")
    count("jug")
    assert said == ["1 of 2, cup, about 30 s left", "2 of 2, jug"]
