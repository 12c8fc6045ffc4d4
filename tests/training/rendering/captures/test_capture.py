"""A capture from a file of an object: pictures, and a truth that fits them."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from arm_blender.graphics.cameras import Camera
from arm_blender.graphics.raster.rasterize import rasterize_views
from training.__main__ import main
from training.evaluation.truth.objects import EvaluationObject

bpy = pytest.importorskip("bpy")

pytestmark = [pytest.mark.blender, pytest.mark.slow]


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    """A data folder: a tilted box, two grounds, two environments."""
    folder = tmp_path_factory.mktemp("data")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_cube_add(size=1.0, scale=(1.0, 0.5, 0.8), rotation=(0.2, 0.3, 0.4))
    bpy.ops.export_scene.gltf(filepath=str(folder / "box.glb"))
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)
    Image.fromarray(noise).save(folder / "ground.png")
    sky = bpy.data.images.new("sky", 16, 8, float_buffer=True)
    sky.pixels = [0.5, 0.6, 0.7, 1.0] * 128
    sky.file_format, sky.filepath_raw = "HDR", str(folder / "sky.hdr")
    sky.save()
    both = ("train", "eval")
    manifest = {
        "objects": [{"id": "box", "split": s, "set": "flat", "main": "box.glb"} for s in both],
        "textures": [{"id": f"ground_{s}", "split": s, "maps": {"basecolor": "ground.png"}} for s in both],
        "hdris": [{"id": "sky", "split": s, "files": ["sky.hdr"]} for s in both],
    }
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


def render(data: Path, output: Path, *words: str) -> int:
    fast = ["--resolution", "96", "--samples", "1", "--no-denoise", "--cpu"]
    return main(["render", "--data", str(data), "--split", "eval", "--output", str(output), *fast, *words])


def test_the_mesh_seen_by_the_true_cameras_is_where_the_masks_are(data, tmp_path):
    assert render(data, tmp_path, "--layout", "capture", "--pictures", "12") == 0
    folder = tmp_path / "box-0"
    truth = json.loads((folder / "truth.json").read_text())
    assert len(truth["pictures"]) == len(list((folder / "images").iterdir())) == 12
    mesh = EvaluationObject("box", folder).truth()
    assert float((mesh.vertices.amax(0) - mesh.vertices.amin(0)).max()) == pytest.approx(2.0, abs=1e-4)
    for entry in truth["pictures"]:
        focal, cx, cy = entry["lens"]["parameters"]
        K = torch.tensor([[focal, 0.0, cx], [0.0, focal, cy], [0.0, 0.0, 1.0]])
        camera = Camera(torch.tensor(entry["c2w"], dtype=torch.float32), K, 96, 72)
        seen = rasterize_views(mesh.vertices, mesh.faces, [camera]).mask[0]
        mask = torch.from_numpy(np.array(Image.open(folder / entry["mask"]))) > 127
        assert mask.any() and float((seen & mask).sum() / (seen | mask).sum()) > 0.93
    before = (folder / "truth.json").stat().st_mtime_ns
    assert render(data, tmp_path, "--layout", "capture", "--pictures", "12") == 0  # Whole: kept.
    assert (folder / "truth.json").stat().st_mtime_ns == before


def test_scenes_have_masks_and_an_empty_place(data, tmp_path):
    assert render(data, tmp_path, "--layout", "scenes", "--pictures", "3") == 0
    with np.load(tmp_path / "box.npz") as file:
        rgb, mask = file["rgb"], file["mask"]
    assert rgb.shape == (4, 96, 96, 3) and mask.shape == (4, 96, 96)
    assert (mask[:-1] > 127).any(axis=(1, 2)).all() and not mask[-1].any()


def test_a_capture_out_of_range_is_refused_in_one_line(data, tmp_path, capsys):
    assert render(data, tmp_path, "--layout", "capture", "--pictures", "3") == 1
    assert "--pictures 3" in capsys.readouterr().err


def test_things_around_are_no_object(data, tmp_path):
    words = ["--layout", "capture", "--pictures", "12"]
    assert render(data, tmp_path / "alone", *words) == render(data, tmp_path / "around", *words, "--clutter") == 0
    assert render(data, tmp_path / "beside", *words, "--spoilt", "two") == 0
    alone = tmp_path / "alone" / "box-0"
    for other in (tmp_path / "around" / "box-0", tmp_path / "beside" / "box-two"):
        truths = [json.loads((folder / "truth.json").read_text())["pictures"] for folder in (alone, other)]
        assert [entry["c2w"] for entry in truths[0]] == [entry["c2w"] for entry in truths[1]]
        different = 0.0
        for entry in truths[0]:
            masks, images = [], []
            for folder in (alone, other):
                masks.append(np.array(Image.open(folder / entry["mask"])) > 127)
                images.append(np.array(Image.open(folder / entry["file"]), np.float32))
            # Something may stand before the object; nothing else becomes one.
            assert not (masks[1] & ~masks[0]).sum() > 0.02 * masks[0].sum()
            different += float(np.abs(images[0] - images[1]).mean())
        assert different > 12.0  # Levels of 255, on the mean of a picture one and more.
