"""A run that is killed goes on as if it had not been; what it records is whole."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from training.run_record import RunRecord

WORKER = """
import sys, time
from pathlib import Path

import torch
from training import distributed
from training.run_record import RunRecord
from training.trainer import Trainer, TrainerConfig

torch.set_num_threads(1)
torch.manual_seed(0)
folder, pause = Path(sys.argv[1]), float(sys.argv[2])
nn = torch.nn
model = nn.Sequential(nn.Linear(3, 8), nn.Dropout(0.3), nn.BatchNorm1d(8), nn.Linear(8, 1))
config = TrainerConfig(steps=120, warmup_steps=5, log_every=4, save_every_minutes=0.1 / 60.0)
trainer = Trainer(model, config, folder / "run.resume", RunRecord(folder / "run"))


def loss(step):
    time.sleep(pause)
    x = torch.rand(16, 3, generator=distributed.generator(0, step)) + 0.1 * torch.rand(16, 3)
    return (model(x) - x.sum(dim=1, keepdim=True)).square().mean(), {}


def validate(averaged):
    with torch.no_grad():
        return {"error": float((averaged(torch.ones(1, 3)) - 3.0).abs())}


trainer.run(loss, validate)
"""


def start(folder: Path, pause: float) -> subprocess.Popen:
    folder.mkdir(exist_ok=True)
    root = str(Path(__file__).parents[2])
    environment = {**os.environ, "PYTHONPATH": root, "OMP_NUM_THREADS": "1"}
    return subprocess.Popen([sys.executable, "-c", WORKER, str(folder), str(pause)], env=environment)


def rows(folder: Path, kind: str = "mean") -> list[list[str]]:
    with open(folder / "run" / "scalars.csv", newline="") as file:
        return [row for row in csv.reader(file) if row[1] == kind]


@pytest.mark.long
def test_a_killed_run_goes_on_with_the_losses_of_an_unbroken_one(tmp_path):
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    assert start(whole, 0.0).wait(timeout=120) == 0
    worker = start(broken, 0.03)
    deadline = time.monotonic() + 60.0
    while not ((broken / "run.resume").exists() and len(rows(broken)) > 20) and time.monotonic() < deadline:
        time.sleep(0.02)
    worker.send_signal(signal.SIGKILL)
    assert worker.wait(timeout=60) == -signal.SIGKILL
    reached = torch.load(broken / "run.resume", weights_only=True)["step"]
    assert 0 < reached < 120
    assert start(broken, 0.0).wait(timeout=120) == 0
    # To the last digit; the means of a window that the kill fell into as well.
    assert rows(broken) == rows(whole)
    assert rows(broken, "validation")[-1] == rows(whole, "validation")[-1]
    ends = [torch.load(folder / "run.resume", weights_only=True)["averaged"] for folder in (whole, broken)]
    assert all(torch.equal(value, ends[1][key]) for key, value in ends[0].items())


def test_what_came_after_the_step_that_a_run_goes_on_from_is_forgotten(tmp_path):
    record = RunRecord(tmp_path / "run", {"shards": Path("somewhere"), "seed": 3, "start": None})
    for step in (10, 20, 30):
        record.scalars(step, "mean", {"loss": 1.0 / step})
    with open(tmp_path / "run" / "scalars.csv", "a") as file:
        file.write("40,me")  # As a kill leaves it.
    record.rewind(20)
    assert rows(tmp_path) == [["10", "mean", "loss", "0.1"], ["20", "mean", "loss", "0.05"]]
    config = json.loads((tmp_path / "run" / "config.json").read_text())
    assert config["arguments"] == {"shards": "somewhere", "seed": 3, "start": None}
    assert config["versions"]["torch"] == torch.__version__


def test_a_picture_is_kept_as_it_is(tmp_path):
    from PIL import Image

    record = RunRecord(tmp_path / "run")
    picture = torch.rand(3, 4, 6, generator=torch.Generator().manual_seed(0))
    record.picture(5, picture)
    record.close()
    with Image.open(tmp_path / "run" / "validation.png") as image:
        assert image.size == (6, 4)
        assert image.getpixel((2, 1)) == tuple((picture[:, 1, 2] * 255).round().int().tolist())


def test_tensorboard_shows_scalars_and_pictures(tmp_path):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    record = RunRecord(tmp_path / "run")
    record.scalars(10, "mean", {"loss": 0.25})
    record.picture(10, torch.zeros(3, 8, 8))
    record.close()
    events = EventAccumulator(str(tmp_path / "run"))
    events.Reload()
    assert [(event.step, event.value) for event in events.Scalars("mean/loss")] == [(10, 0.25)]
    assert len(events.Images("validation")) == 1


def test_without_tensorboard_it_is_said_once(tmp_path, monkeypatch, caplog):
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    monkeypatch.delitem(sys.modules, "torch.utils.tensorboard", raising=False)
    record = RunRecord(tmp_path / "run")
    with caplog.at_level("INFO"):
        record.scalars(10, "mean", {"loss": 0.25, "rate": 1.0})
        record.scalars(20, "mean", {"loss": 0.125})
    assert caplog.text.count("pip install tensorboard") == 1
