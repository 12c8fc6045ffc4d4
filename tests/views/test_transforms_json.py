"""transforms.json: what is written is read back, three dialects agree, and errors name the file and the field."""

import json
import math
from pathlib import Path

import pytest
import torch

from arm_blender.errors import CameraError, InputImageError
from arm_blender.graphics.cameras import Camera, orbit_camera
from arm_blender.views import load_views
from arm_blender.views.image_io import write_png
from arm_blender.views.rigs import zero123plus_rig
from arm_blender.views.transforms_json import read_transforms, transforms_in, write_transforms

SIZE = 32
SHAPE = torch.zeros(4, SIZE, SIZE)
SHAPE[:, 8:24, 8:24] = 1.0
IDENTITY = [[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]


@pytest.fixture
def folder(tmp_path):
    for name in ("0.png", "1.png"):
        write_png(tmp_path / name, torch.ones(4, SIZE, SIZE) * SHAPE, srgb=True)
    return tmp_path


def write(folder, **fields):
    fields = {"camera_angle_x": 0.5, "frames": [{"file_path": "0.png", "transform_matrix": IDENTITY}]} | fields
    (folder / "transforms.json").write_text(json.dumps(fields))
    return folder / "transforms.json"


def cameras_of(path, width=SIZE, height=SIZE) -> list[Camera]:
    return [frame.camera(width, height) for frame in read_transforms(path)]


def same(a: Camera, b: Camera) -> bool:
    return torch.equal(a.c2w, b.c2w) and torch.equal(a.K, b.K) and (a.width, a.height) == (b.width, b.height)


@pytest.mark.parametrize("alike", [True, False])
def test_a_round_trip_changes_no_bit(folder, alike):
    cameras = [orbit_camera(30.0, 20.0, 4.0, 30.0, SIZE, SIZE), orbit_camera(77.7, -10.0, 2.5, 30.0, SIZE, SIZE)]
    if not alike:
        cameras[1].K[:2, 2] += torch.tensor([3.0, -5.0])
    path = folder / "transforms.json"
    write_transforms(path, ["0.png", "1.png"], cameras, [1.0, 0.25])
    frames = read_transforms(path)
    assert all(same(frame.camera(SIZE, SIZE), camera) for frame, camera in zip(frames, cameras, strict=True))
    assert [frame.weight for frame in frames] == [1.0, 0.25]
    assert [frame.image.name for frame in frames] == ["0.png", "1.png"]


def test_the_dialects_agree(folder):
    """NeRF-synthetic's angle, instant-ngp's pixels, and nerfstudio's pixels per frame describe one camera."""
    focal = SIZE / (2.0 * math.tan(0.25))
    pixels = {"fl_x": focal, "fl_y": focal, "cx": SIZE / 2, "cy": SIZE / 2, "w": SIZE, "h": SIZE}
    frame = {"file_path": "./0", "transform_matrix": IDENTITY}
    synthetic = cameras_of(write(folder, camera_angle_x=0.5, frames=[frame]))[0]
    ngp = cameras_of(write(folder, **pixels, k1=0.0, aabb_scale=4))[0]
    studio = {"camera_model": "OPENCV", "frames": [{"file_path": "0.png", "transform_matrix": IDENTITY[:3]} | pixels]}
    nerfstudio = cameras_of(write(folder, camera_angle_x=None, **studio))[0]
    for camera in (ngp, nerfstudio):
        torch.testing.assert_close(camera.K, synthetic.K)
        assert torch.equal(camera.c2w, synthetic.c2w)


def test_a_frame_goes_before_the_file(folder):
    frames = [
        {"file_path": "0.png", "transform_matrix": IDENTITY},
        {"file_path": "1.png", "transform_matrix": IDENTITY, "fl_x": 77.0, "fl_y": 66.0, "cx": 3.0},
    ]
    first, second = cameras_of(write(folder, fl_x=50.0, cy=9.0, frames=frames))
    assert first.K.tolist() == [[50.0, 0.0, SIZE / 2], [0.0, 50.0, 9.0], [0.0, 0.0, 1.0]]
    assert second.K.tolist() == [[77.0, 0.0, 3.0], [0.0, 66.0, 9.0], [0.0, 0.0, 1.0]]


def test_intrinsics_follow_a_scaled_picture(folder):
    path = write(folder, fl_x=100.0, fl_y=100.0, cx=30.0, cy=20.0, w=64, h=48)
    camera = cameras_of(path, 32, 24)[0]
    assert camera.K.tolist() == [[50.0, 0.0, 15.0], [0.0, 50.0, 10.0], [0.0, 0.0, 1.0]]
    with pytest.raises(CameraError, match="64x48"):
        cameras_of(path, 32, 32)


@pytest.mark.parametrize(
    ("fields", "word"),
    [
        ({"k1": 0.1}, "undistort"),
        ({"camera_model": "OPENCV_FISHEYE"}, "undistort"),
        ({"frames": []}, "frames"),
        ({"frames": 3}, "frames"),
        ({"frames": ["0.png"]}, "file_path"),
        ({"frames": [{"transform_matrix": IDENTITY}]}, "file_path"),
        ({"frames": [{"file_path": "0.png"}]}, "transform_matrix"),
        ({"frames": [{"file_path": "0.png", "transform_matrix": [[1, 2], [3]]}]}, "transform_matrix"),
        ({"frames": [{"file_path": "0.png", "transform_matrix": [["x"] * 4] * 4}]}, "transform_matrix"),
        ({"frames": [{"file_path": "0.png", "transform_matrix": [[2.0, 0, 0, 0], *IDENTITY[1:]]}]}, "rigid"),
        ({"frames": [{"file_path": "0.png", "transform_matrix": [[-1.0, 0, 0, 0], *IDENTITY[1:]]}]}, "rigid"),
        ({"frames": [{"file_path": "0.png", "transform_matrix": IDENTITY, "weight": -1}]}, "weight"),
        ({"frames": [{"file_path": "0.png", "transform_matrix": IDENTITY}] * 33}, "at most 32"),
        ({"camera_angle_x": "wide"}, "camera_angle_x"),
        ({"camera_angle_x": 30.0}, "radians"),
        ({"camera_angle_x": None}, "camera_angle_x"),
        ({"fl_x": -5.0}, "fl_x"),
        ({"fl_x": 1e300}, "fl_x"),
        ({"camera_angle_x": 1e-200}, "focal length"),
        ({"camera_angle_x": 5e-324}, "focal length"),
        ({"cx": 10**400}, "cx"),
        ({"w": -64, "h": -48}, "w is -64"),
        ({"w": 0, "h": 0}, "w is 0"),
        ({"frames": [{"file_path": "0.png", "transform_matrix": [[1, 0, 0, 1e30], *IDENTITY[1:]]}]}, "4 rows"),
        ({"frames": [{"file_path": "0.png", "transform_matrix": [[10**400] * 4] * 4}]}, "transform_matrix"),
        ({"frames": [{"file_path": "x" * 5000, "transform_matrix": IDENTITY}]}, "names no file"),
        ({"frames": [{"file_path": "a\0b", "transform_matrix": IDENTITY}]}, "names no file"),
        ({"frames": [{"file_path": "\ud800", "transform_matrix": IDENTITY}]}, "names no file"),
        ({"frames": [{"file_path": "circle.png", "transform_matrix": IDENTITY}]}, "names no file"),
    ],
)
def test_an_error_names_the_file_and_the_field(folder, fields, word):
    (folder / "circle.png").symlink_to("circle.png")
    path = write(folder, **fields)
    with pytest.raises(CameraError, match=word) as caught:
        cameras_of(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("file_path", ["../0.png", "/etc/hostname", "a/../../0.png", "..\\0.png"])
def test_a_picture_may_not_leave_the_folder(folder, file_path):
    inner = folder / "inner"
    inner.mkdir()
    path = write(inner, frames=[{"file_path": file_path, "transform_matrix": IDENTITY}])
    with pytest.raises(CameraError, match="leaves the folder"):
        read_transforms(path)


def test_a_picture_may_be_a_link_to_elsewhere(folder):
    (folder / "inner").mkdir()
    (folder / "inner" / "link.png").symlink_to(folder / "0.png")
    path = write(folder / "inner", frames=[{"file_path": "link.png", "transform_matrix": IDENTITY}])
    assert read_transforms(path)[0].image == folder / "inner" / "link.png"


@pytest.mark.parametrize("name", ["0.PNG", "0.Jpg", "0.tif"])
def test_a_name_without_suffix_finds_its_picture_in_any_case(tmp_path, name):
    (tmp_path / "train").mkdir()
    (tmp_path / "train" / name).touch()
    (tmp_path / "train" / "0.txt").touch()
    path = write(tmp_path, frames=[{"file_path": "./train/0", "transform_matrix": IDENTITY}])
    assert read_transforms(path)[0].image == tmp_path / "train" / name


def test_what_is_off_by_rounding_is_rigid_and_straight(folder):
    off = [*IDENTITY[:3], [0, 1e-9, 0, 1.0000001]]
    frame = {"file_path": "0.png", "transform_matrix": off, "k1": 1e-9, "k2": -1e-12, "camera_model": None}
    read = read_transforms(write(folder, frames=[frame]))[0]
    assert torch.equal(read.c2w, torch.tensor(IDENTITY)) and not read.is_bent
    with pytest.raises(CameraError, match="rigid"):
        read_transforms(write(folder, frames=[frame | {"transform_matrix": [*IDENTITY[:3], [0, 0, 0, 1.1]]}]))


def test_the_cameras_for_training_are_those_of_a_set_cut_in_three(folder):
    for part in ("train", "val", "test"):
        write(folder).rename(folder / f"transforms_{part}.json")
    assert transforms_in(folder).name == "transforms_train.json"
    write(folder)
    assert transforms_in(folder).name == "transforms.json"
    views = load_views(folder / "transforms_val.json")
    assert views.name == folder.name and len(views.cameras) == 1


def test_a_frame_of_the_folder_itself_is_no_picture(folder, monkeypatch):
    """Also where the folder is the current one, whose name is empty."""
    write(folder, frames=[{"file_path": ".", "transform_matrix": IDENTITY}])
    monkeypatch.chdir(folder)
    with pytest.raises(InputImageError, match="no such picture"):
        read_transforms(Path("transforms.json"))


def test_what_is_missing_or_no_json_is_named(folder):
    (folder / "broken.json").write_text('{"frames": [')
    (folder / "bytes.json").write_bytes(b"\xff\xfe\x00")
    (folder / "deep.json").write_text("[" * 100_000)
    for name in ("broken.json", "bytes.json", "deep.json", "missing.json"):
        with pytest.raises(CameraError, match=name) as caught:
            read_transforms(folder / name)
        assert "\n" not in str(caught.value)
    path = write(folder, frames=[{"file_path": "7", "transform_matrix": IDENTITY}])
    with pytest.raises(InputImageError, match="frame 0"):
        read_transforms(path)


def test_the_rig_survives_a_round_trip(tmp_path):
    names = [f"{index}.png" for index in range(6)]
    for name in names:
        write_png(tmp_path / name, torch.ones(4, SIZE, SIZE) * SHAPE, srgb=True)
    rig = zero123plus_rig(size=SIZE)
    write_transforms(tmp_path / "transforms.json", names, rig)
    assert all(same(a, b) for a, b in zip(cameras_of(tmp_path / "transforms.json"), rig, strict=True))
