"""From files of every format to shards: what is rendered, what is left out and why, what a kill costs."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch

from arm_blender.graphics.cameras import unproject
from training.__main__ import main
from training.evaluation.truth.objects import evaluation_objects
from training.rendering import shards

bpy = pytest.importorskip("bpy")
from arm_blender.blender.compat import shader_tree  # noqa: E402  It needs bpy.

pytestmark = pytest.mark.blender

TINY = ["--resolution", "24", "--samples", "1", "--no-denoise", "--cpu", "--views", "2"]
HALF = {"albedo": (0.2, 0.5, 0.7), "roughness": 0.25, "metallic": 0.75}


def cube(mapped: bool) -> None:
    """A cube in an empty file, its finish driven by images or not."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_cube_add(size=0.3, location=(5.0, 1.0, 0.0))
    material = bpy.data.materials.new("finish")
    tree = shader_tree(material)
    node = next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED")
    node.inputs["Base Color"].default_value = (*HALF["albedo"], 1.0)
    if mapped:
        image = bpy.data.images.new("finish", 4, 4)
        image.colorspace_settings.name = "Non-Color"
        image.pixels = [0.0, HALF["roughness"], HALF["metallic"], 1.0] * 16
        image.pack()
        texture, split = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeSeparateColor")
        texture.image = image
        tree.links.new(texture.outputs["Color"], split.inputs["Color"])
        tree.links.new(split.outputs["Green"], node.inputs["Roughness"])
        tree.links.new(split.outputs["Blue"], node.inputs["Metallic"])
    bpy.context.object.data.materials.append(material)


@pytest.fixture(scope="module")
def assets(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("assets")
    cube(mapped=True)
    bpy.ops.export_scene.gltf(filepath=str(folder / "mapped.glb"))
    cube(mapped=False)
    bpy.ops.export_scene.gltf(filepath=str(folder / "plain.glb"))
    bpy.ops.wm.obj_export(filepath=str(folder / "object.obj"))
    bpy.ops.export_scene.fbx(filepath=str(folder / "film.fbx"))
    bpy.ops.wm.usd_export(filepath=str(folder / "stage.usdc"))
    (folder / "points.obj").write_text("".join(f"v {x} {x * x} 1\n" for x in range(50)))
    (folder / "line.obj").write_text("v 0 0 0\nv 0 0 1000\nv 0.001 0 0\nf 1 2 3\n")
    (folder / "broken.glb").write_bytes(b"glTF and then nothing of it")
    (folder / "empty.obj").write_text("# nothing\n")
    return folder


def records(output: Path) -> dict[str, dict]:
    return {record["key"]: record for index in shards.read_indexes(output) for record in index["objects"]}


@pytest.fixture(scope="module")
def rendered(assets, tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("out") / "shards"
    words = ["render", str(assets), "--output", str(output), *TINY, "--any-material", "--lightings", "2"]
    assert main([*words, "--shard-size", "5"]) == 0
    return output


def test_every_format_is_rendered_and_every_other_file_has_its_reason(rendered):
    found = records(rendered)
    assert {key for key, record in found.items() if not record["dropped"]} == {
        "mapped",
        "plain",
        "object",
        "film",
        "stage",
    }
    reasons = {
        "points": "point cloud",
        "line": "sparse or tiny",
        "broken": "cannot be imported",
        "empty": "no triangles",
    }
    for key, reason in reasons.items():
        assert reason in found[key]["dropped"], (key, found[key]["dropped"])
    assert found["mapped"]["source"] == "mapped.glb" and len(found["mapped"]["lightings"]) == 2


def test_without_the_switch_an_object_needs_a_map(assets, tmp_path):
    words = ["render", str(assets), "--output", str(tmp_path / "s"), *TINY, "--views", "0", "--ids", "mapped", "plain"]
    assert main(words) == 0
    found = records(tmp_path / "s")
    assert found["mapped"]["dropped"] is None and found["plain"]["dropped"] == "no roughness or metallic map"


def test_maps_are_those_of_the_file(rendered):
    arrays = shards.arrays(rendered / "mapped" / "rig_0.npz")
    inside = (arrays["rgba"][..., 3] == 255) & np.isfinite(arrays["depth"])
    linear = np.array(HALF["albedo"])
    expected = 255.0 * (1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(arrays["albedo"][inside] - expected).max() <= 1.0
    for name in ("roughness", "metallic"):
        assert np.abs(arrays[name][inside] / 255.0 - HALF[name]).max() <= 0.01


def test_a_depth_leads_back_to_the_cube_and_a_normal_to_its_face(rendered):
    """The cube fills [-1, 1]^3: a visible point has one coordinate of size one, and its normal lies along it."""
    for key in ("mapped", "object", "film", "stage"):
        arrays = shards.arrays(rendered / key / "rig_0.npz")
        assert len(arrays["rgba"]) == 8
        for index, camera in enumerate(shards.cameras(arrays)):
            rows, columns = np.nonzero((arrays["rgba"][index, ..., 3] == 255) & np.isfinite(arrays["depth"][index]))
            pixels = torch.from_numpy(np.stack([columns, rows], axis=1)).float() + 0.5
            depth = torch.from_numpy(arrays["depth"][index][rows, columns].astype(np.float32))
            points = unproject(pixels, depth, camera)
            # One sample lies anywhere in its pixel: at distance 6 half a pixel of 24 is 0.07, more on a grazing face.
            axis = points.abs().argmax(dim=1)
            off = (points.abs().amax(dim=1) - 1.0).abs()
            assert len(points) > 20 and float(off.median()) < 0.07
            normals = torch.from_numpy(arrays["normal"][index][rows, columns]).float() / 127.0
            along = (normals * points.sign()).gather(1, axis[:, None])[:, 0]
            assert float(along.median()) > 0.98 and float((along > 0.9).float().mean()) > 0.8


def test_lightings_change_the_colour_and_nothing_else(rendered):
    one, other = (shards.arrays(rendered / "plain" / f"rig_{k}.npz") for k in (0, 1))
    for name in ("c2w", "K"):
        assert np.array_equal(one[name], other[name])
    for name in ("albedo", "roughness", "metallic", "depth", "normal"):
        assert np.mean(one[name] == other[name]) > 0.99, name
    inside = one["rgba"][..., 3] == 255
    difference = one["rgba"][inside, :3].astype(int) - other["rgba"][inside, :3]
    assert np.abs(difference).mean() > 3.0


def test_a_killed_run_loses_at_most_its_object_and_ends_as_an_unbroken_one(assets, tmp_path, rendered):
    output = tmp_path / "shards"
    words = ["-m", "training", "render", str(assets), "--output", str(output), *TINY, "--any-material"]
    words += ["--lightings", "2", "--shard-size", "5"]
    run = subprocess.Popen([sys.executable, *words], start_new_session=True, stderr=subprocess.DEVNULL)
    parts, deadline = output / ".parts", time.monotonic() + 120.0
    while len(list(parts.glob("[!.]*.json"))) < 2:
        assert run.poll() is None and time.monotonic() < deadline
        time.sleep(0.01)
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    kept = {path.stem for path in parts.glob("[!.]*.json")} | set(records(output))
    assert len(kept) >= 2
    before = {path: path.stat().st_mtime_ns for path in parts.glob("[!.]*.tar")}
    assert main(words[2:]) == 0
    assert kept <= set(records(output)) and before  # Those parts went into shards; none was rendered again:
    for tar in sorted(rendered.glob("*.tar")):
        assert (output / tar.name).read_bytes() == tar.read_bytes()
    assert not list(parts.iterdir()) and not [p for p in output.iterdir() if p.name.startswith(".") and p != parts]


def test_the_index_names_the_convention_the_version_and_the_seed(rendered):
    head = json.loads((rendered / "index.json").read_text())
    assert head["camera"].startswith("OpenGL") and head["version"] and head["settings"]["seed"] == 0
    assert main(["shards", str(rendered), "--verify"]) == 0


def test_a_manifest_gives_objects_their_set_split_and_axis(tmp_path):
    """And evaluation views are as a user would bring them, with the true mesh."""
    corners = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 3))  # Tall along the file's Z.
    (tmp_path / "tall.obj").write_text(corners + "f 1 3 7 5\nf 2 6 8 4\nf 1 5 6 2\nf 3 4 8 7\nf 1 2 4 3\nf 5 7 8 6\n")
    sets = {"scan": ("gso", "eval"), "flat": ("flat", "eval"), "hidden": ("gso", "train")}
    entries = [{"id": key, "main": "tall.obj", "set": own, "split": split} for key, (own, split) in sets.items()]
    environment = str(Path(bpy.utils.system_resource("DATAFILES"), "studiolights", "world", "city.exr"))
    hdris = [{"files": [environment], "split": "eval"}]
    (tmp_path / "manifest.json").write_text(json.dumps({"objects": entries, "hdris": hdris}))
    words = ["render", "--data", str(tmp_path), "--split", "eval", "--output", str(tmp_path / "views")]
    assert main([*words, "--layout", "views", *TINY, "--resolution", "48"]) == 0
    found = {item.name: item for item in evaluation_objects(tmp_path / "views")}
    assert set(found) == {"scan", "flat"}
    for name, upright in (("scan", 2), ("flat", 1)):
        extents = found[name].truth().vertices.amax(0) - found[name].truth().vertices.amin(0)
        assert float(extents[upright]) == pytest.approx(2.0) and int((extents < 0.7).sum()) == 2
        views = found[name].views()
        assert len(views.cameras) == 6 and 0.02 < float((views.images[:, 3] > 0.5).float().mean()) < 0.5
