"""docs/train-it-yourself.md: its words are known, its files fit together, and `make test-train` follows it."""

import csv
import importlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

import training.__main__ as command
from arm_blender import networks
from arm_blender.__main__ import parser as arm_parser
from arm_blender.config import Settings
from arm_blender.models.small.instant_albedo import SMALL
from arm_blender.models.small.volume_georm import VolumeGeoRMConfig
from arm_blender.weight_files import checkpoints
from training.datasets import atlases
from training.datasets.point_samples import is_held_out
from training.stages import instant_albedo
from training.stages.instant_albedo_start import Start

ROOT = Path(command.__file__).parents[1]
PAGE = ROOT / "docs" / "train-it-yourself.md"
SOURCES = ("data", "own")
"""Where the objects come from: each has a block of its own in the page."""


def blocks(source: str) -> list[tuple[str, str]]:
    """What is to be run, in order, with the word after ```sh: "", "kill" or `source`."""
    found = re.findall(r"^```sh ?(\w*)\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert {kind for kind, _ in found} == {"", "kill", *SOURCES}
    return [(kind, text) for kind, text in found if kind in ("", "kill", source)]


def commands(texts: list[str]) -> list[list[str]]:
    """The words after `python -m`, of every command."""
    lines = "".join(texts).replace("\\\n", " ").splitlines()
    return [shlex.split(line.rstrip("& "))[2:] for line in lines if line.startswith("python -m ")]


def fits(texts: list[str]) -> dict[str, list[str]]:
    """Name of each output of a `fit`, and the command that makes it."""
    words = [each for each in commands(texts) if each[:2] == ["training", "fit"]]
    return {Path(each[each.index("--output") + 1]).stem: each for each in words}


PAPER = ("georm-volume", "georm-surface", "glossyrm")
FITS = fits([text for _, text in blocks("own")])


@pytest.fixture
def understood(monkeypatch):
    """Reads a command as the program does, without doing it."""
    monkeypatch.delenv("ARM_DATA", raising=False)

    def read(words: list[str]) -> Namespace:
        if words[0] == "arm_blender":
            return arm_parser().parse_args(words[1:])
        table, name = (command.STAGES, words[2]) if words[1] == "fit" else (command.COMMANDS, words[1])
        asked: list[Namespace] = []
        monkeypatch.setattr(importlib.import_module(table[name][0]), "run", lambda args: asked.append(args) or 0)
        assert command.main(words[1:]) == 0, words
        return asked[0]

    return read


@pytest.mark.parametrize("source", SOURCES)
def test_every_command_is_known_and_reads_what_an_earlier_one_wrote(understood, source):
    written: set[Path] = set()
    for kind, text in blocks(source):
        for words in commands([text]):
            args = vars(understood(words))
            for name in ("start", "georm", "material_prior", "shards", "views"):
                path = args.get(name)
                if isinstance(path, Path) and not (ROOT / path).exists():
                    assert path in written, f"{shlex.join(words)}: nothing has written {path}"
            if args.get("weights"):
                made = {path for path in written if path.parent == args["weights"]}
                trained = Settings().networks
                assert {path.name for path in made} == {Settings().weights(name).name for name in trained}
            if "output" in args and kind != "kill":
                written.add(args["output"])


def test_every_stage_is_there_and_takes_fifty_steps(understood):
    everything = fits([text for _, text in blocks("data")])  # Captures need its textures.
    asked = [(words[2], understood(words)) for words in everything.values()]
    assert [stage for stage, _ in asked] == list(command.STAGES)
    # So a row of scalars.csv is the mean of the first ten steps, and one of the last ten.
    # The finish is fitted in closed form.
    assert all((args.steps, args.log_every) == (50, 10) for stage, args in asked if stage != "finish")
    # The paper's stages train the paper's networks; InstantAlbedo's stage has no other preset.
    assert all(getattr(args, "preset", "small") == ("tiny" if stage in PAPER else "small") for stage, args in asked)


def test_the_killed_run_goes_on_with_the_same_words():
    killed = [words for kind, text in blocks("own") if kind == "kill" for words in commands([text])]
    assert len(killed) == 1 and killed[0] in FITS.values()


def textured(folder: Path, name: str, mesh: trimesh.Trimesh, seed: int) -> None:
    """A GLB with a chequered colour and maps of roughness and metallic."""
    draws = np.random.default_rng(seed)
    colors = draws.integers(30, 230, (2, 3))
    cells = (np.indices((16, 16)) // 8).sum(axis=0) % 2
    gloss = np.stack([np.zeros_like(cells), 60 + 120 * cells, 255 * (cells if seed % 3 == 0 else 0 * cells)], axis=-1)
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(colors[cells].astype(np.uint8)),
        metallicRoughnessTexture=Image.fromarray(gloss.astype(np.uint8)),
    )
    uv = 1.5 * (mesh.vertices[:, :2] + 0.5 * mesh.vertices[:, 2:])
    mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    folder.mkdir(parents=True, exist_ok=True)
    mesh.export(folder / f"{name}.glb")


def own_objects(folder: Path) -> Path:
    """A few solids with textures, one of which the stages hold out; two of them to evaluate on."""
    creation = trimesh.creation
    shapes = {
        "box": creation.box((1.0, 0.6, 0.8)),
        "ball": creation.icosphere(subdivisions=3, radius=0.5),
        "can": creation.cylinder(0.4, 1.0, sections=32),
        "pill": creation.capsule(0.8, 0.3, count=(16, 16)),
        "ring": creation.torus(0.6, 0.2),
        "cone": creation.cone(0.5, 1.0, sections=32),
        "pipe": creation.annulus(0.3, 0.5, 0.8, sections=32),
    }
    held_out = next(f"ellipsoid_{k}" for k in range(1000) if is_held_out(Path(f"ellipsoid_{k}", "rig_0.npz")))
    shapes[held_out] = creation.icosphere(subdivisions=3).apply_scale((0.3, 0.5, 0.7))
    for seed, (name, mesh) in enumerate(shapes.items()):
        textured(folder / "train", name, mesh, seed)
    textured(folder / "eval", "brick", creation.box((0.5, 1.0, 0.4)), 20)
    textured(folder / "eval", "bead", creation.icosphere(subdivisions=3).apply_scale((0.5, 0.5, 0.4)), 21)
    return folder


def environment(objects: Path) -> dict[str, str]:
    """As after `. .venv/bin/activate`, from any folder."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    data = {name: str(Path(os.environ[name]).resolve()) for name in ["ARM_DATA"] if os.environ.get(name)}
    return dict(os.environ, **data, PATH=path, PYTHONPATH=str(ROOT), OBJECTS=str(objects))


def follow(text: str, folder: Path, objects: Path) -> None:
    """Run one block."""
    done = subprocess.run(
        ["bash", "-euc", text], cwd=folder, env=environment(objects), text=True, capture_output=True, check=False
    )
    with open(folder / "log.txt", "a", encoding="utf-8") as log:
        log.write(f"$ {text}{done.stdout}{done.stderr}")
    assert done.returncode == 0, f"{text}{done.stdout[-2000:]}{done.stderr[-4000:]}"


@pytest.fixture(scope="module")
def followed(tmp_path_factory) -> Path:
    """The folder in which the page was followed."""
    pytest.importorskip("bpy")
    folder = tmp_path_factory.mktemp("first")
    (folder / "arm_blender").mkdir()  # No package without its `__init__`: the installed one is imported.
    (folder / "arm_blender" / "examples").symlink_to(ROOT / "arm_blender" / "examples", target_is_directory=True)
    objects = own_objects(folder / "objects")
    for kind, text in blocks("data" if os.environ.get("ARM_DATA") else "own"):
        follow(text, folder, objects)
        if kind == "kill":
            output = Path(commands([text])[0][commands([text])[0].index("--output") + 1])
            assert not (folder / output).exists(), "the run ended before it was killed"
    return folder


def scalars(output: Path) -> list[tuple[int, str, str, float]]:
    """The rows of a run: step, kind, name, value."""
    with open(output.parent / "runs" / output.stem / "scalars.csv", newline="", encoding="utf-8") as file:
        return [(int(step), kind, name, float(value)) for step, kind, name, value in list(csv.reader(file))[1:]]


def output_of(name: str) -> Path:
    return Path(FITS[name][FITS[name].index("--output") + 1])


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in FITS if name != "small.finish"])  # It takes no steps.
def test_fifty_steps_lower_the_loss(followed, name):
    means = {(step, key): x for step, kind, key, x in scalars(followed / output_of(name)) if kind == "mean"}
    losses = {step: means[step, "loss"] for step in (10, 50)}
    if name == "small.instant_albedo":  # Its samples differ more than it learns.
        losses = losses_on_the_same_samples(followed)
    elif (10, "blend") in means:  # Against what delighting begins with.
        losses = {step: loss / means[step, "blend"] for step, loss in losses.items()}
    assert losses[50] < losses[10], f"{name}: {losses}"


@torch.no_grad()
def losses_on_the_same_samples(folder: Path) -> dict[int, float]:
    """InstantAlbedo's loss over all its samples, before its first step (under 10) and after its last."""
    words = FITS["small.instant_albedo"]
    prior, delighting, cache, output = (
        folder / words[words.index(word) + 1] for word in ("--material-prior", "--delighting", "--cache", "--output")
    )
    start = Start(SMALL, material_prior=prior, delighting=delighting)
    models = {10: start.network(), 50: networks.read("instant_albedo", output)}
    samples, _ = instant_albedo.split(atlases.files(cache), instant_albedo.Samples.held_out)
    config, losses = instant_albedo.FitConfig(), dict.fromkeys(models, 0.0)
    for step, model in models.items():
        for path in samples:
            random = torch.Generator().manual_seed(0)
            losses[step] += float(instant_albedo.sample_loss(model, atlases.load(path, 0), config, random)[0])
    return losses


@pytest.mark.slow
@pytest.mark.long
def test_the_killed_run_ends_as_an_unbroken_one(followed):
    name = next(iter(FITS))
    (followed / "unbroken").mkdir()
    text = shlex.join(["python", "-m", *FITS[name]]).replace(str(output_of(name)), f"unbroken/{name}.safetensors")
    follow(text, followed, followed)
    broken, unbroken = followed / output_of(name), followed / "unbroken" / f"{name}.safetensors"
    one, other = (checkpoints.load(path, VolumeGeoRMConfig)[1] for path in (broken, unbroken))
    assert one.keys() == other.keys() and all(torch.equal(one[key], other[key]) for key in one)
    rows = [[row for row in scalars(path) if row[1] == "mean"] for path in (broken, unbroken)]
    assert rows[0] == rows[1] and {step for step, *_ in rows[0]} == {10, 20, 30, 40, 50}


@pytest.mark.slow
@pytest.mark.long
def test_the_weights_are_measured_and_make_an_asset(followed):
    results = json.loads((followed / "out" / "first" / "evaluation" / "results.json").read_text())
    assert len(results["objects"]) >= 2 and 0.0 < results["mean"]["ours"]["f_coarse"] <= 1.0
    report = json.loads((followed / "out" / "first" / "barrel" / "report.json").read_text())
    own = {name for name, licence in report["weights"].items() if licence == "your own"}
    assert own == {"small.georm", "small.instant_albedo"} and report["faces"] > 100
    shutil.rmtree(followed / "out" / "first" / "cache")  # The largest part; pytest keeps the rest of the last runs.
