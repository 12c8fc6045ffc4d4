"""Tar shards: what is read is what was written, whole or not at all, and as WebDataset names it."""

import json
import tarfile
from pathlib import Path

import numpy as np
import pytest

from arm_blender.errors import ArmError
from arm_blender.machine.files import only_writer
from training.__main__ import main
from training.rendering import occupancy, shard_writer, shards
from training.rendering.assets import find_assets
from training.rendering.render import render_dataset

SETTINGS = {"resolution": 4, "samples": 1, "denoise": False}


def rig(seed: int) -> dict[str, np.ndarray]:
    draws = np.random.default_rng(seed)
    return {"rgba": draws.integers(0, 255, (7, 4, 4, 4), np.uint8), "c2w": draws.random((7, 4, 4), np.float32)}


def tetrahedron(size: float) -> dict[str, np.ndarray]:
    vertices = size * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    return {"vertices": vertices, "faces": np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)}


def render(item: dict, words: dict) -> dict:
    """Takes the place of the renderer: arrays that follow from the object's key; keys with an X are left out."""
    key, seed = item["key"], int.from_bytes(item["key"].encode(), "big") % 2**32
    dropped = "no roughness or metallic map" if "X" in key else None
    record = {"key": key, "source": item["source"], "dropped": dropped, "views": 7, "lightings": [{}, {}]}
    files = {"mesh.npz": tetrahedron(1.0), "rig_0.npz": rig(seed), "rig_1.npz": rig(seed + 1)}
    seconds = {"rendering": 14.0, "all": 16.0}
    shard_writer.save_part(Path(words["output"]), record, {} if dropped else files, seconds)
    return {"key": key, "dropped": dropped}


def in_turn(items, words):
    return ((item, render(item, words)) for item in items)


@pytest.fixture
def assets(tmp_path):
    (tmp_path / "assets" / "deep").mkdir(parents=True)
    for name in ("a.glb", "b.OBJ", "deep/c.usdz", "d X.fbx", "e.gltf", "f.glb", "notes.txt", "tool.blend"):
        (tmp_path / "assets" / name).touch()
    return find_assets(tmp_path / "assets")


def make(assets, output: Path, distribute=in_turn, size: int = 4) -> tuple[int, int]:
    with shard_writer.writing(output, SETTINGS):
        return render_dataset(assets, output, size, {"output": str(output)}, distribute)


def contents(output: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in output.iterdir() if path.is_file()}


def test_objects_are_found_in_all_folders_and_nothing_that_may_hold_scripts(assets):
    assert {asset.source for asset in assets} == {"a.glb", "b.OBJ", "deep/c.usdz", "d X.fbx", "e.gltf", "f.glb"}
    assert {asset.key for asset in assets} == {"a", "b", "deep_c", "d_X", "e", "f"}


def test_files_that_differ_in_little_keep_names_of_their_own(tmp_path):
    for name in ("a.glb", "a.obj", "a b.obj", "a_b.obj", "other.glb"):
        (tmp_path / name).touch()
    keys = [asset.key for asset in find_assets(tmp_path)]
    assert len(set(keys)) == 5 and "other" in keys and all("." not in key for key in keys)


def test_a_folder_without_objects_is_refused(tmp_path):
    with pytest.raises(ArmError, match="holds no object; known formats are .glb"):
        find_assets(tmp_path)


def test_environment_maps_are_looked_at_before_any_object_is(assets, tmp_path, capsys):
    place, output = tmp_path / "light", tmp_path / "shards"
    place.mkdir()
    words = ["render", str(tmp_path / "assets"), "--hdri", str(place), "--output", str(output)]
    assert main(words) == 1 and f"{place}: no environment map" in capsys.readouterr().err
    (place / "sun.exr").write_text("no picture")
    assert main(words) == 1 and "sun.exr: not a readable environment map (" in capsys.readouterr().err
    assert not output.exists()


def test_what_is_read_is_what_was_written(assets, tmp_path):
    output = tmp_path / "shards"
    assert make(assets, output) == (6, 5)
    assert sorted(path.name for path in output.glob("*.tar")) == ["000000.tar", "000001.tar"]
    keys = sorted(asset.key for asset in assets if "X" not in asset.key)
    assert shards.rigs(output) == [output / key / f"rig_{k}.npz" for key in keys for k in (0, 1)]
    assert shards.meshes(output) == [output / key / "mesh.npz" for key in keys]
    assert shards.rigs_of(output / "a") == [output / "a" / "rig_0.npz", output / "a" / "rig_1.npz"]
    for key in keys:
        expected = rig(int.from_bytes(key.encode(), "big") % 2**32)
        found = shards.arrays(output / key / "rig_0.npz")
        assert found.keys() == expected.keys() and all(np.array_equal(found[name], expected[name]) for name in found)
    assert list(shards.arrays(output / "a" / "rig_0.npz", "c2w")) == ["c2w"]
    assert np.array_equal(shards.read_mesh(output / "a" / "mesh.npz").faces, tetrahedron(1.0)["faces"])


def test_a_shard_is_a_webdataset(assets, tmp_path):
    make(assets, tmp_path / "shards")
    names = []
    for tar_path in sorted((tmp_path / "shards").glob("*.tar")):
        with tarfile.open(tar_path) as tar:
            names += tar.getnames()
            told = json.load(tar.extractfile(next(name for name in tar.getnames() if name.endswith(".json"))))
        assert told["camera"] == shard_writer.CAMERA
    samples = [name.partition(".") for name in names]
    for i in range(0, len(samples), 4):  # The members of an object follow each other.
        assert len({key for key, _, _ in samples[i : i + 4]}) == 1
        assert {field for _, _, field in samples[i : i + 4]} == {"mesh.npz", "rig_0.npz", "rig_1.npz", "json"}


def test_the_library_reads_a_shard(assets, tmp_path):
    webdataset = pytest.importorskip("webdataset")
    make(assets, tmp_path / "shards")
    paths = [str(path) for path in sorted((tmp_path / "shards").glob("*.tar"))]
    samples = list(webdataset.WebDataset(paths, shardshuffle=False).decode())
    assert {sample["__key__"].rpartition("/")[2] for sample in samples} == {"a", "b", "deep_c", "e", "f"}
    first = next(sample for sample in samples if sample["__key__"].endswith("a"))
    assert np.array_equal(first["rig_0.npz"]["rgba"], rig(ord("a"))["rgba"]) and first["json"]["source"] == "a.glb"


def test_a_run_that_breaks_off_goes_on_and_ends_as_an_unbroken_one(assets, tmp_path):
    make(assets, tmp_path / "whole", size=2)

    def breaks(items, words):
        for item in items[:3]:
            yield item, render(item, words)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(assets, tmp_path / "broken", breaks, size=2)
    assert len(list((tmp_path / "broken").glob("*.tar"))) == 1  # One is full; one object waits.
    assert make(assets, tmp_path / "broken", size=2)[0] == 3
    assert contents(tmp_path / "broken") == contents(tmp_path / "whole")
    assert make(assets, tmp_path / "broken", size=2) == (0, 0)


def test_the_order_in_which_objects_end_leaves_no_trace(assets, tmp_path):
    make(assets, tmp_path / "one")
    make(assets, tmp_path / "other", lambda items, words: in_turn(items[::-1], words))
    assert contents(tmp_path / "one") == contents(tmp_path / "other")


def test_an_object_that_its_process_does_not_survive_is_tried_twice_and_recorded(assets, tmp_path):
    tried = []

    def dies(items, words):
        for item in items:
            tried.append(item["key"])
            lost = item["key"] == "b" or (item["key"] == "a" and tried.count("a") == 1)
            yield item, None if lost else render(item, words)

    assert make(assets, tmp_path / "shards", dies) == (6, 4)
    records = {r["key"]: r for index in shards.read_indexes(tmp_path / "shards") for r in index["objects"]}
    assert tried.count("a") == tried.count("b") == 2 and records["b"]["dropped"] == "its process died over it, twice"
    assert records["d_X"]["dropped"] == "no roughness or metallic map" and records["a"]["dropped"] is None


def test_half_a_shard_is_never_read(assets, tmp_path):
    output = tmp_path / "shards"
    make(assets, output)
    (output / "000001.json").unlink()  # As if killed just before the index was written.
    with tarfile.open(output / "000000.tar") as tar:
        whole = {name.partition(".")[0] for name in tar.getnames()}
    assert {path.parent.name for path in shards.rigs(output)} == whole
    make(assets, output)
    assert len(shards.meshes(output)) == 5


def test_a_damaged_shard_is_found_by_its_checksum(assets, tmp_path, capsys):
    output = tmp_path / "shards"
    make(assets, output)
    assert main(["shards", str(output), "--verify"]) == 0
    assert "all shards are what their index says" in capsys.readouterr().out
    content = bytearray((output / "000001.tar").read_bytes())
    content[700] ^= 1
    (output / "000001.tar").write_bytes(content)
    assert shard_writer.verify(output) == ["000001.tar"]
    assert main(["shards", str(output), "--verify"]) == 1


def test_the_report_counts_reasons_and_computes_the_cost_from_the_index(assets, tmp_path, capsys):
    make(assets, tmp_path / "shards")
    words = ["--objects", "86400", "--views", "10", "--machines", "1", "10"]
    assert main(["shards", str(tmp_path / "shards"), *words]) == 0
    out = capsys.readouterr().out
    assert "5 of 6 objects in 2 shards" in out and "left out 1: no roughness or metallic map" in out
    # 14 s for 2 rigs of 7 views is 1 s a view. Six tried objects took 16 s each, of which 5 * 14 s were rendering:
    # (96 - 70) / 6 s beside it, over the 5 of 6 that were rendered 5.2 s an object.
    assert "| 1 | 15.200 | 21.200 |" in out and "| 10 | 1.520 | 2.120 |" in out


def test_other_settings_do_not_mix_into_a_folder(assets, tmp_path):
    make(assets, tmp_path / "shards")
    with pytest.raises(ArmError, match=r"other settings \(samples\); choose another --output"):
        with shard_writer.writing(tmp_path / "shards", SETTINGS | {"samples": 2}):
            raise AssertionError("it was begun")


def test_a_second_run_into_the_same_folder_is_refused_and_touches_nothing(assets, tmp_path, capsys):
    """Not even what would be a leftover if nobody were at work."""
    output = tmp_path / "shards"
    words = ["render", str(tmp_path / "assets"), "--output", str(output)]

    def another_starts(items, words_of_task):
        (output / shard_writer.PARTS / ".half.1.part.tar").touch()
        before = contents(output)
        assert main(words) == 1
        assert "another run writes here; wait for it, or choose another --output" in capsys.readouterr().err
        assert contents(output) == before and (output / shard_writer.PARTS / ".half.1.part.tar").exists()
        return in_turn(items, words_of_task)

    assert make(assets, output, another_starts) == (6, 5)
    make(assets, output)
    assert not list((output / shard_writer.PARTS).iterdir())
    with only_writer(tmp_path / "views"):
        assert main([*words[:-1], str(tmp_path / "views"), "--layout", "views"]) == 1
    assert f"{tmp_path / 'views'}: another run writes here" in capsys.readouterr().err
    assert not list((tmp_path / "views").iterdir())


def test_distances_are_written_beside_the_shards(assets, tmp_path, monkeypatch):
    output = tmp_path / "shards"
    make(assets[:2], output)
    cloud = (occupancy.torch.zeros(20_000, 3), occupancy.torch.zeros(20_000))
    monkeypatch.setattr(occupancy, "signed_distances", lambda mesh, generator: cloud)
    assert main(["prepare", "--shards", str(output)]) == 0
    for path in shards.meshes(output):
        assert path.with_name("occupancy.npz").is_file()
    assert len(shards.rigs(output)) == 2 * len(shards.meshes(output))


def test_a_missing_sample_is_named(tmp_path):
    with pytest.raises(ArmError, match="a/rig_0.npz: no such file, and no shard of"):
        shards.arrays(tmp_path / "a" / "rig_0.npz")
