"""Photographs that other programs posed just work where views did; views that do go on as they are."""

import json

import pytest
import torch

from arm_blender.errors import CameraError
from arm_blender.graphics.cameras import project
from arm_blender.photographs import intake
from arm_blender.photographs.cameras.solving import SolvingOptions
from arm_blender.photographs.capture import Lens
from arm_blender.photographs.way import has_cameras
from arm_blender.report import Report
from arm_blender.structures import ViewSet
from arm_blender.views import ViewOptions, load_views
from arm_blender.views.transforms_json import TRANSFORMS

from .ball import orbit
from .foreign_files import write_colmap, write_pictures, write_transforms_json

LENS = Lens("OPENCV", (75.0, 75.0, 40.0, 30.0, -0.2, 0.05, 0.002, -0.003), 80, 60)
FIELDS = dict(zip(("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2"), LENS.parameters, strict=True))


def loaded(path, folder=None) -> tuple[ViewSet, Report]:
    report = Report("small", "cpu", 0)
    return intake.load_views(path, folder, ViewOptions(), SolvingOptions(), report), report


def ball_is_where_it_should_be(views) -> bool:
    """The middle of every mask is that of the ball: of a sphere near the axis, within a pixel."""
    middles = [torch.nonzero(image[3] > 0.5).float().mean(0).flip(0) + 0.5 for image in views.images]
    found = [project(torch.zeros(3), camera)[0] for camera in views.cameras]
    return all(float((a - b).norm()) < 1.0 for a, b in zip(middles, found, strict=True))


def test_views_that_do_are_read_as_they_are(tmp_path):
    poses, straight = orbit(3), Lens("PINHOLE", LENS.parameters[:4], 80, 60)
    names = write_pictures(tmp_path / "cup", poses, straight, supersampled=1)
    write_transforms_json(tmp_path / "cup" / TRANSFORMS, names, poses, **dict(list(FIELDS.items())[:4]))
    (ours, report), theirs = loaded(tmp_path / "cup", tmp_path / "views"), load_views(tmp_path / "cup")
    assert report.photographs["cameras"] == "file"
    assert torch.equal(ours.images, theirs.images) and not (tmp_path / "views").exists()
    assert ours.length is None
    known = intake.load_views(tmp_path / "cup", None, ViewOptions(length=0.19), SolvingOptions(), report)
    assert known.length == 0.19


def test_a_phone_capture_just_works(tmp_path):
    """Bent lenses, more frames than fit, missing pictures, no alpha."""
    poses = orbit(20)
    names = [f"images/{name}" for name in write_pictures(tmp_path / "cup" / "images", poses, LENS, supersampled=1)]
    write_transforms_json(tmp_path / "cup" / TRANSFORMS, names, poses, **FIELDS, w=80, h=60, camera_model="OPENCV")
    for name in names[3:5]:
        (tmp_path / "cup" / name).unlink()
    views, report = loaded(tmp_path / "cup", tmp_path / "out" / "views")
    notes = {note.what: note.why for note in report.left_out}
    assert views.name == "cup" and len(views.cameras) == 16 and ball_is_where_it_should_be(views)
    assert "0003.png" in notes["2 of 20 frames"] and len(notes) == 3
    assert report.masks.keys() == {"plain background"} and len(report.masks["plain background"]) == 16
    again = load_views(tmp_path / "out" / "views")
    assert torch.equal(again.images, views.images)


def test_a_model_of_colmap_just_works_with_its_masks(tmp_path):
    poses = orbit(4)
    names = write_pictures(tmp_path / "cup" / "images", poses, LENS, "../masks/{}.png", supersampled=1)
    write_colmap(tmp_path / "cup" / "sparse" / "0", names, poses, LENS, False)
    views, report = loaded(tmp_path / "cup")
    assert views.name == "cup" and ball_is_where_it_should_be(views)
    assert {way: sorted(found) for way, found in report.masks.items()} == {"mask file": sorted(names)}
    assert has_cameras(tmp_path / "cup") and not has_cameras(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cup"]


def test_what_is_read_is_not_written_over(tmp_path):
    folder = tmp_path / "out" / "views"
    names = write_pictures(folder, orbit(1), LENS, supersampled=1)
    path = write_transforms_json(folder / TRANSFORMS, names, orbit(1), **FIELDS)
    before = path.read_bytes()
    for given in (folder, path, folder / ".." / "views"):
        with pytest.raises(CameraError, match="is read, and would be written over"):
            loaded(given, folder)
    assert path.read_bytes() == before
    assert sorted(one.name for one in folder.iterdir()) == [*names, TRANSFORMS]


def test_generate_takes_them(tmp_path, monkeypatch):
    """On the command line the views lie beside the result, and the report names what was left out."""
    from arm_blender import pipeline
    from arm_blender.__main__ import main
    from arm_blender.errors import EmptyMeshError

    poses, given = orbit(17), []
    names = write_pictures(tmp_path / "cup", poses, LENS, supersampled=1)
    write_transforms_json(tmp_path / "cup" / TRANSFORMS, names, poses, **FIELDS)

    def stop(views, settings, progress, report, mesh):
        given.append((views, report))
        raise EmptyMeshError("far enough")

    monkeypatch.setattr(pipeline, "generate", stop)
    assert main(["generate", str(tmp_path / "cup"), "--output", str(tmp_path / "out")]) == 1
    ((views, report),) = given
    assert len(views.cameras) == 16 and [note.what for note in report.left_out] != []
    frames = json.loads((tmp_path / "out" / "views" / TRANSFORMS).read_text())["frames"]
    assert len(frames) == 16 and {note.what for note in report.left_out} <= set(names)
