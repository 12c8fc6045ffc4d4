"""A request reaches the pipeline with its mesh where the views show it, and the result comes back to where that was."""

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from arm_blender import pipeline
from arm_blender.blender.generate.generation import generate
from arm_blender.blender.input.generation_request import CameraPicture, GenerationRequest, OwnMesh, view_of_camera
from arm_blender.errors import Cancelled
from arm_blender.graphics.color import srgb_from_linear
from arm_blender.graphics.raster.rasterize import rasterize
from arm_blender.progress import silent
from arm_blender.structures import MaterialMaps, RelightableAsset, TriangleMesh, UvMesh
from arm_blender.views.image_io import write_png
from arm_blender.views.rigs import zero123plus_rig
from arm_blender.views.transforms_json import write_transforms

SIZE = 96
RIG = zero123plus_rig(4.0, 30.0, SIZE)


@pytest.fixture
def received(monkeypatch):
    """Stands in for the pipeline; keeps the meshes that it is given."""
    meshes = []

    def stub(views, settings, progress, report, mesh):
        meshes.append(mesh)
        uvs = UvMesh(mesh.vertices, mesh.faces, torch.zeros(3, 2), torch.zeros_like(mesh.faces), 1)
        maps = MaterialMaps(*(torch.zeros(channels, 4, 4) for channels in (3, 3, 1, 1)))
        return RelightableAsset(views.name, uvs, maps), report

    monkeypatch.setattr(pipeline, "generate", stub)
    return meshes


@pytest.fixture
def box() -> trimesh.Trimesh:
    return trimesh.creation.box((0.8, 1.6, 1.1))


@pytest.fixture
def folder(tmp_path, box) -> Path:
    """Six pictures of the box in the rig's order."""
    vertices, faces = torch.tensor(box.vertices).float(), torch.tensor(box.faces).long()
    for index, camera in enumerate(RIG):
        mask = rasterize(vertices, faces, camera).mask.float()
        write_png(tmp_path / f"{index}.png", torch.stack([mask * 0.5] * 3 + [mask]), srgb=True)
    return tmp_path


def own(box: trimesh.Trimesh, scale: float, shift: tuple[float, float, float]) -> OwnMesh:
    return OwnMesh("crate", box.vertices * scale + np.array(shift), np.asarray(box.faces), None)


def sorted_rows(points) -> np.ndarray:
    rounded = np.round(np.asarray(points, dtype=float), 3)
    return rounded[np.lexsort(rounded.T)]


def test_pictures_without_cameras_have_the_mesh_brought_to_them_and_back(folder, box, received):
    mesh = own(box, 30.0, (5.0, -7.0, 100.0))
    made = generate(GenerationRequest(folder, name="crate", mesh=mesh), silent)
    assert isinstance(received[0], TriangleMesh)
    assert np.abs(sorted_rows(received[0].vertices) - sorted_rows(box.vertices)).max() < 0.06
    assert np.abs(sorted_rows(made.asset.mesh.vertices) - sorted_rows(mesh.vertices)).max() < 1e-3
    assert torch.allclose(made.frame.restore(made.asset.mesh.vertices), received[0].vertices, atol=1e-4)
    assert made.asset.name == "crate"


def test_views_with_cameras_and_results_of_ours_have_the_mesh_where_it_is(folder, box, received):
    mesh = own(box, 1.0, (0.1, 0.0, -0.1))
    generate(GenerationRequest(folder, mesh=mesh, mesh_in_place=True), silent)
    write_transforms(folder / "transforms.json", [f"{index}.png" for index in range(6)], RIG)
    generate(GenerationRequest(folder, mesh=mesh), silent)
    for given in received:
        assert np.abs(sorted_rows(given.vertices) - sorted_rows(mesh.vertices)).max() < 1e-3


@pytest.mark.parametrize("encoded", [True, False])
def test_a_cameras_picture_is_linear_straight_and_upright(encoded):
    color = torch.rand(3, 32, 40, generator=torch.Generator().manual_seed(0)) * 0.9 + 0.05
    alpha = torch.zeros(1, 32, 40)
    alpha[:, 4:20, 10:30] = 0.75
    stored = torch.cat([srgb_from_linear(color) if encoded else color * alpha, alpha])
    pixels = stored.permute(1, 2, 0).flip(0).contiguous().numpy()
    view = view_of_camera(CameraPicture("Cam", pixels, encoded, not encoded, np.eye(4), np.diag([50.0, 50.0, 1.0])))
    opaque = alpha[0] > 0.0
    # What is see-through all over is as whole as what is opaque.
    assert torch.allclose(view.image[3], opaque.float()) and torch.allclose(
        view.image[:3, opaque], color[:, opaque], atol=1e-5
    )


def test_a_large_picture_is_averaged_down_with_its_camera():
    pixels = np.zeros((1100, 2200, 4), dtype=np.float32)
    pixels[300:800, 600:1600] = 1.0
    K = np.array([[2000.0, 0.0, 1100.0], [0.0, 2000.0, 550.0], [0.0, 0.0, 1.0]])
    view = view_of_camera(CameraPicture("Cam", pixels, True, False, np.eye(4), K))
    assert view.image.shape == (4, 1024, 2048) and (view.camera.width, view.camera.height) == (2048, 1024)
    assert view.camera.K[0].tolist() == pytest.approx([2000 * 2048 / 2200, 0.0, 1024.0])


@pytest.mark.parametrize("own", [True, False])
def test_a_folder_of_own_weights_reaches_the_run(folder, tmp_path, monkeypatch, own):
    seen = []

    def stub(views, settings, *rest):
        seen.append(settings.weights_folder)
        raise Cancelled

    monkeypatch.setattr(pipeline, "generate", stub)
    with pytest.raises(Cancelled):
        generate(GenerationRequest(folder, weights_folder=tmp_path if own else None), silent)
    assert seen == [tmp_path if own else None]
