"""A cluster of two machines, one of which is lost midway, makes the same shards as this machine alone."""

import importlib
from functools import partial
from pathlib import Path

import pytest

from training.rendering import shard_writer, shards
from training.rendering.assets import Asset
from training.rendering.render import TASK, render_dataset

pytestmark = pytest.mark.slow
pytest.importorskip("ray")

CHEAP = """
import os, time
from pathlib import Path
import numpy as np
from training.rendering import shard_writer

def answer(item, words):
    time.sleep(words["seconds"])
    key = item["key"]
    (Path(words["log"]) / f"{key}.{os.getpid()}.{time.time_ns()}").touch()
    if key == "o7":
        os.kill(os.getpid(), 9)
    record = {"key": key, "source": item["source"], "dropped": "odd" if key == "o3" else None}
    files = {} if record["dropped"] else {"rig_0.npz": {"rgba": np.full((2, 4, 4, 4), int(key[1:]), np.uint8)}}
    shard_writer.save_part(Path(words["output"]), record, files, {})
    return {"key": key, "dropped": record["dropped"]}
"""


@pytest.fixture
def cluster():
    import ray
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    made.add_node(num_cpus=1)
    made.wait_for_nodes()
    yield made
    ray.shutdown()
    made.shutdown()


def objects(count: int) -> list[Asset]:
    return [Asset(f"o{k}", f"o{k}.glb", f"o{k}.glb") for k in range(count)]


@pytest.mark.long
def test_a_machine_that_is_lost_leaves_no_trace(tmp_path, monkeypatch, cluster):
    from training.rendering.render_ray import over_machines

    (tmp_path / "cheap_render.py").write_text(CHEAP)
    monkeypatch.syspath_prepend(tmp_path)
    seen = []

    def distributed(items, words):
        address = cluster.address
        for found in over_machines(items, words, "cheap_render", address, cpus=1, gpus=0):
            seen.append(found)
            if len(seen) == 5:
                cluster.remove_node(next(iter(cluster.worker_nodes)), allow_graceful=False)
            yield found

    def here(items, words):  # What dies over an object has no answer, here as there.
        answer = importlib.import_module("cheap_render").answer
        return ((item, None if item["key"] == "o7" else answer(item, words)) for item in items)

    made = {}
    for name, distribute, seconds in (("alone", here, 0.0), ("cluster", distributed, 0.2)):
        output, log = tmp_path / name, tmp_path / f"{name}_log"
        log.mkdir()
        words = {"output": str(output), "log": str(log), "seconds": seconds}
        with shard_writer.writing(output, {}):
            assert render_dataset(objects(20), output, 8, words, distribute) == (20, 18)
        made[name] = {path.name: path.read_bytes() for path in output.iterdir() if path.is_file()}
    assert made["cluster"] == made["alone"] and len(made["alone"]) == 1 + 2 * 3
    processes = {path.name.split(".")[1] for path in (tmp_path / "cluster_log").iterdir() if path.name[:3] != "o7."}
    assert len(processes) >= 2
    assert not cluster.worker_nodes


@pytest.mark.blender
def test_blender_renders_in_the_tasks_of_a_cluster(tmp_path, cluster):
    pytest.importorskip("bpy")
    from arm_blender.commands.workers import side_by_side
    from training.rendering.render_ray import over_machines

    cube = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1))
    cube += "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
    made, assets = {}, []
    for k in range(4):
        path = tmp_path / f"cube{k}.obj"
        path.write_text(cube if k else "# nothing")
        assets.append(Asset(path.stem, str(path), path.name))
    for name in ("alone", "cluster"):
        output = tmp_path / name
        words = {
            "output": str(output),
            "render": {"resolution": 16, "samples": 1, "denoise": False, "gpu": False},
            "sample": {"views": 1, "any_material": True},
            "hdris": [],
            "own_hdris": True,
        }
        distribute = {
            "alone": lambda items, words: side_by_side(items, 1, TASK, words),
            "cluster": partial(over_machines, module=TASK, address=cluster.address, cpus=1, gpus=0),
        }[name]
        with shard_writer.writing(output, {}):
            assert render_dataset(assets, output, 2, words, distribute) == (4, 3)
        made[name] = [path.read_bytes() for path in sorted(Path(output).glob("*.tar"))]
        assert len(shards.rigs(output)) == 3
    assert made["cluster"] == made["alone"] and made["alone"]
