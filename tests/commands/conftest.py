"""The pipeline is played by a stand-in, and there is no Blender but where a test asks for it."""

import sys
from pathlib import Path

import pytest
import torch
import trimesh

from arm_blender.structures import MaterialMaps, RelightableAsset, UvMesh

from ..pictures import a_picture


@pytest.fixture
def pipeline(monkeypatch):
    """Stands in for the pipeline: a box for every view set; keeps what it was asked for."""
    from arm_blender import pipeline

    calls = []

    def generate(views, settings, progress, report, mesh=None):
        calls.append((views, settings))
        progress(0.5, "shaping")
        with report.stage("shape"):
            box = trimesh.creation.box()
        vertices, faces = torch.from_numpy(box.vertices.copy()).float(), torch.from_numpy(box.faces.copy()).long()
        mesh = UvMesh(vertices, faces, torch.rand(len(vertices), 2), faces, 1)
        maps = MaterialMaps(*(torch.full((channels, 4, 4), 0.5) for channels in (3, 3, 1, 1)))
        report.faces = len(faces)
        return RelightableAsset(views.name, mesh, maps), report

    monkeypatch.setattr(pipeline, "generate", generate)
    return calls


@pytest.fixture(autouse=True)
def no_blender(monkeypatch, request):
    """As where bpy is not installed, unless the test is marked `blender`."""
    if request.node.get_closest_marker("blender") is None:
        for name in ("export", "relight"):
            monkeypatch.setitem(sys.modules, f"arm_blender.blender.{name}", None)
            # An earlier test may have imported it: the package then has it as an attribute as well.
            monkeypatch.delattr(f"arm_blender.blender.{name}", raising=False)


@pytest.fixture
def picture(tmp_path) -> Path:
    return a_picture(tmp_path / "cup.png")


@pytest.fixture
def pictures(tmp_path) -> Path:
    """A list of three pictures."""
    for name in "abc":
        a_picture(tmp_path / f"{name}.png")
    (tmp_path / "list.txt").write_text("".join(f"{name}.png\n" for name in "abc"))
    return tmp_path / "list.txt"
