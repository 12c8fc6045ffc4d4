"""The light as a file: read back by another program it is the same light, from the same side."""

import OpenImageIO as oiio
import pytest
import torch

from arm_blender.errors import OutputError
from arm_blender.export.light_file import write_comparison, write_light
from arm_blender.graphics.light.environment import Environment
from arm_blender.graphics.light.harmonic_light import harmonics_of
from arm_blender.graphics.light.spherical_harmonics import COUNT, WHITE, harmonics


def light_from(x: float, y: float, z: float) -> torch.Tensor:
    """(9, 3) of warm light from everywhere, and more of it from one side."""
    light = torch.zeros(COUNT, 3)
    light[0] = WHITE * torch.tensor([1.0, 0.8, 0.6])
    light += 2.0 * harmonics(torch.tensor([[x, y, z]])).T * torch.tensor([1.0, 0.9, 0.8])
    return light


def read(path) -> torch.Tensor:
    """(3, H, W), the top row first."""
    return torch.from_numpy(oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)).permute(2, 0, 1).contiguous()


@pytest.mark.parametrize("side", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -0.6, 0.8)])
def test_the_file_has_the_harmonics_and_is_brightest_where_the_light_comes_from(tmp_path, side):
    light = light_from(*side)
    write_light(light, tmp_path / "light.exr")
    environment = Environment(read(tmp_path / "light.exr"))
    torch.testing.assert_close(harmonics_of(environment), light, atol=1e-2, rtol=0.0)
    brightest = environment.texels().direction[environment.radiance.sum(dim=0).flatten().argmax()]
    assert float(brightest @ torch.tensor(side)) > 0.99


def test_it_is_small_and_another_one_replaces_it(tmp_path):
    path = tmp_path / "light.exr"
    write_light(light_from(1.0, 0.0, 0.0), path)
    first = path.read_bytes()
    write_light(light_from(0.0, 1.0, 0.0), path)
    assert path.stat().st_size < 60_000 and path.read_bytes() != first
    assert [entry.name for entry in tmp_path.iterdir()] == ["light.exr"]


def test_where_it_cannot_be_written_one_line_says_so(tmp_path):
    for write in (write_light, write_comparison):
        given = light_from(1.0, 0.0, 0.0) if write is write_light else torch.zeros(3, 4, 4, dtype=torch.uint8)
        with pytest.raises(OutputError, match="cannot be written"):
            write(given, tmp_path / "missing" / "file.exr" if write is write_light else tmp_path / "missing" / "a.png")
