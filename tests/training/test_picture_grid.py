"""Pictures side by side: each where it belongs, and a line on a terminal that makes way for the log."""

import io
import sys

import torch

from training.losses import SurfaceMaps
from training.picture_grid import grid, normals
from training.run_record import RunRecord


def test_every_picture_is_in_its_row_and_column():
    draws = torch.Generator().manual_seed(0)
    colors, grey = torch.rand(3, 3, 4, 4, generator=draws), torch.rand(2, 1, 8, 8, generator=draws)
    sheet = grid([colors, grey], 4)
    assert sheet.shape == (3, 8, 12)
    assert torch.equal(sheet[:, :4, 4:8], colors[1])
    mean = grey[1, 0].view(4, 2, 4, 2).mean(dim=(1, 3))  # Made smaller: means, not single pixels.
    torch.testing.assert_close(sheet[:, 4:, 4:8], mean.expand(3, -1, -1))
    assert bool((sheet[:, 4:, 8:] == 1.0).all())


def test_normals_are_colours_on_white():
    mask = torch.tensor([[[1.0, 0.0, 0.5]]])
    normal = torch.tensor([0.0, 0.0, 1.0])[None, :, None, None] * mask[:, None]
    shown = normals(SurfaceMaps(mask, mask, normal))[0, :, 0]
    assert shown.T.tolist() == [[0.5, 0.5, 1.0], [1.0, 1.0, 1.0], [0.75, 0.75, 1.0]]


def test_a_terminal_shows_how_far_a_run_is(monkeypatch, caplog):
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    record = RunRecord(None)
    record.show(0.25, "step 5, loss 0.1")
    with caplog.at_level("INFO"):
        record.line("mean: %s", "loss")
    assert "25% step 5, loss 0.1" in terminal.getvalue() and "mean: loss" in caplog.text
    assert terminal.getvalue().endswith("\r\x1b[K")  # Gone before the line of the log.
