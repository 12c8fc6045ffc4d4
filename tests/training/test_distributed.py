"""Two processes with half of the samples each take the step that one process takes with all of them."""

import itertools
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from arm_blender.errors import ArmError
from training import distributed

WORKER = """
import sys
from pathlib import Path

import torch
from training import distributed
from training.trainer import Trainer, TrainerConfig

model = torch.nn.Linear(1, 1)
with torch.no_grad():
    model.weight.fill_(0.5)
    model.bias.fill_(0.0)
unused = torch.nn.Parameter(torch.zeros(3))
model.register_parameter("unused", unused)
model.register_parameter("frozen", torch.nn.Parameter(torch.ones(3), requires_grad=False))
folder = Path(sys.argv[1])
config = TrainerConfig(minutes=0.05, learning_rate=0.05, warmup_steps=1, weight_decay=0.5, log_every=1000)
trainer = Trainer(model, config, folder / "line.resume")
x = torch.linspace(-1, 1, 20)[distributed.rank()::2][:, None]
gradients = []


def loss(step):
    if step == 1:
        gradients.append(model.weight.grad.clone())
    return (model(x) - (2.0 * x + 1.0)).square().mean(), {}


trainer.run(loss, lambda m: {})
torch.save({"model": model.state_dict(), "step": trainer.step, "gradient": gradients[0]},
           folder / f"rank{distributed.rank()}.pt")
"""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_two_processes_share_every_step_and_one_of_them_writes(tmp_path):
    root = Path(__file__).parents[2]
    common = {**os.environ, "WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(free_port())}
    workers = [
        subprocess.Popen(
            [sys.executable, "-c", WORKER, str(tmp_path)],
            env={**common, "RANK": str(rank), "PYTHONPATH": str(root), "OMP_NUM_THREADS": "1"},
            stderr=subprocess.PIPE,
        )
        for rank in range(2)
    ]
    for worker in workers:
        _, error = worker.communicate(timeout=120)
        assert worker.returncode == 0, error.decode()[-2000:]
    first, second = (torch.load(tmp_path / f"rank{rank}.pt") for rank in range(2))
    assert first["step"] == second["step"] > 1
    for key, value in first["model"].items():
        assert torch.equal(value, second["model"][key])
    assert torch.equal(first["model"]["frozen"], torch.ones(3))
    # The gradient of the mean squared error over all twenty samples, at weight 1/2 and bias 0.
    x = torch.linspace(-1, 1, 20)
    expected = (2.0 * (0.5 * x - (2.0 * x + 1.0)) * x).mean()
    # The trainer clips to norm 1; the direction stays.
    bias = (2.0 * (0.5 * x - (2.0 * x + 1.0))).mean()
    scale = min(1.0, 1.0 / float(torch.hypot(expected, bias)))
    assert torch.allclose(first["gradient"].flatten(), expected * scale, atol=1e-5)
    assert (tmp_path / "line.resume").exists()


@pytest.mark.parametrize(("processes", "count", "batch"), [(1, 7, 2), (3, 10, 1), (2, 5, 4)])
def test_all_processes_together_take_each_sample_once_before_any_comes_again(monkeypatch, processes, count, batch):
    monkeypatch.setenv("WORLD_SIZE", str(processes))
    taken = []
    for step in range(4 * count):
        for rank in range(processes):
            monkeypatch.setenv("RANK", str(rank))
            taken += distributed.share(count, 3, step, batch)
    turns = [taken[first : first + count] for first in range(0, len(taken) - count + 1, count)]
    assert all(sorted(turn) == list(range(count)) for turn in turns)
    assert len({tuple(turn) for turn in turns}) > 1  # Each time in another order.


def test_seeds_processes_and_steps_draw_apart_and_each_the_same_again(monkeypatch):
    drawn = []
    for _ in range(2):
        for process in range(3):
            monkeypatch.setenv("RANK", str(process))
            for seed, step in itertools.product(range(3), range(3)):
                drawn.append(tuple(torch.rand(4, generator=distributed.generator(seed, step)).tolist()))
    assert drawn[:27] == drawn[27:] and len(set(drawn)) == 27
    orders = {tuple(distributed.share(50, seed, 0, 50)) for seed in range(3)}
    assert len(orders) == 3


def test_a_device_that_is_not_there_is_one_line():
    with pytest.raises(ArmError, match="--device tpu: torch finds none here; choose cpu"):
        distributed.device("tpu")
