"""What a run says of itself where no terminal shows it."""

import logging

from training import run_record
from training.run_record import RunRecord


def test_a_long_silence_is_broken_by_how_far_the_run_is(tmp_path, monkeypatch, caplog):
    clock = [0.0]
    monkeypatch.setattr(run_record.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(run_record.sys.stderr, "isatty", lambda: False, raising=False)
    record = RunRecord(tmp_path / "run")
    with caplog.at_level(logging.INFO, logger="training.run_record"):
        for clock[0], step in [(30.0, 1), (70.0, 2), (100.0, 3), (140.0, 4)]:
            record.show(step / 8, f"step {step}")
    assert caplog.messages == ["25%, step 2", "50%, step 4"]
