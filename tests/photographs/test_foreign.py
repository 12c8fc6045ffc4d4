"""What nerfstudio, instant-ngp, Polycam and COLMAP write is read as the same capture, and what does not do is named."""

import numpy as np
import pytest
import torch
from PIL import Image

from arm_blender.errors import ArmError, CameraError, InputImageError
from arm_blender.photographs.capture import Lens
from arm_blender.photographs.foreign import needs_cleaning, read_capture
from arm_blender.progress import silent

from .ball import LENSES, orbit
from .foreign_files import write_colmap, write_transforms_json

SMALL = Lens("OPENCV", (60.0, 62.0, 31.0, 25.0, -0.1, 0.02, 0.001, -0.002), 64, 48)
FIELDS = dict(zip(("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2"), SMALL.parameters, strict=True))
PINHOLE = dict(list(FIELDS.items())[:4])


def grey_pictures(folder, count, size=(64, 48), suffix="png"):
    folder.mkdir(parents=True, exist_ok=True)
    names = [f"{index:04d}.{suffix}" for index in range(count)]
    for index, name in enumerate(names):
        Image.new("RGB", size, (index, 90, 90)).save(folder / name)
    return names


def read(path):
    return read_capture(path, silent)


@pytest.mark.parametrize(
    ("fields", "lens"),
    [
        (FIELDS | {"camera_model": "OPENCV", "w": 64, "h": 48}, SMALL),
        (FIELDS, SMALL),  # instant-ngp names no model.
        (FIELDS | {"k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0}, Lens("PINHOLE", SMALL.parameters[:4], 64, 48)),
        (
            FIELDS | {"k3": 0.5, "k4": 0},
            Lens("FULL_OPENCV", (*SMALL.parameters, 0.5, 0.0, 0.0, 0.0), 64, 48),
        ),
        (
            PINHOLE | {"is_fisheye": True, "k1": 0.1, "k4": 0.3},
            Lens("OPENCV_FISHEYE", (*SMALL.parameters[:4], 0.1, 0.0, 0.0, 0.3), 64, 48),
        ),
        (
            PINHOLE | {"camera_model": "OPENCV_FISHEYE", "k2": 0.2},
            Lens("OPENCV_FISHEYE", (*SMALL.parameters[:4], 0.0, 0.2, 0.0, 0.0), 64, 48),
        ),
        (  # Of pictures twice as large: the file's numbers are of those.
            {name: 2 * value if index < 4 else value for index, (name, value) in enumerate(FIELDS.items())}
            | {"w": 128, "h": 96},
            SMALL,
        ),
    ],
)
def test_each_dialect_names_its_lens(tmp_path, fields, lens):
    poses = orbit(2)
    path = write_transforms_json(tmp_path / "transforms.json", grey_pictures(tmp_path, 2), poses, **fields)
    capture = read(path)
    assert [one.path.name for one in capture.photographs] == ["0000.png", "0001.png"]
    for one, pose in zip(capture.photographs, poses, strict=True):
        assert (one.lens.model, one.lens.width, one.lens.height) == (lens.model, 64, 48)
        np.testing.assert_allclose(one.lens.parameters, lens.parameters, rtol=1e-6)
        np.testing.assert_allclose(one.c2w.numpy(), pose, atol=1e-6)


def test_every_frame_may_have_a_lens_of_its_own(tmp_path):
    names, frames = grey_pictures(tmp_path, 2), [{"fl_x": 50.0}, {"fl_x": 70.0, "k1": 0.2}]
    path = write_transforms_json(
        tmp_path / "transforms.json", names, orbit(2), **FIELDS, frames=frames, applied_transform=np.eye(4)[:3].tolist()
    )
    first, second = (one.lens.parameters for one in read(path).photographs)
    assert (first[0], first[4]) == (50.0, -0.1) and (second[0], second[4]) == (70.0, 0.2)


def test_what_does_as_it_is_needs_no_cleaning(tmp_path):
    names = grey_pictures(tmp_path, 17)
    for count, fields, needed in ((16, PINHOLE, False), (17, PINHOLE, True), (2, FIELDS, True)):
        path = write_transforms_json(tmp_path / "transforms.json", names[:count], orbit(count), **fields)
        assert needs_cleaning(path) is needed and needs_cleaning(tmp_path) is needed
    known = [{"known": [0, 0, 64, 48]}] * 17
    write_transforms_json(path, names, orbit(17), **PINHOLE, frames=known)
    assert not needs_cleaning(path), "views that were made here are as many as were asked for"
    write_transforms_json(path, names[:11] * 3, orbit(33), **PINHOLE, frames=(known * 2)[:33])
    assert needs_cleaning(path), "nobody reads so many"
    (tmp_path / names[1]).unlink()
    write_transforms_json(path, names[:2], orbit(2), **PINHOLE)
    assert needs_cleaning(tmp_path)
    assert not needs_cleaning(tmp_path / names[0]) and not needs_cleaning(tmp_path / "nothing.json")


def test_missing_pictures_are_said_in_one_line(tmp_path):
    """As a public phone capture comes: 67 frames, of which 17 have no picture, with k1, k2, p1 and p2."""
    names = grey_pictures(tmp_path / "images", 67, suffix="jpg")
    for name in names[10:27]:
        (tmp_path / "images" / name).unlink()
    path = write_transforms_json(
        tmp_path / "transforms.json", [f"./images/{name}" for name in names], orbit(67), **FIELDS, w=64.0, h=48.0
    )
    capture = read(path)
    assert len(capture.photographs) == 50
    ((what, why),) = capture.left_out.items()
    assert what == "17 of 67 frames" and "0010.jpg" in why
    for name in names:
        (tmp_path / "images" / name).unlink(missing_ok=True)
    with pytest.raises(InputImageError, match=r"frame 0 \(./images/0000.jpg\): no such picture"):
        read(path)


def test_a_damaged_picture_is_left_out_by_name(tmp_path):
    names = grey_pictures(tmp_path, 3)
    (tmp_path / names[1]).write_bytes(b"no picture")
    path = write_transforms_json(tmp_path / "transforms.json", names, orbit(3), **FIELDS)
    capture = read(path)
    assert [one.path.name for one in capture.photographs] == [names[0], names[2]]
    assert list(capture.left_out) == [names[1]] and "not a readable picture" in capture.left_out[names[1]]


@pytest.mark.parametrize(
    ("place", "file_path"),
    [
        ("masks/0000.png", "0000.jpg"),
        ("masks/0000.jpg.png", "images/0000.jpg"),
        ("masks/images/0000.png", "images/0000.jpg"),
        ("images/0000.jpg.mask.png", "images/0000.jpg"),
        ("images/0000.mask.png", "images/0000.jpg"),
        ("else/where.png", "images/0000.jpg"),
    ],
)
def test_a_mask_is_found_wherever_programs_put_it(tmp_path, place, file_path):
    for path, mode in ((tmp_path / file_path, "RGB"), (tmp_path / place, "L")):
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new(mode, (64, 48)).save(path)
    frames = [{"mask_path": place}] if place.startswith("else") else [{}]
    path = write_transforms_json(tmp_path / "transforms.json", [file_path], orbit(1), **FIELDS, frames=frames)
    assert read(path).photographs[0].mask == tmp_path / place


@pytest.mark.parametrize(
    ("fields", "frame", "word"),
    [
        ({"k1": "bent"}, {}, "k1"),
        ({"p2": float("inf")}, {}, "p2"),
        ({"fl_x": -1.0}, {}, "fl_x"),
        ({"w": 32, "h": 32}, {}, "w, h say 32x32"),
        ({}, {"transform_matrix": [[2.0, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]]}, "transform_matrix"),
        ({}, {"transform_matrix": [[1.0, float("nan")]]}, "transform_matrix"),
        ({"camera_model": "EQUIRECTANGULAR"}, {}, "camera_model EQUIRECTANGULAR"),
        ({"k4": 0.1}, {}, "k4"),
        ({"is_fisheye": True}, {}, "p1, p2"),
        ({}, {"file_path": "../0001.png"}, "file_path"),
        ({}, {"mask_path": "../0001.png"}, "mask_path"),
    ],
)
def test_an_error_names_file_frame_and_field(tmp_path, fields, frame, word):
    names = grey_pictures(tmp_path, 2)
    path = write_transforms_json(tmp_path / "transforms.json", names, orbit(2), **(FIELDS | fields), frames=[{}, frame])
    with pytest.raises(CameraError) as caught:
        read(path)
    line = str(caught.value)
    assert str(path) in line and "frame " in line and word in line and "\n" not in line


@pytest.mark.parametrize(("model", "binary"), [("SIMPLE_RADIAL", True), *((model, False) for model in LENSES)])
def test_a_model_of_colmap_is_read(tmp_path, model, binary):
    lens = Lens(model, LENSES[model], 320, 240)
    names, poses = grey_pictures(tmp_path / "images", 3, (320, 240)), orbit(3)
    write_colmap(tmp_path / "sparse" / "0", [*names, "gone.png"], [*poses, poses[0]], lens, binary)
    assert needs_cleaning(tmp_path)
    capture = read(tmp_path)
    assert [one.path for one in capture.photographs] == [tmp_path / "images" / name for name in names]
    for one, pose in zip(capture.photographs, poses, strict=True):
        assert one.lens == lens
        np.testing.assert_allclose(one.c2w.numpy(), pose, atol=1e-6)  # It stands already, and stays as it is.
    np.testing.assert_allclose(capture.points.numpy(), [[0.1, 0.2, 0.3]])
    assert capture.left_out == {"1 of 4 images": "their pictures are missing, first gone.png"}
    inner = read(tmp_path / "sparse" / "0")
    assert [one.path.name for one in inner.photographs] == names


def test_a_model_that_lies_on_its_side_is_set_upright(tmp_path):
    names, poses = grey_pictures(tmp_path / "images", 6), orbit(6)
    turn = np.eye(4)
    turn[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    turn[:3, 3] = [5.0, 6.0, 7.0]
    write_colmap(tmp_path / "sparse" / "0", names, [turn @ pose for pose in poses], SMALL, False)
    c2ws = torch.stack([one.c2w for one in read(tmp_path).photographs])
    up = torch.nn.functional.normalize(c2ws[:, :3, 1].mean(0), dim=0)
    np.testing.assert_allclose(up.numpy(), [0.0, 0.0, 1.0], atol=1e-9)
    given = torch.tensor(np.stack(poses))
    scale = 4.0 / 3.0  # Cameras at 3 from the ball come to 4.
    for a in range(5):
        ours, theirs = ((c[a, :3, 3] - c[a + 1, :3, 3]).norm() for c in (c2ws, given))
        assert float(ours / theirs) == pytest.approx(scale, rel=0.01)
    relative = torch.linalg.inv(c2ws[0])[:3, :3] @ c2ws[1, :3, :3]
    np.testing.assert_allclose(
        relative.numpy(), (torch.linalg.inv(given[0])[:3, :3] @ given[1, :3, :3]).numpy(), atol=1e-6
    )


def test_a_damaged_model_is_named(tmp_path):
    grey_pictures(tmp_path / "images", 1)
    folder = tmp_path / "sparse" / "0"
    folder.mkdir(parents=True)
    (folder / "cameras.txt").write_text("1 NO_SUCH_LENS 64 48 1 2\n")
    (folder / "images.txt").write_text("")
    (folder / "points3D.txt").write_text("")
    with pytest.raises(CameraError, match="0: no readable model of COLMAP") as caught:
        read(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["scan.rcproj", "scan.psx", "cameras.xml"])
def test_projects_of_other_programs_are_refused_with_advice(tmp_path, name):
    (tmp_path / name).write_text("")
    with pytest.raises(CameraError, match="export for COLMAP"):
        needs_cleaning(tmp_path / name)


def test_without_pycolmap_the_remedy_is_said(tmp_path, monkeypatch):
    monkeypatch.setattr("arm_blender.photographs.colmap.runner.is_there", lambda module: False)
    grey_pictures(tmp_path / "images", 1)
    write_colmap(tmp_path / "sparse" / "0", ["0000.png"], orbit(1), SMALL, False)
    with pytest.raises(ArmError, match="pip install pycolmap"):
        read(tmp_path)


def test_a_frame_of_a_picture_that_is_stored_on_its_side(tmp_path):
    """w and h of the picture as it is stored: so was it solved."""
    picture = Image.new("RGB", (64, 48))
    exif = Image.Exif()
    exif[274] = 6
    picture.save(tmp_path / "0.jpg", exif=exif)
    path = write_transforms_json(tmp_path / "transforms.json", ["0.jpg"], orbit(1), **FIELDS, w=64, h=48)
    lens = read(path).photographs[0].lens
    assert (lens.width, lens.height) == (48, 64)
    assert lens.parameters == pytest.approx((62.0, 60.0, 48 - 25.0, 31.0, -0.1, 0.02, -0.002, -0.001), rel=1e-6)
