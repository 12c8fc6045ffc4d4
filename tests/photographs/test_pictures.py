"""What files of cameras say: size, focal length, colours, which way is up; and of videos the sharpest frames."""

import math
import struct

import av
import numpy as np
import pytest
import torch
from PIL import Image, ImageFilter

from arm_blender.errors import ArmError, InputImageError
from arm_blender.graphics.color import linear_from_srgb
from arm_blender.photographs.pictures import looked_at, sharpness
from arm_blender.photographs.video import FEWEST_FRAMES, frames_of
from arm_blender.photographs.way import way_of
from arm_blender.progress import silent
from arm_blender.views import pillow_io
from arm_blender.views.image_io import read_image


def display_p3() -> bytes:
    """An ICC profile (version 2) with the primaries of Display P3, adapted to D50, and a gamma of 2.2."""

    def fixed(*values: float) -> bytes:
        return b"".join(struct.pack(">i", round(value * 65536)) for value in values)

    gamma = b"curv" + bytes(4) + struct.pack(">IH", 1, round(2.2 * 256)) + bytes(2)
    text = b"desc" + bytes(4) + struct.pack(">I", 3) + b"P3\0" + bytes(78)
    tags = {b"desc": text, b"wtpt": b"XYZ " + bytes(4) + fixed(0.9642, 1.0, 0.8249)}
    primaries = {
        b"rXYZ": (0.5151, 0.2412, -0.0011),
        b"gXYZ": (0.292, 0.6922, 0.0419),
        b"bXYZ": (0.1571, 0.0666, 0.7841),
    }
    tags |= {name: b"XYZ " + bytes(4) + fixed(*value) for name, value in primaries.items()}
    tags |= {name: gamma for name in (b"rTRC", b"gTRC", b"bTRC")}
    table, body = struct.pack(">I", len(tags)), b""
    for name, data in tags.items():
        data += bytes(-len(data) % 4)
        table += name + struct.pack(">II", 132 + 12 * len(tags) + len(body), len(data))
        body += data
    size = 128 + len(table) + len(body)
    head = struct.pack(">I4sI4s4s4s", size, b"none", 0x02100000, b"mntr", b"RGB ", b"XYZ ") + bytes(12) + b"acsp"
    head += bytes(28) + fixed(0.9642, 1.0, 0.8249) + bytes(48)
    return head + table + body


P3_TO_SRGB = np.array([[1.2249, -0.2247, 0.0], [-0.0420, 1.0419, 0.0], [-0.0197, -0.0786, 1.0979]])
"""Linear (CSS Color 4, section 18)."""


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif", "webp", "heic"])
def test_colours_of_display_p3_are_what_they_are(tmp_path, suffix):
    import pillow_heif

    pillow_heif.register_heif_opener()
    stored = np.array([120, 160, 90], np.uint8)
    image = Image.fromarray(np.broadcast_to(stored, (32, 48, 3)).copy())
    path = tmp_path / f"a.{suffix}"
    image.save(path, quality=100, icc_profile=display_p3())
    expected = torch.tensor(P3_TO_SRGB @ (stored / 255.0) ** 2.2)
    found = read_image(path)
    assert found.shape == (4, 32, 48)
    torch.testing.assert_close(found[:3].mean(dim=(1, 2)).double(), expected, atol=0.012, rtol=0)
    plain = linear_from_srgb(torch.tensor(stored / 255.0))
    assert float((plain - expected).abs().max()) > 0.03, "without the profile they are others"
    small = linear_from_srgb(torch.from_numpy(pillow_io.reduced(path, 16)[..., :3].astype(float)) / 255.0)
    torch.testing.assert_close(small.mean(dim=(0, 1)), expected, atol=0.012, rtol=0)


def test_heic_is_upright_and_named_when_it_cannot_be_read(tmp_path, monkeypatch):
    import pillow_heif

    pillow_heif.register_heif_opener()
    pixels = np.zeros((64, 96, 3), np.uint8)
    pixels[:, :32] = 255  # The left third; on top once it is turned.
    image = Image.fromarray(pixels)
    exif = image.getexif()
    exif[0x0112] = 6  # Turn it a quarter clockwise.
    image.save(tmp_path / "a.heic", quality=95, exif=exif.tobytes())
    found = read_image(tmp_path / "a.heic")
    assert found.shape == (4, 96, 64)
    assert float(found[0, :28].mean()) > 0.9 and float(found[0, 36:].mean()) < 0.1
    look = looked_at(tmp_path / "a.heic")
    assert (look.width, look.height) == (64, 96)
    (tmp_path / "b.heic").write_bytes(b"no picture")
    with pytest.raises(InputImageError, match="b.heic: not a readable picture"):
        read_image(tmp_path / "b.heic")
    monkeypatch.setattr(pillow_io, "is_there", lambda module: False)
    with pytest.raises(InputImageError, match="pip install pillow-heif"):
        read_image(tmp_path / "a.heic")


def test_focal_length_and_size_are_of_the_upright_picture(tmp_path):
    image = Image.new("RGB", (400, 300))
    exif = image.getexif()
    exif[0x0112] = 8
    exif.get_ifd(0x8769)[0xA405] = 26
    image.save(tmp_path / "a.jpg", exif=exif)
    look = looked_at(tmp_path / "a.jpg")
    assert (look.width, look.height) == (300, 400)
    assert look.focal == pytest.approx(26 / math.hypot(36, 24) * 500)


def test_a_focal_length_that_says_nothing_is_none(tmp_path):
    image = Image.new("RGB", (400, 300))
    for index, value in enumerate((0, 60000)):
        exif = image.getexif()
        exif.get_ifd(0x8769)[0xA405] = value
        image.save(tmp_path / f"{index}.jpg", exif=exif)
        assert looked_at(tmp_path / f"{index}.jpg").focal is None


def test_blur_takes_sharpness_away():
    image = Image.fromarray(np.random.default_rng(0).integers(0, 256, (64, 64), dtype=np.uint8))
    values = [sharpness(np.asarray(image.filter(ImageFilter.GaussianBlur(radius)))) for radius in (0, 1, 3)]
    assert values[0] > 2.0 * values[1] > 4.0 * values[2] > 0.0


def write_video(path, frames: list[np.ndarray]) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mjpeg", rate=10)  # Each frame by itself: no detail leaks into the next.
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuvj420p"
        stream.bit_rate = 8_000_000
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


def test_of_each_stretch_of_a_video_the_sharpest_frame_is_taken(tmp_path):
    """120 frames, of three neighbours one is sharp; the brightness says which frame it was."""
    random, frames = np.random.default_rng(0), []
    for index in range(120):
        frame = np.full((48, 64, 3), 8 + index * 2, np.int64)
        if index % 3 == 1:
            frame += random.integers(-8, 9, frame.shape[:2])[..., None]
        frames.append(frame.clip(0, 255).astype(np.uint8))
    write_video(tmp_path / "a.mov", frames)
    found = frames_of(tmp_path / "a.mov", tmp_path, silent)
    assert [path.name for path in found] == [f"frame_{number:04d}.png" for number in range(1, 41)]
    pictures = [np.asarray(Image.open(path)).astype(float) for path in found]
    assert min(picture.std() for picture in pictures) > 3.0, "all are sharp"
    expected = [8.0 + 2.0 * (3 * index + 1) for index in range(40)]
    assert max(abs(picture.mean() - mean) for picture, mean in zip(pictures, expected, strict=True)) < 2.0


def test_a_video_that_is_too_short_or_none_is_refused(tmp_path):
    write_video(tmp_path / "short.mov", [np.zeros((48, 64, 3), np.uint8)] * (FEWEST_FRAMES - 6))
    with pytest.raises(InputImageError, match="short.mov: 2 frames; walk once around"):
        frames_of(tmp_path / "short.mov", tmp_path, silent)
    (tmp_path / "none.mov").write_bytes(b"no video")
    with pytest.raises(InputImageError, match="none.mov: not a readable video"):
        frames_of(tmp_path / "none.mov", tmp_path, silent)


def test_the_rules_that_choose_where_cameras_come_from(tmp_path):
    def folder(name: str, count: int, size: tuple[int, int]):
        (tmp_path / name).mkdir()
        for index in range(count):
            Image.new("RGB", size).save(tmp_path / name / f"{index}.png")
        return tmp_path / name

    rig, seven, oblong = folder("rig", 6, (64, 64)), folder("seven", 7, (64, 64)), folder("oblong", 6, (64, 48))
    one, posed = folder("one", 1, (64, 64)), folder("posed", 7, (64, 64))
    (posed / "transforms.json").write_text("{}")
    expected = {rig: "rig", seven: "solve", oblong: "solve", one: "single", posed: "file", tmp_path / "a.mov": "solve"}
    assert {path: way_of(path, "auto").cameras for path in expected} == expected
    assert way_of(rig, "solve").cameras == way_of(posed, "solve").cameras == "solve"
    assert "7 photographs" in way_of(seven, "auto").why
    with pytest.raises(ArmError, match="--cameras solve: .*0.png is no folder"):
        way_of(one / "0.png", "solve")
