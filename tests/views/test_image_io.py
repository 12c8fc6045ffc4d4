"""Every format gives the same picture; what is no picture is refused in one line."""

import struct
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import torch
from PIL import Image, ImageCms

from arm_blender.errors import InputImageError, OutputError
from arm_blender.graphics.color import linear_from_srgb, srgb_from_linear
from arm_blender.machine.picture_files import pictures_in
from arm_blender.photographs.pictures import looked_at
from arm_blender.views.image_io import MAXIMUM_SIDE, read_image, read_orientation, write_png


@pytest.fixture
def stored() -> np.ndarray:
    """(H, W, 4) uint8 sRGB straight alpha, with colour under every alpha, 0 and 1 of 255 among them."""
    pixels = np.random.default_rng(0).integers(0, 256, (24, 40, 4), dtype=np.uint8)
    pixels[0, :3, 3] = (0, 1, 255)
    return pixels


@pytest.fixture
def expected(stored) -> torch.Tensor:
    pixels = torch.from_numpy(stored).permute(2, 0, 1) / 255.0
    return torch.cat([linear_from_srgb(pixels[:3]), pixels[3:]])


def write_by_oiio(path, pixels: np.ndarray, kind: str, **attributes) -> None:
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind)
    for name, value in attributes.items():
        spec.attribute(name.replace("__", ":"), value)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec) and output.write_image(pixels) and output.close()


@pytest.mark.parametrize("tile", [16, 48, 128])
@pytest.mark.parametrize("kind", ["uint8", "float"])
def test_tiled_files_and_bands_agree(tmp_path, tile, kind):
    """More rows than a band, tiles that do not divide it, and a window that does not begin at the origin."""
    pixels = np.random.default_rng(0).integers(0, 256, (200, 70, 4), dtype=np.uint8)
    pixels[..., 3] = 255
    name = "a.tif" if kind == "uint8" else "a.exr"
    stored = pixels if kind == "uint8" else (pixels / 255.0).astype(np.float32)
    spec = oiio.ImageSpec(70, 200, 4, kind)
    spec.tile_width = spec.tile_height = tile
    if kind == "float":
        spec.x, spec.y = 3, 5
    output = oiio.ImageOutput.create(str(tmp_path / name))
    assert output.open(str(tmp_path / name), spec) and output.write_image(stored) and output.close()
    values = torch.from_numpy(pixels).permute(2, 0, 1) / 255.0
    expected = torch.cat([linear_from_srgb(values[:3]), values[3:]]) if kind == "uint8" else values
    torch.testing.assert_close(read_image(tmp_path / name), expected, atol=1e-6, rtol=0)


PEAK = """
import sys
from io import BytesIO
from pathlib import Path
from arm_blender.report import peak_memory_mib
from arm_blender.views.image_io import read_image
read_image(Path(sys.argv[1]))
before = peak_memory_mib()
image = read_image(Path(sys.argv[2]))
after = peak_memory_mib()
print((after - before) * 2**20 / (image.numel() * image.element_size()))
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere the peak may be inherited")
def test_a_picture_of_8k_takes_little_more_memory_than_its_own(tmp_path):
    """Of the whole picture at once, the steps from sRGB to linear light alone would be five times as much."""
    for name, size in (("small.png", (64, 64)), ("large.png", (MAXIMUM_SIDE, 512))):
        Image.new("RGB", size, (200, 80, 30)).save(tmp_path / name)
    done = subprocess.run(
        [sys.executable, "-c", PEAK, tmp_path / "small.png", tmp_path / "large.png"],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=True,
    )
    assert 0.5 < float(done.stdout) < 3.0


@pytest.mark.parametrize("name", ["a.png", "a.webp", "a.tif"])
def test_lossless_formats_of_8_bits_agree_to_the_bit(tmp_path, stored, expected, name):
    Image.fromarray(stored).save(tmp_path / name, lossless=True, exact=True)
    torch.testing.assert_close(read_image(tmp_path / name), expected, atol=1e-6, rtol=0)


def test_16_bits_agree_with_8(tmp_path, stored, expected):
    write_by_oiio(tmp_path / "a.png", stored.astype(np.uint16) * 257, "uint16", oiio__UnassociatedAlpha=1)
    torch.testing.assert_close(read_image(tmp_path / "a.png"), expected, atol=1e-6, rtol=0)


def test_premultiplied_linear_exr_agrees(tmp_path, expected):
    premultiplied = torch.cat([expected[:3] * expected[3:], expected[3:]]).permute(1, 2, 0).contiguous().numpy()
    write_by_oiio(tmp_path / "a.exr", premultiplied, "float")
    image = read_image(tmp_path / "a.exr")
    seen = expected[3] > 0
    torch.testing.assert_close(image[:, seen], expected[:, seen], atol=1e-5, rtol=0)
    assert not image[:3, ~seen].any()


def test_linear_hdr_and_jpeg_are_opaque_and_close(tmp_path):
    ramp = np.repeat(np.linspace(0, 255, 64, dtype=np.uint8)[None, :, None], 32, axis=0).repeat(3, axis=2)
    linear = linear_from_srgb(torch.from_numpy(ramp).permute(2, 0, 1) / 255.0)
    write_by_oiio(tmp_path / "a.hdr", linear.permute(1, 2, 0).contiguous().numpy(), "float")
    Image.fromarray(ramp).save(tmp_path / "a.jpg", quality=98)
    for name in ("a.hdr", "a.jpg"):
        image = read_image(tmp_path / name)
        assert bool((image[3] == 1.0).all())
        # RGBE has 8 bits of mantissa; a JPEG of high quality is off by a few levels.
        torch.testing.assert_close(srgb_from_linear(image[:3]), srgb_from_linear(linear), atol=0.02, rtol=0)


@pytest.mark.parametrize(("mode", "channels"), [("L", [0]), ("LA", [0, 3])])
def test_grey_is_equal_in_all_channels(tmp_path, stored, expected, mode, channels):
    Image.fromarray(stored[..., channels].squeeze(), mode).save(tmp_path / "a.png")
    image = read_image(tmp_path / "a.png")
    torch.testing.assert_close(image[:3], expected[:1].expand(3, -1, -1), atol=1e-6, rtol=0)
    torch.testing.assert_close(image[3], expected[3] if mode == "LA" else torch.ones_like(expected[3]))


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_is_honoured(tmp_path, orientation):
    # Flat quarters survive JPEG; Pillow's own transposition is the independent twin.
    pixels = np.zeros((32, 64, 3), dtype=np.uint8)
    pixels[:16, :32], pixels[:16, 32:], pixels[16:, :32] = (255, 0, 0), (0, 255, 0), (0, 0, 255)
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(pixels).save(tmp_path / "a.jpg", exif=exif, quality=100, subsampling=0)
    from PIL import ImageOps

    upright = np.asarray(ImageOps.exif_transpose(Image.open(tmp_path / "a.jpg")))
    expected = linear_from_srgb(torch.from_numpy(upright.copy()).permute(2, 0, 1) / 255.0)
    torch.testing.assert_close(read_image(tmp_path / "a.jpg")[:3], expected, atol=0.02, rtol=0)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", ["webp", "png"])
def test_exif_orientation_is_honoured_in_every_format(tmp_path, orientation, suffix):
    pixels = np.zeros((20, 30, 4), dtype=np.uint8)
    pixels[:9, :12], pixels[12:, 20:] = (255, 0, 0, 255), (0, 0, 255, 255)
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / f"a.{suffix}"
    Image.fromarray(pixels).save(path, exif=exif, **({"lossless": True} if suffix == "webp" else {}))
    from PIL import ImageOps

    upright = np.asarray(ImageOps.exif_transpose(Image.open(path)).convert("RGBA"))
    alpha, red = torch.from_numpy(upright[..., 3].copy()) / 255.0, torch.from_numpy(upright[..., 0].copy()) / 255.0
    image = read_image(path)
    assert torch.equal(image[3], alpha) and torch.equal(image[0] * image[3], red)
    width, height, found = read_orientation(path)
    assert (width, height, found) == (30, 20, orientation)


@pytest.mark.parametrize("orientation", [1, 6])
def test_of_a_webp_that_moves_the_first_picture_is_read_with_its_alpha(tmp_path, orientation):
    pixels = np.zeros((20, 30, 4), dtype=np.uint8)
    pixels[5:15, 5:20] = (200, 100, 50, 255)
    others = [Image.fromarray(np.roll(pixels, 5 * shift, axis=1)) for shift in (1, 2)]
    exif = Image.Exif()
    exif[0x0112] = orientation
    options = {"save_all": True, "append_images": others, "lossless": True, "exif": exif.tobytes()}
    Image.fromarray(pixels).save(tmp_path / "a.webp", **options)
    expected = torch.from_numpy(pixels[..., 3] / 255.0).float()
    expected = expected if orientation == 1 else torch.rot90(expected, -1)
    assert torch.equal(read_image(tmp_path / "a.webp")[3], expected)
    assert read_orientation(tmp_path / "a.webp") == (*reversed(expected.shape), 1)


def test_alpha_that_a_tiff_has_multiplied_into_its_colours_is_taken_out(tmp_path):
    straight = np.zeros((20, 30, 4), dtype=np.uint8)
    straight[5:15, 5:20] = (200, 100, 50, 128)
    multiplied = straight.copy()
    multiplied[..., :3] = np.round(straight[..., :3] * (straight[..., 3:] / 255.0))
    write_by_oiio(tmp_path / "straight.tif", straight, "uint8", oiio__UnassociatedAlpha=1)
    write_by_oiio(tmp_path / "multiplied.tif", multiplied, "uint8")
    one, other = (srgb_from_linear(read_image(tmp_path / f"{name}.tif")) for name in ("straight", "multiplied"))
    torch.testing.assert_close(one[:, 5:15, 5:20], other[:, 5:15, 5:20], atol=2 / 255, rtol=0)


def test_a_profile_of_wide_colours_is_read_as_what_it_means(tmp_path):
    """Primaries of Display P3 under D50, gamma 2.2; Pillow's own conversion back to it is the independent twin."""
    profile = wide_profile([(0.5151, 0.2412, -0.0011), (0.292, 0.6922, 0.0419), (0.1571, 0.0666, 0.7841)])
    meant = np.zeros((20, 30, 3), dtype=np.uint8)
    meant[:, :10], meant[:, 10:20], meant[:, 20:] = (200, 40, 40), (40, 170, 60), (50, 70, 200)
    to_wide = ImageCms.buildTransform(
        ImageCms.createProfile("sRGB"), ImageCms.ImageCmsProfile(BytesIO(profile)), "RGB", "RGB"
    )
    stored = ImageCms.applyTransform(Image.fromarray(meant), to_wide)
    assert np.abs(np.asarray(stored).astype(int) - meant).max() > 20
    for name in ("a.png", "a.tif", "a.webp"):
        stored.save(tmp_path / name, icc_profile=profile, **({"lossless": True} if name.endswith("webp") else {}))
        found = srgb_from_linear(read_image(tmp_path / name)[:3]).permute(1, 2, 0).numpy() * 255.0
        assert np.abs(found - meant).max() < 3.0, name


def wide_profile(primaries) -> bytes:
    """An ICC matrix profile, version 2."""
    fixed = lambda *values: b"".join(struct.pack(">i", round(value * 65536)) for value in values)  # noqa: E731
    curve = b"curv" + bytes(4) + struct.pack(">IH", 1, round(2.2 * 256))
    tags = {"desc": b"desc" + bytes(4) + struct.pack(">I", 5) + b"wide" + bytes(79), "cprt": b"text" + bytes(4) + b"x"}
    tags |= {"wtpt": b"XYZ " + bytes(4) + fixed(0.9642, 1.0, 0.8249)}
    for letter, primary in zip("rgb", primaries, strict=True):
        tags |= {f"{letter}XYZ": b"XYZ " + bytes(4) + fixed(*primary), f"{letter}TRC": curve}
    body, table = b"", struct.pack(">I", len(tags))
    for name, data in tags.items():
        table += name.encode() + struct.pack(">II", 132 + 12 * len(tags) + len(body), len(data))
        body += data + bytes(-len(data) % 4)
    head = bytearray(128)
    struct.pack_into(
        ">I4sI4s4s4s", head, 0, 128 + len(table) + len(body), b"none", 0x02400000, b"mntr", b"RGB ", b"XYZ "
    )
    head[36:40], head[68:80] = b"acsp", fixed(0.9642, 1.0, 0.8249)
    return bytes(head) + table + body


@pytest.mark.parametrize("name", [b"\x80\xffR", b"R"])
def test_a_channel_whose_name_is_no_text_is_refused(tmp_path, name):
    write_by_oiio(tmp_path / "a.exr", np.zeros((4, 4, 1), np.float32), "float")
    data = (tmp_path / "a.exr").read_bytes()
    assert data.count(b"Y\0") == 1
    (tmp_path / "a.exr").write_bytes(data.replace(b"Y\0", name[:1] + b"\0"))
    if name == b"R":
        read_image(tmp_path / "a.exr")
    else:
        with pytest.raises(InputImageError, match="a.exr"):
            read_image(tmp_path / "a.exr")


def test_more_channels_than_a_picture_has_are_refused(tmp_path):
    spec = oiio.ImageSpec(8, 8, 100, "float")
    output = oiio.ImageOutput.create(str(tmp_path / "a.exr"))
    assert output.open(str(tmp_path / "a.exr"), spec) and output.write_image(np.zeros((8, 8, 100), np.float32))
    output.close()
    with pytest.raises(InputImageError, match="100 channels"):
        read_image(tmp_path / "a.exr")


def test_values_that_are_no_colour_are_clamped(tmp_path):
    pixels = np.full((16, 16, 4), 0.5, dtype=np.float32)
    pixels[0, 0], pixels[0, 1], pixels[0, 2] = np.nan, np.inf, (5.0, -1.0, 0.25, 1.0)
    write_by_oiio(tmp_path / "a.exr", pixels, "float")
    image = read_image(tmp_path / "a.exr")
    assert bool(((image >= 0.0) & (image <= 1.0)).all())
    assert image[:, 0, 2].tolist() == [1.0, 0.0, 0.25, 1.0]


@pytest.mark.parametrize("suffix", ["png", "jpg", "exr", "webp"])
def test_half_a_file_is_refused_without_noise(tmp_path, stored, suffix, capfd):
    path = tmp_path / f"half.{suffix}"
    if suffix == "exr":
        write_by_oiio(path, stored.astype(np.float32), "half")
    else:
        Image.fromarray(stored if suffix != "jpg" else stored[..., :3]).save(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(InputImageError, match="half"):
        read_image(path)
    assert capfd.readouterr().err == ""


def test_what_is_no_picture_is_refused(tmp_path):
    (tmp_path / "text.png").write_text("not a picture")
    (tmp_path / "empty.png").touch()
    for name in ("text.png", "empty.png", "missing.png"):
        with pytest.raises(InputImageError, match=name) as caught:
            read_image(tmp_path / name)
        assert "\n" not in str(caught.value)


def test_a_damaged_exif_costs_a_picture_its_orientation_alone(tmp_path, stored, expected):
    exif = Image.Exif()
    exif[0x0112] = 6
    path = tmp_path / "a.webp"
    Image.fromarray(stored).save(path, exif=exif.tobytes(), lossless=True, exact=True)
    whole = path.read_bytes()
    assert whole.count(b"MM\0*") == 1
    path.write_bytes(whole.replace(b"MM\0*", b"MM\0M"))
    torch.testing.assert_close(read_image(path), expected, atol=1e-6, rtol=0)
    assert read_orientation(path) == (40, 24, 1)
    assert (looked_at(path).width, looked_at(path).height) == (40, 24)


@pytest.mark.parametrize("size", [b"-Y -1 +X 24", b"-Y 24 +X -1"])
def test_a_picture_of_less_than_no_pixels_is_refused(tmp_path, size):
    path = tmp_path / "a.hdr"
    path.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n" + size + b"\n\2\2\0\x18" + bytes(200))
    for read in (read_image, read_orientation):
        with pytest.raises(InputImageError, match="without pixels"):
            read(path)


def test_a_giant_is_refused_before_it_is_decoded(tmp_path):
    """The header of a PNG of 20 gigapixels, and nothing behind it."""
    write_png(tmp_path / "small.png", torch.zeros(3, 16, 16), srgb=False)
    data = bytearray((tmp_path / "small.png").read_bytes())
    side = 20 * MAXIMUM_SIDE
    data[16:24] = struct.pack(">II", side, side)
    import zlib

    data[29:33] = struct.pack(">I", zlib.crc32(bytes(data[12:29])))
    (tmp_path / "giant.png").write_bytes(bytes(data))
    with pytest.raises(InputImageError, match="giant.png"):
        read_image(tmp_path / "giant.png")


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("srgb", [True, False])
def test_png_keeps_every_8_bit_value(tmp_path, channels, srgb):
    """What other programs find in the file: sRGB codes for colour, the plain value for data."""
    levels = torch.arange(256).view(1, 16, 16).expand(channels, -1, -1) / 255.0
    image = torch.cat([linear_from_srgb(levels[:3]), levels[3:]]) if srgb else levels
    write_png(tmp_path / "a.png", image, srgb=srgb)
    found = np.asarray(Image.open(tmp_path / "a.png")).reshape(16, 16, channels)
    assert (found == np.arange(256).reshape(16, 16, 1)).all()


def test_a_png_that_cannot_be_written_leaves_nothing(tmp_path):
    (tmp_path / "taken.png").mkdir()
    with pytest.raises(OutputError, match="taken.png"):
        write_png(tmp_path / "taken.png", torch.zeros(3, 4, 4), srgb=True)
    with pytest.raises(OutputError, match="nowhere"):
        write_png(tmp_path / "nowhere" / "a.png", torch.zeros(3, 4, 4), srgb=True)
    assert [path.name for path in tmp_path.iterdir()] == ["taken.png"]


def test_pictures_are_listed_by_name_without_hidden_files(tmp_path):
    for name in ("b.png", "a.JPG", ".c.png", "notes.txt"):
        (tmp_path / name).touch()
    (tmp_path / "d.png").mkdir()
    assert [path.name for path in pictures_in(tmp_path)] == ["a.JPG", "b.png"]
